"""One transfer of the camera in every direction: an elliptical core, a halo shared by all, aperture
and video.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from charact.estimators.mtf.session.thresholds import THRESHOLDS
from charact.method import Context
from charact.transfer.blur_model import BlurModel
from charact.transfer.extended import ExtendedComponent
from charact.transfer.form import Parameter, ProperPrior, flat_parameters
from charact.transfer.video_filter import PixelAndVideo, VideoFilter, powers
from labdata import Array, Mask


class KnownCameraTransfer(PixelAndVideo):
    """Described part of the transfer of a context's camera."""

    @classmethod
    def of(cls, context: Context) -> "KnownCameraTransfer":
        """Return the described transfer of a context's camera."""
        rows = 2.0 if context.interlaced else 1.0
        return cls(height_px=rows * context.pitch_ratio, video=VideoFilter.of(context.camera))


@dataclass(frozen=True, kw_only=True)
class JointBlurModel(ProperPrior):
    """A form of the camera's transfer in all directions.

    M(fx, fy) = C(r/f2) exp(-2 (pi r)^2 b) [(1 - q) + q W(f)] A(fx, fy), with r^2 = fx^2 + (fy
    e^-s)^2 the elliptical frequency, f2 the half frequency of the core C, b the variance of a
    further Gaussian blur (`blurred`), q the fraction of the halo W (`wide`), s the stretch
    (`elliptical`), f^2 = fx^2 + fy^2, and A aperture and video (`known`).
    """

    core: str
    blurred: bool
    wide: ExtendedComponent | None
    elliptical: bool
    known: KnownCameraTransfer

    @cached_property
    def family(self) -> BlurModel:
        """Core alone, along one direction."""
        return BlurModel(core=self.core)

    @property
    def name(self) -> str:
        """Display name."""
        core = f"{self.core} x gaussian" if self.blurred else self.core
        return core if self.wide is None else f"{core} + {self.wide.name}"

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of core, further blur, stretch, halo and video."""
        blur = Parameter(name="blur_px2", unit="px2", low=0.0, high=3.0, start=0.3)
        stretch = Parameter(
            name="ln_vertical_stretch", unit="1", low=-1.0, high=1.0, sd=THRESHOLDS.stretch_sd
        )
        return (
            *self.family.parameters,
            *[blur] * self.blurred,
            *[stretch] * self.elliptical,
            *(flat_parameters(self.wide.parameters) if self.wide else ()),
            *self.known.parameters,
        )

    def transfer(self, theta: Array, fx: Array, fy: Array) -> Array:
        """Return the MTF at cycles per column pitch along rows and columns, (n, parameter) and (f,)
        -> (n, f).
        """
        return self.known(fx, fy) * self.unknown(theta, fx, fy, bend=self.known.bend(fx))

    def unknown(
        self,
        theta: Array,
        fx: Array,
        fy: Array,
        *,
        bend: Array | None,
        excludes_halo: Mask | bool = False,
    ) -> Array:
        """Return the MTF over aperture and described video, shape (n, parameter) and (f,) -> (n,
        f).

        Frequencies are cycles per column pitch; `bend` is `known.bend` of `fx`; `excludes_halo`:
        where it is normalised to a window narrower than the halo, whose light is then left out.
        """
        size = self.family.core_parameters
        stretch_index = size + self.blurred
        stretch = np.exp(theta[:, stretch_index : stretch_index + 1]) if self.elliptical else 1.0
        radius = np.maximum(np.hypot(fx, fy / stretch), 1e-7)
        core = self.family.modulus(theta[:, :size], radius)
        if self.blurred:
            core = core * np.exp(-2.0 * (np.pi * radius) ** 2 * theta[:, size : size + 1])
        if bend is not None:
            core = core * np.exp(powers(theta[:, -1]) @ bend)
        if self.wide is None:
            return core
        tail = theta[:, stretch_index + self.elliptical :][:, : len(self.wide.parameters)]
        extended = self.wide.transfer(np.maximum(np.hypot(fx, fy), 1e-7), tail[:, 1:])
        return core * np.where(excludes_halo, 1.0, 1.0 - tail[:, :1] + tail[:, :1] * extended)
