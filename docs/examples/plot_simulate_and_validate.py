"""
Simulate and validate
=====================

Frames simulated from a description are compared with measured frames by tests that can fail. Here
the measured frames are simulated as well, so the description is right and every test should agree.
With measured frames, `charact.fit` makes the description.
"""

from dataclasses import replace

from matplotlib import pyplot as plt

import charact
from labdata.sensors import load_camera

whole = load_camera("gen3-digital-iccd")
camera = replace(whole, ccd=replace(whole.ccd, rows=160, columns=200))
settings = {"mcp_v": 800.0, "gate_ns": 4e7}


def stack(kind: str, lux: float, seed: int) -> object:
    """Return a stack of frames of the bench at an illuminance, lx; effects below 1 % of the noise
    are left out.
    """
    shot = charact.simulate(
        "bench",
        sensor=camera,
        kind=kind,
        frames=12,
        seed=seed,
        illuminance_lux=lux,
        error_budget_percent=1.0,
        **settings,
    )
    return charact.stack(
        shot, kind, label=f"{kind} {lux:g} lx", illuminance_lux=lux, exposure_s=0.04, **settings
    )


stacks = [
    stack("dark", 0.0, 1),
    stack("flat", 2e-5, 2),
    stack("flat", 1e-4, 3),
    stack("edge", 3e-4, 4),
]

# %%
# Each statistic has a verdict: its departure, in a unit of its own, is within its tolerance or not,
# and is chance or not.
validation = charact.validate(charact.session(stacks, sensor=camera), camera, seed=5)
for one in validation.statistics:
    size = (
        "not measurable" if one.departure is None else f"{one.departure:.2g} {one.departure_unit}"
    )
    print(f"{one.name}: {one.verdict}, {size}, p = {one.p_value:.2g}")

# %%
# One frame of each pair, on the same scale.
pair = validation.pairs[-1]
figure, axes = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
for one, image, title in zip(
    axes, (pair.measured, pair.simulated), ("measured", "simulated"), strict=True
):
    one.imshow(image, cmap="gray", vmin=0, vmax=255)
    one.set(title=f"{pair.label}, {title}", xlabel="column (px)", ylabel="row (px)")
