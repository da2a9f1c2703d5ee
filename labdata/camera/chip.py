"""Sections of a camera description: silicon, CCD, register and digital read-out."""

from dataclasses import dataclass, field

import numpy as np

from labdata.camera.parameters import Parameter, must_be_an_efficiency_table
from labdata.errors import check, check_range


@dataclass(frozen=True, kw_only=True)
class Silicon:
    """Quantum efficiency by wavelength, with fill factor and surface losses."""

    wavelength_nm: tuple[float, ...]
    quantum_efficiency: tuple[float, ...]  #: absolute

    def __post_init__(self) -> None:
        must_be_an_efficiency_table(self.wavelength_nm, self.quantum_efficiency)


@dataclass(frozen=True, kw_only=True)
class Ccd:
    """CCD, interline or frame-transfer."""

    columns: int
    rows: int
    pitch_x_um: Parameter
    pitch_y_um: Parameter
    #: fill factor included, at the phosphor's peak; without a tube, the table's highest
    quantum_efficiency: Parameter
    full_well_e: Parameter  #: of one pixel as read
    read_noise_e: Parameter
    dark_current_e_per_s: Parameter  #: per pixel at 25 C
    dark_current_doubling_k: Parameter
    prnu: Parameter  #: relative standard deviation
    smear_fraction: Parameter  #: of the overexposed pixel, for a spot one tenth of the picture high
    #: overexposure that the drain carries off, in full wells; 1 is no drain
    antibloom_ratio: Parameter
    dsnu_e: Parameter  #: standard deviation of the fixed dark pattern, per exposure at 25 C

    def __post_init__(self) -> None:
        check(
            self,
            one_or_more="columns rows",
            positive="pitch_x_um pitch_y_um full_well_e dark_current_doubling_k quantum_efficiency",
            fraction="quantum_efficiency smear_fraction",
            not_negative="read_noise_e dark_current_e_per_s prnu dsnu_e antibloom_ratio",
        )


@dataclass(frozen=True, kw_only=True)
class Register:
    """Electron-multiplying register; a plain CCD has a gain of exactly 1."""

    em_gain: Parameter  #: at most; the session says what it was set to
    pulse_height_shape: Parameter  #: of one electron at high gain; 1 is exponential
    #: electrons that clocking sets free, per pixel and frame, before the gain
    clock_induced_e: Parameter
    stages: int  #: of the register

    def __post_init__(self) -> None:
        check(self, one_or_more="em_gain")
        check(
            self,
            positive="pulse_height_shape",
            not_negative="clock_induced_e",
            one_or_more="stages",
        )

    @property
    def multiplies(self) -> bool:
        """Whether the register has gain."""
        return float(self.em_gain) > 1.0


@dataclass(frozen=True, kw_only=True)
class Readout:
    """Departures of a digital read-out from white noise and a straight response.

    EMVA 1288 release 4 (section 8) divides temporal noise into that of rows, columns and pixels;
    its spectra show interference as peaks. Values of 0, and a ratio of 1, are none. DN are those of
    the digitiser. The response is y = s (1 - c s / full scale) with s the signal of the conversion
    gain at no signal, K / (1 - 2.1 c): K itself is the slope of variance over signal from none to
    70 % of full scale, as EMVA 1288 defines the system gain.
    """

    row_noise_dn2: Parameter = field(default_factory=lambda: Parameter(value=0.0))
    #: density of the rows' offsets at 0.25 cy/row; of white offsets their variance
    row_noise_exponent: Parameter = field(default_factory=lambda: Parameter(value=0.0))
    #: a of the density's law f^-a down the rows; 0 is white, 1 is 1/f noise
    fine_noise_ratio: Parameter = field(default_factory=lambda: Parameter(value=1.0))
    #: density of read noise along a row at 0.5 cy/px over that at 0; above 1 neighbours differ more
    #: than by white noise
    interference_dn2: Parameter = field(default_factory=lambda: Parameter(value=0.0))
    #: variance of a sinusoid over the frame whose phase changes from frame to frame
    interference_x_cy_per_px: Parameter = field(default_factory=lambda: Parameter(value=0.5))
    interference_y_cy_per_px: Parameter = field(default_factory=lambda: Parameter(value=0.5))
    compression_fraction: Parameter = field(default_factory=lambda: Parameter(value=0.0))
    #: c, loss of response at full scale; negative where the response rises
    exposure_offset_us: Parameter = field(default_factory=lambda: Parameter(value=0.0))
    #: how much longer than stated the shutter is open

    def __post_init__(self) -> None:
        check(self, not_negative="row_noise_dn2 interference_dn2", positive="fine_noise_ratio")
        check_range(self, 0.0, 2.0, "row_noise_exponent")
        check_range(self, -0.2, 0.2, "compression_fraction")
        check_range(self, 0.0, 1.0, "interference_x_cy_per_px", "interference_y_cy_per_px")


# Ratio of the slope of y (1 - 3 c y) over 0 to 0.7, by least squares, to c: 3 x 0.7.
MEAN_SLOPE = 2.1


def gain_at_no_signal(gain: float, compression_fraction: float) -> float:
    """Return the conversion gain at no signal, DN/e-, of a mean conversion gain; see `Readout`.

    The variance of a signal y is K0 y (1 - 3 c y / full scale) to first order in c.
    """
    return gain / (1.0 - MEAN_SLOPE * compression_fraction)


def excess_noise_factor(em_gain: float, stages: float = np.inf) -> float:
    """Return the excess noise factor F^2 of an electron-multiplying register of mean gain g and N
    stages.

    .. math:: F^2 = 2 (g - 1) g^{-(N + 1) / N} + 1 / g

    1 at unit gain and 2 at high gain (Robbins & Hadwen, IEEE Trans. Electron Devices 50, 1227
    (2003), eq. 20).
    """
    return 2.0 * (em_gain - 1.0) * em_gain ** -(1.0 + 1.0 / stages) + 1.0 / em_gain
