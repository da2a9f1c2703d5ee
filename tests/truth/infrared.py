"""Infrared cameras drawn here: band radiance by series, 3-D noise of seven terms, sampled edges."""

from dataclasses import dataclass, field

import numpy as np

from labdata import Conditions, FrameStack, Target
from tests.truth.sessions import session_in_memory, stack_in_memory

AXES = {
    "t": (1, 0, 0),
    "v": (0, 1, 0),
    "h": (0, 0, 1),
    "tv": (1, 1, 0),
    "th": (1, 0, 1),
    "vh": (0, 1, 1),
}
# In K: the components over the random noise tvh of 0.1 K.
NOISE_K = {"t": 0.02, "v": 0.03, "h": 0.05, "tv": 0.02, "th": 0.02, "vh": 0.04, "tvh": 0.1}


def band_radiance(low_um, high_um, kelvin):
    """Radiance of a black body between two wavelengths, W m-2 sr-1, by the series of exponentials.

    L(0..um) = 2 k^4 T^4 / (h^3 c^2) sum_n exp(-n x) (x^3/n + 3 x^2/n^2 + 6 x/n^3 + 6/n^4), x = h c
    / (um k T).
    """
    h, c, k = 6.62607015e-34, 2.99792458e8, 1.380649e-23
    n = np.arange(1, 60)[:, None]
    kelvin = np.atleast_1d(np.asarray(kelvin, float))

    def below(um):
        x = h * c / (um * 1e-6 * k * kelvin)
        return np.sum(
            np.exp(-n * x) * (x**3 / n + 3 * x**2 / n**2 + 6 * x / n**3 + 6 / n**4), axis=0
        )

    return 2 * k**4 * kelvin**4 / (h**3 * c**2) * (below(high_um) - below(low_um))


@dataclass(frozen=True)
class Camera:
    """An infrared camera; its SiTF holds at 295.15 K (22 C)."""

    sitf_dn_per_k: float = 20.0
    band_um: tuple[float, float] | None = (8.0, 12.0)  # None: linear in temperature
    noise_k: dict = field(default_factory=lambda: dict(NOISE_K))
    shape: tuple[int, int, int] = (16, 64, 80)
    offset_dn: float = 2000.0
    bits: int | None = 14
    rate_hz: float | None = 30.0

    def mean_dn(self, blackbody_c):
        kelvin, at = np.asarray(blackbody_c, float) + 273.15, 295.15
        if self.band_um is None:
            return self.offset_dn + self.sitf_dn_per_k * (kelvin - at)
        slope = np.diff(band_radiance(*self.band_um, [at - 0.01, at + 0.01]))[0] / 0.02
        rise = band_radiance(*self.band_um, kelvin) - band_radiance(*self.band_um, at)
        return self.offset_dn + self.sitf_dn_per_k * rise / slope

    def pattern(self, rng):
        """Fixed pattern of the camera, equal in all its stacks, DN."""
        return sum(
            (self._part(rng, name, (1, *self.shape[1:])) for name in ("v", "h", "vh")), np.zeros(1)
        )

    def frames(self, rng, image_dn, pattern, *, frames=None):
        """Frames of an image or level, DN, with noise, digitised where the camera has bits."""
        shape = (frames or self.shape[0], *self.shape[1:])
        out = np.broadcast_to(image_dn, shape) + pattern
        out = out + sum(self._part(rng, name, shape) for name in ("t", "tv", "th", "tvh"))
        if self.bits is not None:
            out = np.clip(np.rint(out), 0, 2**self.bits - 1).astype(np.uint16)
        return self.stack(out)

    def stack(self, data):
        stamps = {} if self.rate_hz is None else {"time_s": np.arange(len(data)) / self.rate_hz}
        return FrameStack(
            data=data, full_scale_dn=None if self.bits is None else 2.0**self.bits - 1, **stamps
        )

    def _part(self, rng, name, shape):
        part_shape = [
            n if axis else 1 for n, axis in zip(shape, AXES.get(name, (1, 1, 1)), strict=True)
        ]
        return self.sitf_dn_per_k * self.noise_k[name] * rng.standard_normal(part_shape)


def entry(label, kind, stack, *, target=None, **conditions):
    return stack_in_memory(
        kind, stack, Conditions(**conditions), label=label, target=target or Target()
    )


def blackbody_session(
    camera, rng, temperatures_c, *, background_c=22.0, change=None, imager=None, more=()
):
    """Black-body flats at some temperatures; `change` alters the noiseless mean, DN, and noise of
    level i.
    """
    pattern, stacks = camera.pattern(rng), []
    for number, blackbody_c in enumerate(temperatures_c):
        level = camera.mean_dn(blackbody_c)
        stack = (
            camera.frames(rng, level, pattern) if change is None else change(number, level, pattern)
        )
        stacks.append(
            entry(f"bb-{number}", "flat", stack, blackbody_c=blackbody_c, background_c=background_c)
        )
    return session_in_memory((*stacks, *more), camera=imager, bit_depth=camera.bits)


def edge_frames(camera, rng, pattern, *, blur_px, angle_deg=5.0, contrast_k=8.0, frames=None):
    """Half-moon plate before the black body: a Gaussian-blurred edge, sampled at points (its blur
    holds the pixel).
    """
    from scipy.special import ndtr

    rows, cols = camera.shape[1:]
    row, col = np.mgrid[:rows, :cols]
    tilt = np.deg2rad(angle_deg)
    distance = (col - (cols - 1) / 2) * np.cos(tilt) + (row - (rows - 1) / 2) * np.sin(tilt)
    low, high = camera.mean_dn(22.0), camera.mean_dn(22.0 + contrast_k)
    return camera.frames(rng, low + (high - low) * ndtr(distance / blur_px), pattern, frames=frames)
