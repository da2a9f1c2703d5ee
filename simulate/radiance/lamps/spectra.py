"""Spectra of lamps, scaled to lumens or watts: black bodies, sodium, mercury, metal halide, LED,
laser, or a file.
"""

from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import require_regular
from simulate.radiance.spectrum import STEFAN_BOLTZMANN, SourceSpectrum, planck, table

NARROW = "narrow-band"
FIRST_NM, LAST_NM = 300.0, 1200.0
# Column of the table of visible spectra (380 to 780 nm, in all 1 W with the lines), and lines, nm,
# with their power.
COLUMNS = {
    "high-pressure-sodium": ("high_pressure_sodium", ()),
    "mercury": (
        "mercury",
        ((404.7, 0.0852), (435.8, 0.1751), (546.1, 0.2185), (577.0, 0.0978), (579.1, 0.0978)),
    ),
    "mercury-coated": (
        "mercury_coated",
        ((404.7, 0.0579), (435.8, 0.1239), (546.1, 0.1605), (577.0, 0.0699), (579.1, 0.0699)),
    ),
    "metal-halide": ("metal_halide", ()),
    "led-cool": ("led_cool", ()),
    "led-warm": ("led_warm", ()),
}
NEAR_INFRARED_LINES = {
    **dict.fromkeys(
        ("high-pressure-sodium", "low-pressure-sodium"), ((818.3, 0.36), (819.5, 0.64))
    ),
    **dict.fromkeys(("mercury", "mercury-coated"), ((1014.0, 1.0),)),
}
# Default power beyond 780 nm over that before: the published 10 to 30 % of high-pressure sodium is
# uncertain.
NEAR_INFRARED_SHARE = {"high-pressure-sodium": 0.2}
KINDS = ("incandescent", "low-pressure-sodium", *COLUMNS)


def spectrum(
    kind: str,
    *,
    lumens: float = 1.0,
    watts: float | None = None,
    temperature_k: float = 2856.0,
    near_infrared_share: float | None = None,
    wavelength_nm: float | None = None,
    width_nm: float = 0.0,
) -> SourceSpectrum:
    """Return the radiant flux of a lamp, W over wavelength.

    Parameters
    ----------
    kind
        One of `KINDS`, or "narrow-band": a laser or a light-emitting diode of one colour.
    lumens
        Luminous flux, lm. (Lux, cd m-2 or cd in place of it give W m-2, W m-2 sr-1, W sr-1.)
    watts
        Radiant flux in place of lumens, W: of an incandescent lamp that of a black body at all
        wavelengths.
    temperature_k
        Of an incandescent lamp, K; others ignore it.
    near_infrared_share
        Power in near-infrared lines over that in 380 to 780 nm, dimensionless: sodium's 818.3 and
        819.5 nm, mercury's 1014 nm. By default 0.2 for high-pressure sodium, which is uncertain
        within 0.1 to 0.3, and 0 for others.
    wavelength_nm, width_nm
        Middle of a narrow band and its width at half of its height (a normal distribution; 0: a
        line), nm.

    Raises
    ------
    BadInput
        If there is no such kind, power or share are negative, a temperature or wavelength is out of
        range, a share is given for a lamp without such lines, or lumens for one without visible
        light.

    Notes
    -----
    Spectra of discharge lamps and LEDs are NIST's, measured to 780 nm; with mercury's lines put
    where they belong.
    """
    if kind == NARROW and wavelength_nm is None:
        raise BadInput(f"wavelength_nm must be given for a {NARROW} lamp, got none")
    if kind == "incandescent":
        if near_infrared_share is not None:
            raise BadInput(
                f"an incandescent lamp has no near_infrared_share, got {near_infrared_share:g}"
            )
        black_body = _incandescent(temperature_k)
        total = STEFAN_BOLTZMANN * temperature_k**4 / np.pi
        return scale_to(black_body, lumens, watts, kind, total)
    if kind == NARROW and wavelength_nm is not None:
        return scale_to(_narrow(wavelength_nm, width_nm), lumens, watts, f"{wavelength_nm:g} nm")
    if kind not in KINDS:
        raise BadInput(
            f"a lamp must be of one of the kinds {', '.join((*KINDS, NARROW))}, got {kind!r}"
        )
    infrared_fraction = (
        NEAR_INFRARED_SHARE.get(kind, 0.0) if near_infrared_share is None else near_infrared_share
    )
    return scale_to(_discharge(kind, infrared_fraction), lumens, watts, kind)


