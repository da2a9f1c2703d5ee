"""Forward model of a point series: ring means, edge of the halo, blur models, their selection and
their measurements.
"""
