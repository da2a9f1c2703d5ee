"""
MTF of an edge in an array
==========================

Twelve lines from an array to the MTF with its interval. The edge is made here; any array (row, col)
or (frame, row, col), or the name of a file, takes its place.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.special import erf

import charact

row, col = np.mgrid[0:100, 0:120]
edge = 1000.0 + 400.0 * erf((col - 60.0 + 0.1 * (row - 50.0)) / 1.5)
frames = np.random.default_rng(2).poisson(edge, (4, 100, 120)).astype(np.uint16)

# %%
# The text is a summary; every quantity is an attribute with value, interval, status and flags.
result = charact.mtf(frames, kind="edge", quick=True)
print(result)
low, high = result.mtf50.interval95
assert result.mtf50.status == "ok" and low < result.mtf50.value < high

# %%
# The curve with its 95 % band.
figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
result.plot(axes=axes)