def read_spectrum(
    path: str | Path, *, lumens: float = 1.0, watts: float | None = None
) -> SourceSpectrum:
    """Return the radiant flux of a lamp from a file of two columns, wavelength in nm and power per
    nm in any unit.

    Commas, semicolons or blanks separate; lines that start with # and one heading are skipped.
    """
    rows = _rows(Path(path))
    try:
        file_spectrum = SourceSpectrum(wavelength_nm=rows[:, 0], density=rows[:, 1])
    except BadInput as error:
        raise BadInput(f"{error}, in {path}") from None
    return scale_to(file_spectrum, lumens, watts, str(path))


def scale_to(
    source: SourceSpectrum,
    lumens: float,
    watts: float | None,
    name: str,
    total: float | None = None,
) -> SourceSpectrum:
    """Return a spectrum scaled to watts, by its own total or one given, or else to lumens."""
    for unit, power in (("lumens", lumens), ("watts", watts)):
        if power is not None and not power >= 0.0:
            raise BadInput(f"{unit} must not be negative, got {power:g}")
    power_before, target, unit = (
        (source.lumens, lumens, "lumens")
        if watts is None
        else (total or source.total(), watts, "watts")
    )
    if not power_before > 0.0:
        requirement = (
            "have visible light to be scaled to lumens (state watts)"
            if unit == "lumens"
            else "have some power"
        )
        raise BadInput(f"the spectrum of a lamp must {requirement}, got none in {name}")
    return source.scale(target / power_before)


def _narrow(wavelength_nm: float, width_nm: float) -> SourceSpectrum:
    if not (FIRST_NM <= wavelength_nm <= LAST_NM and 0.0 <= width_nm <= 0.1 * wavelength_nm):
        raise BadInput(
            f"a {NARROW} lamp must lie within {FIRST_NM:g} to {LAST_NM:g} nm and be at most a "
            f"tenth of that wide, got {wavelength_nm:g} nm and {width_nm:g} nm"
        )
    if width_nm == 0.0:
        limits = np.array([FIRST_NM, LAST_NM])
        return SourceSpectrum(
            wavelength_nm=limits, density=np.zeros(2), line_nm=(wavelength_nm,), line_power=(1.0,)
        )
    # A normal distribution to four standard deviations.
    deviation = np.linspace(-4.0, 4.0, 65)
    nm = wavelength_nm + deviation * width_nm / np.sqrt(8.0 * np.log(2.0))
    return SourceSpectrum(wavelength_nm=nm, density=np.exp(-0.5 * deviation**2))


def _rows(path: Path) -> np.ndarray:
    require_regular(path, "a lamp's spectrum")
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        raise BadInput(f"a lamp's spectrum must be a readable text file, got {path}") from None
    cells = [
        line.replace(",", " ").replace(";", " ").split()
        for line in lines
        if line.strip() and line[0] != "#"
    ]
    if cells and not _is_number(cells[0][0]):
        cells = cells[1:]
    for row in cells:
        if len(row) != 2 or not all(_is_number(cell) for cell in row):
            raise BadInput(
                f"a lamp's spectrum must have two numbers on each line, got {' '.join(row)!r} in "
                f"{path}"
            )
    if len(cells) < 2:
        raise BadInput(
            f"a lamp's spectrum must have at least two lines of numbers, got {len(cells)} in {path}"
        )
    return np.array([[float(cell) for cell in row] for row in cells])


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _incandescent(temperature_k: float) -> SourceSpectrum:
    if not 1000.0 <= temperature_k <= 20000.0:
        raise BadInput(f"temperature_k must lie in [1000, 20000], got {temperature_k:g}")
    fine = np.arange(FIRST_NM, LAST_NM + 1.0, 5.0)
    return SourceSpectrum(wavelength_nm=fine, density=planck(fine, temperature_k))


def _discharge(kind: str, near_infrared_share: float) -> SourceSpectrum:
    if not near_infrared_share >= 0.0:
        raise BadInput(f"near_infrared_share must not be negative, got {near_infrared_share:g}")
    infrared_lines = NEAR_INFRARED_LINES.get(kind, ())
    if near_infrared_share > 0.0 and not infrared_lines:
        raise BadInput(
            f"near_infrared_share must be 0 for {kind}, of which no lines are known, got "
            f"{near_infrared_share:g}"
        )
    if kind == "low-pressure-sodium":
        wavelength, density = np.array([FIRST_NM, LAST_NM]), np.zeros(2)
        lines = ((589.0, 2.0 / 3.0), (589.6, 1.0 / 3.0))
    else:
        column, lines = COLUMNS[kind]
        visible = table("visible")
        wavelength, density = visible["wavelength_nm"], visible[column]
    lines = (
        *lines,
        *(
            (nm, near_infrared_share * fraction)
            for nm, fraction in infrared_lines
            if near_infrared_share > 0.0
        ),
    )
    return SourceSpectrum(
        wavelength_nm=wavelength,
        density=density,
        line_nm=tuple(nm for nm, _ in lines),
        line_power=tuple(power for _, power in lines),
    )
