"""What is read beside every stack of a plan: light and temperature, what they mean, and whether they are needed."""

from dataclasses import dataclass

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Meters:
    """How the meters beside the tube are read.

    Parameters
    ----------
    lux_per_w
        Illuminance on the photocathode for a watt on the head of the light meter, lux/W; None: not calibrated, and
        the watts alone are recorded.
    wavelength_nm
        Wavelength for whose sensitivity of the head the light meter corrects, nm.
    light_needed, temperature_needed
        Whether a run ends where the meter does not answer; else that is told and noted with the stack.
    """

    lux_per_w: float | None = None
    wavelength_nm: float = 550.0
    light_needed: bool = False
    temperature_needed: bool = False

    def __post_init__(self) -> None:
        if self.lux_per_w is not None and not self.lux_per_w > 0:
            raise BadInput(f"lux_per_w must be positive, got {self.lux_per_w:g}")
        if not self.wavelength_nm > 0:
            raise BadInput(f"wavelength_nm must be positive, got {self.wavelength_nm:g}")
