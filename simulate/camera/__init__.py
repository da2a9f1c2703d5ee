"""Camera simulation: a chain of physical stages from light on the photocathode to digital
numbers.
"""
