"""
Bloom and halo of a point source
================================

A pinhole at rising illuminance blooms, and the halo around it, light of scattered photoelectrons,
keeps its diameter. The frames are simulated on the virtual bench, with a part of the chip to be
quick.
"""

from dataclasses import replace

import numpy as np
from matplotlib import pyplot as plt

import charact
from labdata.sensors import load_camera
from labdata.target import Target

whole = load_camera("gen3-digital-iccd")
camera = replace(whole, ccd=replace(whole.ccd, rows=240, columns=240))
settings = {"mcp_v": 800.0, "gate_ns": 4e7}
pinhole = Target(pinhole_px=2.0)


def stack(lux: float, seed: int) -> object:
    """Return a stack of frames of the pinhole at an illuminance, lx; of 0 lx a dark."""
    kind, target = ("point", pinhole) if lux else ("dark", None)
    shot = charact.simulate(
        "bench",
        sensor=camera,
        kind=kind,
        target=target,
        frames=8,
        seed=seed,
        illuminance_lux=lux,
        **settings,
    )
    label = f"{kind} {lux:g} lx"
    return charact.stack(
        shot, kind, label=label, target=target, illuminance_lux=lux, exposure_s=0.04, **settings
    )


# %%
# The halo is one quantity of the series, the bloom one of each stack that exceeds half of full
# scale.
levels_lux = (1e-3, 3e-3, 1e-2, 3e-2)
session = charact.session(
    [stack(0.0, 0), *(stack(lux, seed) for seed, lux in enumerate(levels_lux, 1))], sensor=camera
)
result = charact.bloom(session, quick=True)
print(result)

# %%
figure, (picture, axes) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
brightest = session.stacks[-1].read().data.mean(axis=0)
picture.imshow(np.log10(brightest), cmap="gray")
picture.set(xlabel="column (px)", ylabel="row (px)", title=f"{levels_lux[-1]:g} lx, logarithmic")
for lux in levels_lux:
    bloom = result.find("bloom_diameter", stack=f"point {lux:g} lx")[0]
    if bloom.value is not None:
        low, high = bloom.interval95
        axes.errorbar(
            lux, bloom.value, ([bloom.value - low], [high - bloom.value]), fmt="ko", capsize=3
        )
axes.axhspan(*result.halo_diameter.interval95, alpha=0.5, label="halo, 95 %")
axes.set(
    xscale="log",
    xlabel="illuminance (lx)",
    ylabel="diameter (px)",
    title="bloom of each stack",
    ylim=(0, None),
)
axes.legend(loc="center left")
