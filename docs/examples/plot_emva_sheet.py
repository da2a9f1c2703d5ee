"""
EMVA 1288 sheet of an ordinary camera
=====================================

Flats of known photons per pixel, and darks, give the quantities of EMVA 1288 with their 95 %
intervals. The camera simulated here has a quantum efficiency of 60 %, a gain of 0.25 DN per
electron, a read noise of 5 electrons, a non-uniformity of 1 % and a full well of 15,000 electrons.
"""

import numpy as np
from matplotlib import pyplot as plt

import charact
from charact.reporting import emva_summary

rng = np.random.default_rng(5)
response = rng.normal(1.0, 0.01, (128, 128))


def frames(photons: float) -> np.ndarray:
    """Return eight frames, DN."""
    electrons = np.minimum(rng.poisson(0.6 * photons * response, (8, 128, 128)), 15000)
    return np.rint(100.0 + 0.25 * (electrons + rng.normal(0.0, 5.0, electrons.shape))).astype(
        np.uint16
    )


# %%
# One stack is one level of light. Of a session in a folder, `charact convert SESSION sheet.pdf --to
# emva` writes the sheet with the figures of the standard, and sheet.xml what the program of the
# EMVA 1288 group reads. A row without a value, or from fewer frames than the standard asks for,
# names the frames to add.
photons = np.linspace(1500.0, 27000.0, 18)
flats = [frames(level) for level in photons]
settings = {"photons_per_px": photons, "exposure_s": 0.01, "bit_depth": 12, "quick": True}
result = charact.noise(flats=flats, darks=[frames(0.0)], **settings)
sheet = emva_summary(result)["rows"]
rows = [
    (f"{row.entry.name} {row.entry.symbol}", row.text, row.status)
    for row in sheet
    if row.text and not row.entry.detail
]
print(next(row.departure for row in sheet if row.departure))

# %%
# The photon transfer curve beside the sheet: the variance rises by the gain per DN until the full
# well.
figure, (axes, table) = plt.subplots(
    1, 2, figsize=(11, 4.2), layout="constrained", width_ratios=(1, 2)
)
axes.plot(
    [flat.mean() for flat in flats],
    [flat.var(axis=0, ddof=1).mean() for flat in flats],
    "o-",
    markersize=3,
)
axes.set(xlabel="mean (DN)", ylabel="temporal variance (DN²)")
table.axis("off")
columns = ("quantity", "value, 95 % interval", "status")
shown = table.table(
    rows, colLabels=columns, colWidths=(0.5, 0.38, 0.12), cellLoc="left", loc="center"
)
shown.auto_set_font_size(False)
shown.set_fontsize(9)
shown.scale(1.0, 1.4)
