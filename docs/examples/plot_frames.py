"""
Noise of an intensified camera against light
============================================

Simulate uniform light of increasing level through the default camera and plot temporal variance
against mean. The slope is lower than the covariance gain K + k F², because blur after the gain
spreads each photoelectron over several pixels.
"""

from itertools import islice

import numpy as np
from matplotlib import pyplot as plt

from labdata.conditions import Conditions
from labdata.sensors import load_camera
from simulate.camera.scene_to_photoelectrons import (
    camera_from_description,
    mcp_input_from_photoelectrons,
)

# %%
# A camera is made from its description. `frames` yields one frame after another, forever.
camera = camera_from_description(load_camera("pulnix-ag5745ef3"))
conditions = Conditions(mcp_v=750.0)
centre = (slice(200, 300), slice(300, 460))
levels_pe, mean_dn, variance_dn2 = np.geomspace(0.3, 10.0, 6), [], []
for level_pe in levels_pe:
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, level_pe), conditions)
    frames = np.array(
        [frame[centre] for frame in islice(camera.frames(light, conditions, seed=1), 12)], float
    )
    mean_dn.append(frames.mean())
    variance_dn2.append(frames.var(axis=0, ddof=1).mean())
    print(
        f"{level_pe:6.2f} photoelectrons: mean {mean_dn[-1]:7.2f} DN, variance "
        f"{variance_dn2[-1]:7.2f} DN²"
    )

# %%
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
axes.plot(mean_dn, variance_dn2, "o-")
axes.set(xlabel="mean (DN)", ylabel="temporal variance (DN²)")
