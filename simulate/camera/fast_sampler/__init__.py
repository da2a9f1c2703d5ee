"""Fast sampler: pulses from tabulated distributions, spread by kernels that conserve the
covariance.
"""
