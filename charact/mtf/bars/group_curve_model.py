"""The form of one MTF curve through groups of bars: an exponential core, and what is known of the camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.blur_models import transfer as forms
from charact.mtf.session.joint_model import KnownCameraTransfer
from charact.mtf.session.stage_transfers import prior_sd_of

Array = NDArray[np.float64]

# Half frequency, cycles per column pitch, exponent and the halo's share of the light lie in these ranges.
BOUNDS = ((0.01, 1.5), (0.7, 3.5), (0.0, 0.5))
NAMES, UNITS = ("half_frequency", "exponent", "halo_fraction"), ("cy/px", "1", "1")
# The exponent's prior is n = 2, a Gaussian, to 1.2, a tube.
EXPONENT_PRIOR = (1.6, 0.6)
GRID = (np.geomspace(0.03, 0.8, 40), np.linspace(0.8, 3.0, 23))


@dataclass(frozen=True, kw_only=True)
class GroupHaloPrior:
    """Halo of a described intensifier.

    Parameters
    ----------
    diameter_px
        Column pitches.
    elastic_share
        Fraction of elastically scattered electrons, dimensionless.
    mean, sd
        Prior of its fraction of the light, dimensionless.
    """

    diameter_px: float
    elastic_share: float
    mean: float
    sd: float

    @classmethod
    def of(cls, context: Context) -> "GroupHaloPrior | None":
        """Return the halo of the camera; None without a description."""
        if context.sensor is None:
            return None
        sensor, share = context.sensor, context.sensor.photocathode.halo_fraction
        column_um = float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification)
        return cls(
            diameter_px=4e3 * float(sensor.photocathode.gap_mm) / column_um,
            elastic_share=float(sensor.photocathode.halo_elastic_share),
            mean=float(share),
            sd=prior_sd_of(share),
        )


@dataclass(frozen=True, kw_only=True)
class GroupCurveModel:
    """c^((f/f2)^n) along one direction, times pixel and video filter and, if described, the halo.

    Parameters
    ----------
    angle_rad
        Direction from that of the rows.
    known
        Pixel aperture, and the described video filter.
    halo
        The halo, or None.
    """

    angle_rad: float
    known: KnownCameraTransfer
    halo: GroupHaloPrior | None

    @classmethod
    def of(cls, context: Context, *, angle_rad: float) -> "GroupCurveModel":
        """Return the model for a camera and a direction."""
        return cls(angle_rad=angle_rad, known=KnownCameraTransfer.of(context), halo=GroupHaloPrior.of(context))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return NAMES if self.halo else NAMES[:2]

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return UNITS[: len(self.names)]

    @property
    def bounds(self) -> Array:
        """Their bounds, shape (parameter, 2)."""
        return np.array(BOUNDS[: len(self.names)])

    @property
    def grid(self) -> Array:
        """Starting points of the optimisation, shape (point, parameter)."""
        axes = GRID if self.halo is None else (*GRID, np.array([self.halo.mean]))
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(self.names))

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density up to a constant, shape (n,)."""
        mean, sd = EXPONENT_PRIOR
        density = -0.5 * ((theta[:, 1] - mean) / sd) ** 2
        return density if self.halo is None else density - 0.5 * ((theta[:, 2] - self.halo.mean) / self.halo.sd) ** 2

    def mtf(self, theta: Array, frequency: Array) -> Array:
        """Return the MTF at frequencies across the bars, cycles per column pitch, (n, parameter) and (f,) -> (n, f)."""
        at = np.maximum(frequency, 1e-9)
        core = np.exp(forms.exponential(at, theta[:, 0], theta[:, 1]))
        if self.halo is not None:
            far = forms.halo(at, np.array(self.halo.diameter_px), np.array(self.halo.elastic_share))
            core = core * (1.0 - theta[:, 2:3] * (1.0 - far))
        return core * self.known(frequency * np.cos(self.angle_rad), frequency * np.sin(self.angle_rad))
