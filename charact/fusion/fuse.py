"""Fusion of bands by a named method, or by the default one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from charact.fusion.bands import Band, Span, display_planes
from charact.fusion.checks import noise_finding, registration_finding
from charact.fusion.fused import MARKS, Fused
from charact.fusion.thresholds import FUSION
from charact.method import choose
from charact.method.descriptions import DESCRIPTIONS
from labdata.errors import BadInput

# Methods with a colour picture, and those that check noise law and blooming themselves.
COLOURED, AWARE = ("noise-aware-colour", "opponent"), ("noise-aware", "noise-aware-colour")


def fuse(
    bands: Sequence[Band],
    *,
    method: str = "auto",
    colour: bool = False,
    spans: Mapping[str, Span] | None = None,
    registered: bool = False,
    within_percent: float = FUSION.tolerance_percent,
) -> Fused:
    """Fuse two bands or more of one size into one picture with uncertainty, shares and marks.

    Parameters
    ----------
    bands
        Bands on one grid, the intensified one first.
    method
        A registered method of kind "fusion"; "auto": the quickest one of the accuracy chart whose
        restoration error meets `within_percent` of the truth's spread, otherwise the most accurate
        one, grey or, with `colour`, coloured.
    spans
        Values shown as 0 and 1, by the name of the band; None: from the frames.
    registered
        Whether the bands are known to be in register; otherwise their shift is measured.

    Raises
    ------
    BadInput
        If bands differ in shape, hold values that are not finite or are shifted by more than 2 px,
        or the method is unknown.
    """
    pictures = fuse_all(
        bands,
        (method,),
        colour=colour,
        spans=spans,
        registered=registered,
        within_percent=within_percent,
    )
    return next(iter(pictures.values()))


def fuse_all(
    bands: Sequence[Band],
    methods: Sequence[str],
    *,
    colour: bool = False,
    spans: Mapping[str, Span] | None = None,
    registered: bool = False,
    within_percent: float = FUSION.tolerance_percent,
) -> dict[str, Fused]:
    """Return the pictures of several methods by their names; the shift is measured once. See
    `fuse`.
    """
    if colour and (grey := [name for name in methods if name not in ("auto", *COLOURED)]):
        raise BadInput(
            f"colour needs the method auto or one of {', '.join(COLOURED)}, got {grey[0]!r}"
        )
    among = (
        COLOURED if colour else [name for name in DESCRIPTIONS["fusion"] if name not in COLOURED]
    )
    chosen = [
        choose("fusion", name, within_percent=within_percent, among=among) for name in methods
    ]
    planes = display_planes(bands, bloom=True, spans=spans)
    shift, notes = (None, ()) if registered else registration_finding(planes)
    # Every method states a standard deviation by the noise law.
    noise = (
        [noise_finding(plane) for plane in planes]
        if any(one.name not in AWARE for one in chosen)
        else []
    )
    pictures = {}
    for one in chosen:
        found = one.function(bands, spans=spans)
        assert isinstance(found, Fused)
        findings = [
            finding for finding in (shift, *(() if one.name in AWARE else noise)) if finding
        ]
        rows = tuple(
            row.with_(notes=(*row.notes, *notes), findings=findings) for row in found.measurements
        )
        marks = found.marks | np.uint8(MARKS["unregistered"]) if shift else found.marks
        pictures[one.name] = replace(found, measurements=rows, marks=marks)
    return pictures
