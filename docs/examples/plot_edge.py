"""
MTF of an edge, measured and true
=================================

Simulate a slanted edge with a known Gaussian blur, measure its MTF, and compare with the transfer
function of blur and pixel.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.special import erf

from charact.estimators import mtf
from charact.method import Context
from labdata.frames import FrameStack

SIGMA_PX, ANGLE_DEG, FRAMES = 0.8, 5.0, 8
rng = np.random.default_rng(1)

# %%
# A step of 1,000 DN across an edge tilted by 5 degrees, with photon and read noise. Eight samples a
# side of a pixel average the light over its area.
row, col = (np.mgrid[0 : 128 * 8, 0 : 64 * 8] + 0.5) / 8.0 - np.array([64.0, 32.0]).reshape(2, 1, 1)
angle = np.deg2rad(ANGLE_DEG)
distance_px = col * np.cos(angle) + row * np.sin(angle)
fine = 200.0 + 500.0 * (1.0 + erf(distance_px / (np.sqrt(2.0) * SIGMA_PX)))
mean = fine.reshape(128, 8, 64, 8).mean(axis=(1, 3))
data = np.rint(mean + rng.normal(0.0, np.sqrt(4.0 + 0.25 * mean), (FRAMES, *mean.shape))).astype(
    np.uint16
)

# %%
# The result holds measurements with intervals, and curves.
stack = FrameStack(data=data, time_s=np.arange(float(FRAMES)))
result = mtf.measure("edge", stack, context=Context(quick=True))
for measurement in result.find("mtf50"):
    low, high = measurement.interval95
    print(
        f"MTF50 {measurement.value:.4f} cy/px [{low:.4f}, {high:.4f}], {measurement.status}, "
        f"{measurement.method}"
    )

# %%
# The true MTF is that of the Gaussian times that of the square pixel along the edge's normal.
curve = result.curves["mtf"]
frequency = curve.frequency_cy_per_px
true = np.exp(-2.0 * (np.pi * SIGMA_PX * frequency) ** 2) * np.abs(
    np.sinc(frequency * np.cos(angle)) * np.sinc(frequency * np.sin(angle))
)
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
axes.plot(frequency, true, "k--", label="true")
axes.plot(frequency, curve.value, label="measured")
axes.fill_between(frequency, *curve.interval95, alpha=0.3, label="95 % interval")
axes.set(xlabel="frequency (cy/px)", ylabel="MTF", xlim=(0, 1), ylim=(0, 1.05))
axes.legend()
