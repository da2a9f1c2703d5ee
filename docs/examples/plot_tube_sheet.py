"""
Data sheet of an intensifier tube
=================================

Darks, flats of known illuminance and a slanted edge give the quantities of a tube's data sheet:
MTF50 and resolution at the photocathode, signal-to-noise ratio, equivalent background illumination,
gain and excess noise. The frames are simulated on the virtual bench, with a part of the chip to be
quick.
"""

from dataclasses import replace

from matplotlib import pyplot as plt

import charact
from charact.reporting.front_page import sheet
from labdata.sensors import load_camera

whole = load_camera("gen3-digital-iccd")
camera = replace(whole, ccd=replace(whole.ccd, rows=160, columns=200))
settings = {"mcp_v": 800.0, "gate_ns": 4e7}


def stack(kind: str, lux: float, frames: int, seed: int) -> object:
    """Return a stack of frames of the bench at an illuminance of the photocathode, lx."""
    shot = charact.simulate(
        "bench", sensor=camera, kind=kind, frames=frames, seed=seed, illuminance_lux=lux, **settings
    )
    return charact.stack(
        shot, kind, label=f"{kind} {lux:g} lx", illuminance_lux=lux, exposure_s=0.04, **settings
    )


# %%
# A session in memory; a folder of files does as well (`charact import frames`).
stacks = [
    stack("dark", 0.0, 32, 1),
    stack("flat", 2e-5, 12, 2),
    stack("flat", 1e-4, 12, 3),
    stack("edge", 3e-4, 12, 4),
]
result = charact.measure(charact.session(stacks, sensor=camera), quick=True)

# %%
# The sheet in the user's units, with 95 % intervals and the verdict on each value.
rows = [
    (row.title, row.value, ", ".join((row.status, *row.flags)))
    for row in sheet(result.session, result)
]
figure, axes = plt.subplots(figsize=(9.5, 4.2), layout="constrained")
axes.axis("off")
columns = ("quantity", "value, 95 % interval", "status")
shown = axes.table(
    rows, colLabels=columns, colWidths=(0.5, 0.32, 0.18), cellLoc="left", loc="center"
)
shown.auto_set_font_size(False)
shown.set_fontsize(10)
shown.scale(1.0, 1.5)
