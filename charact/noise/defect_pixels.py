"""How many pixels of a camera are defective, in the dark and in the light."""

from typing import Any

import numpy as np

from charact.method import Context
from charact.noise.cube.cube import Cube
from charact.noise.gain.series import CLIPPED_SHARE
from charact.noise.provenance import provenance
from charact.noise.stack.defects import FAR, RESTLESS
from charact.noise.stack.level import Level
from labdata.measurement import Measurement, Result, measured, refused

METHOD = "outlying-pixels"
# Places that a note lists.
LISTED = 10


def defect_pixels(levels: list[Level], *, context: Context) -> Result:
    """Return how many pixels are defective in the dark of the longest exposure and in the brightest whole flat."""
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    known = [level for level in levels if level.cube is not None and level.high_share <= CLIPPED_SHARE]
    if not known:
        reason = "defective pixels need a stack of at least 8 frames below the highest code"
        return Result(measurements=(refused("defect_pixels", "px", reason, **fields),)) if levels else Result()
    darks = [level for level in known if level.kind == "dark"]
    flats = [level for level in known if level.kind == "flat"]
    chosen = [max(darks, key=lambda d: (d.conditions.exposure_s or 0.0, d.frames))] if darks else []
    chosen += [max(flats, key=lambda f: f.mean_dn)] if flats else []
    return Result(measurements=tuple(_counted(level, level.cube, fields) for level in chosen if level.cube))


def _counted(level: Level, cube: Cube, fields: dict[str, Any]) -> Measurement:
    """The number of defective pixels of a stack, which its cube told."""
    found = cube.defects
    each = f"{len(found.bright)} bright, {len(found.faint)} faint, {len(found.restless)} restless"
    rule = f"a mean beyond {found.threshold_dn:.3g} DN of the others, {FAR:g} robust standard deviations"
    notes = [f"{each}; {rule}, or changes {RESTLESS:g} times as large as theirs"]
    places = np.concatenate([found.bright, found.faint, found.restless])[:LISTED]
    if len(places):
        shown = ", ".join(f"({row}, {col})" for row, col in dict.fromkeys(map(tuple, places.tolist())))
        notes.append(f"row and column of the first: {shown}")
    low, high = found.least, found.most
    around = [(float(min(low[i], found.count)), float(max(high[i], found.count))) for i in (0, 1)]
    return measured("defect_pixels", "px", float(found.count), *around, notes=tuple(notes),
                    stack=level.label, seconds=cube.seconds, **fields)  # fmt: skip
