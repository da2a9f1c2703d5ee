"""Forward model of a point series: ring means, blur models, their selection and their
measurements.
"""
