"""
Photon transfer of arrays
=========================

Flats and darks in arrays give gain, read noise and non-uniformity. The camera simulated here has 2
DN per electron and a read noise of 3 DN.
"""

import numpy as np

import charact

rng = np.random.default_rng(3)
flats = [
    2.0 * rng.poisson(level, (8, 128, 128)) + rng.normal(100, 3, (8, 128, 128))
    for level in (50, 200, 800, 3200)
]
darks = [rng.normal(100, 3, (8, 128, 128))]

# %%
# One stack is one level of light; conditions are numbers for all stacks, or one for each flat.
result = charact.noise(
    flats=flats, darks=darks, exposure_s=[0.001, 0.004, 0.016, 0.064], quick=True
)
print(result)
low, high = result.find("system_gain")[0].interval95
assert low < 2.0 < high

# %%
# Signal-to-noise ratio against the signal of the flats.
from matplotlib import pyplot as plt  # noqa: E402

signal = [flat.mean() - 100.0 for flat in flats]
plt.loglog(signal, [m.value for m in result.find("snr")], "o-")
plt.gca().set(xlabel="signal (DN)", ylabel="signal-to-noise ratio (1)")
