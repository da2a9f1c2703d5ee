"""A lamp at a place, as a table of a scene's file says it."""

from dataclasses import dataclass

from labdata.errors import BadInput

BEAMS = ("isotropic", "cosine", "spot")
NARROW = "narrow-band"


@dataclass(frozen=True, kw_only=True)
class LampPlacement:
    """A lamp at a place.

    Parameters
    ----------
    label
        Its name.
    kind
        Kind of its spectrum (`simulate.radiance.lamps.KINDS`), "narrow-band" for a laser or a diode of one colour, or a
        .csv file of two columns relative to the scene's.
    position_m
        Place (east, north, up), m.
    lumens
        Luminous flux, lm; without lumens and watts that of its photometric file.
    watts
        Radiant flux, W, in place of lumens: for what shines unseen.
    wavelength_nm, width_nm
        Of a narrow band: its middle, and its width at half of its height, 0 for a line, nm.
    aim_m
        Place at which its axis points, m; straight down without one.
    beam
        "isotropic", "cosine" (a matt emitter), "spot", or a photometric .ies file relative to the scene's.
    heading_deg
        Where the plane C0 of a photometric file lies, clockwise from north, deg.
    half_angle_deg
        Of a spot: where its intensity has fallen to half, deg from the axis.
    radius_m
        Radius of what shines, m.
    temperature_k
        Of an incandescent lamp, K.
    near_infrared_share
        Power of near-infrared lines over that of the visible, dimensionless; None: that of its kind.
    """

    label: str
    kind: str
    position_m: tuple[float, float, float]
    lumens: float | None = None
    watts: float | None = None
    wavelength_nm: float | None = None
    width_nm: float = 0.0
    aim_m: tuple[float, float, float] | None = None
    beam: str = "isotropic"
    heading_deg: float = 0.0
    half_angle_deg: float = 20.0
    radius_m: float = 0.05
    temperature_k: float = 2856.0
    near_infrared_share: float | None = None

    def __post_init__(self) -> None:
        if self.beam not in BEAMS and not self.measured:
            raise BadInput(f"a beam must be one of {', '.join(BEAMS)} or an .ies file, got {self.beam!r}")
        given = [power for power in (self.lumens, self.watts) if power is not None]
        if len(given) == 2 or not (given or self.measured):
            raise BadInput(
                "a lamp must have either lumens or watts, or neither with a photometric file, got "
                f"{'both' if given else 'none'} of {self.label!r}"
            )
        if not all(power >= 0.0 for power in given):
            raise BadInput(f"lumens and watts must not be negative, got {given[0]:g} of {self.label!r}")
        if self.kind != NARROW and (self.wavelength_nm is not None or self.width_nm):
            raise BadInput(f"wavelength_nm and width_nm belong to a {NARROW} lamp, got {self.kind} for {self.label!r}")
        if not self.radius_m > 0.0:
            raise BadInput(f"radius_m must be positive, got {self.radius_m:g} of {self.label!r}")
        if self.aim_m == self.position_m:
            raise BadInput(f"a lamp must aim at another place than its own, got {self.label!r}")

    @property
    def measured(self) -> bool:
        """Whether its beam is a photometric file."""
        return self.beam.lower().endswith(".ies")
