"""Settings of the analyses, each declared once."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from labdata import BadInput
from labdata.settings import Argument, Setting

if TYPE_CHECKING:
    from charact.comparison import Specification
    from charact.verdict.purpose import Purpose
    from labdata import Camera, Result, Session

Frames = Any
Span = tuple[float, float]
SourceFrames = Annotated[
    Frames,
    Argument(
        "Array of shape (row, col), (frame, row, col) or with colours last, DN; path of a file of "
        "frames; or a `labdata.frames.FrameStack`."
    ),
]
SourceSession = Annotated["str | Path | Session", Argument("A session or its folder.")]
MeasuredSource = Annotated[
    "str | Path | Session | Result",
    Argument(
        "A session, its folder, or the result of an analysis. Of a folder the saved result is "
        "used; a session without one is measured."
    ),
]
SavedResult = Annotated[
    "Result | None",
    Argument("Measurements of the session (default: those saved in it, else it is measured)."),
]
MethodName = Annotated[
    str, Setting("Method name, or auto (see `charact methods`).", option="--method")
]
WithinPercent = Annotated[
    float, Setting("Error tolerance for auto, percent.", option="--within", minimum=0.0)
]
Also = Annotated[
    str | None,
    Setting(
        "Second estimate of each edge, with its difference: sfr (the conventional SFR of ISO "
        "12233).",
        metavar="sfr",
    ),
]
Disc = Annotated[
    str | tuple[float, float],
    Setting(
        "Diameter, px, and contrast of the disc whose detectability d' is computed from edges and "
        "flats.",
        metavar="PX,CONTRAST",
    ),
]
Quick = Annotated[
    bool, Setting("Skip posterior sampling; intervals are from the Laplace approximation.")
]
BlackDn = Annotated[
    float | None,
    Setting(
        "Black level, DN (default: from the file). Separates non-uniform illumination from halo; "
        "for bars, also detects gamma from the noise."
    ),
]
MaxTargets = Annotated[
    int,
    Setting("Maximum number of targets measured per frame, spread over the field.", minimum=1),
]
Bars = Annotated[int | None, Setting("Number of bars (default: counted in the image).", minimum=2)]
BarFrequency = Annotated[
    float | None,
    Setting(
        "Bar frequency, cy/px (default: groups along rows and columns are found).",
        option="--frequency",
    ),
]
PinholePx = Annotated[
    float | None, Setting("Diameter of the pinhole's image, px (default: ideal point).")
]
Amplifier = Annotated[
    str | int,
    Setting(
        "Amplifier whose noise is measured: its number, from 1 by rows, or all (the chip, and each "
        "amplifier that darks and flats show).",
        metavar="N|all",
    ),
]
PurposeName = Annotated[
    "str | Path | None",
    Setting(
        "Purpose that the session must be enough for: emva1288, tube, focus, detector, halo or "
        "infrared, or a TOML file of limits (default: that which its frames show).",
        option="--for",
        metavar="PURPOSE|LIMITS.toml",
    ),
]
Scheduler = Annotated[
    str | None,
    Setting("Address of a Dask scheduler; its workers must see the same file paths."),
]
BitDepth = Annotated[
    int | None,
    Argument("Bits of the digitiser of frames in memory (default: found from the data)."),
]
FittedSensor = Annotated[
    "str | Path | Camera | None",
    Setting("The fitted camera or its TOML file (default: fitted.toml in the session's folder)."),
]


def disc_of(disc: str | tuple[float, float]) -> tuple[float, float]:
    """Return diameter and contrast of a disc, also of a text PX,CONTRAST.

    Examples
    --------
    >>> disc_of("10,0.1")
    (10.0, 0.1)
    """
    try:
        diameter_px, contrast = map(float, disc.split(",") if isinstance(disc, str) else disc)
    except (TypeError, ValueError):
        diameter_px, contrast = 0.0, 0.0
    if not (1.0 <= diameter_px <= 100.0 and 0.0 < contrast <= 1.0):
        raise BadInput(
            f"`disc` must be PX,CONTRAST, of 1 to 100 px and a contrast of at most 1, got {disc!r}"
        )
    return diameter_px, contrast


def amplifier_of(amplifier: str | int) -> int | None:
    """Return the number of an amplifier; None for "all".

    Examples
    --------
    >>> amplifier_of("2"), amplifier_of("all")
    (2, None)
    """
    text = str(amplifier)
    if text != "all" and not (text.isascii() and text.isdigit()):
        raise BadInput(f"`amplifier` must be all or a number from 1, got {text!r}")
    return None if text == "all" else int(text)


def purpose_for(purpose: str | Path | None) -> "Purpose | Specification | None":
    """Return a purpose by its name, or that of a TOML file of limits; None of none.

    Raises
    ------
    BadInput
        If there is no such purpose, or the limits break a rule.
    """
    from charact.comparison import load_specification
    from charact.verdict.purpose import PURPOSES

    if purpose is None or purpose in PURPOSES:
        return None if purpose is None else PURPOSES[str(purpose)]
    if isinstance(purpose, Path) or purpose.endswith(".toml"):
        return load_specification(purpose)
    similar = get_close_matches(purpose, PURPOSES, n=1)
    hint = f" (did you mean {similar[0]!r}?)" if similar else ""
    raise BadInput(
        f"`purpose` must be one of {', '.join(PURPOSES)} or a TOML file of limits, got {purpose!r}"
        f"{hint}"
    )


def spans_of(spans: Mapping[str, Span] | Sequence[str]) -> dict[str, Span]:
    """Return display spans by band, also of texts BAND=LOW,HIGH.

    Examples
    --------
    >>> spans_of(["visible=12,38.5"])
    {'visible': (12.0, 38.5)}
    """
    if isinstance(spans, Mapping):
        return dict(spans)
    by_band = {}
    for text in spans:
        name, _, ends = text.partition("=")
        try:
            low, high = (float(end) for end in ends.split(","))
        except ValueError:
            raise BadInput(f"`spans` must be BAND=LOW,HIGH, got {text!r}") from None
        by_band[name] = (low, high)
    return by_band
