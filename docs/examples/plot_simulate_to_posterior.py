"""
An array through the simulated camera, to posterior draws
=========================================================

An image is recorded by a described image-intensified camera; the MTF of the camera is measured from
the frames, and its posterior draws are shown.
"""

import numpy as np
from matplotlib import pyplot as plt

import charact

row, col = np.mgrid[0:1024, 0:1024]
# each pixel's own share
edge = 100.0 + 900.0 * np.clip(0.5 + col - 512 + 0.1 * (row - 512), 0.0, 1.0)
frames = charact.simulate(
    edge, sensor="gen3-digital-iccd", photoelectrons_per_dn=0.02, frames=4, seed=1
)

# %%
# The description of the camera gives the priors; the region leaves the corners out.
result = charact.mtf(frames, "edge", sensor="gen3-digital-iccd", roi=(450, 440, 130, 140), seed=1)
print(result)

# %%
# Draws of the first parameter of the posterior.
posterior = result.mtf50.posterior
plt.hist(posterior.draws[:, 0], bins=30)
plt.gca().set(xlabel=f"{posterior.names[0]} ({posterior.units[0]})", ylabel="draws")
