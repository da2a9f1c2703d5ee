"""Maps of a specimen: the fixed patterns of one camera, measured pixel by pixel, and their draws.

A measured map is m = p + n, a pattern p and the noise n of the mean of its frames. What is known of
p is what stands out of m by itself, k: polynomials of low order, and pixels and spots beyond
`OUTLIER_SD`. The remainder is Gaussian with the powers S(f) of the pattern and N(f) of the noise in
bands of spatial frequency, of rows, columns and all directions. Its posterior (Wiener 1949) has

    mean w (m - k),  variance w N,  w = S / (S + N),

so that a draw k + w (m - k) + sqrt(w N) e has the power S of the pattern, not the map's S + N.
Where noise hides the pattern, S < `LEAST_RATIO` N, nothing is known of its distribution: such a
band is left to the parameters of the type.
"""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.camera.parameters import Draws
from labdata.errors import BadInput
from labdata.frames import read_only

Array = NDArray[np.float64]

FILE = "maps.zarr"
# Deviation of a pixel or spot that is no normal value of its surroundings, robust standard
# deviations: 1 of 1.7 million normal values. Widths of spots, px: a pixel, dust, its halo.
OUTLIER_SD, SPOT_PX = 5.0, (0.0, 2.0, 6.0)
# Polynomials of smooth shading along an axis, and pixels that each needs (as of 3-D noise).
SHADING_ORDER, PIXELS_PER_ORDER = 4, 8
# Amplitudes along an axis in the band of lowest frequencies, of images and of lines, so that a band
# has some 30 or more; bands that are counted apart.
COARSEST, FINEST, CLASS = (8, 32), 21, 32
# Power of a pattern over that of the map's own noise from which a band is taken from the map: noise
# of 25 amplitudes exceeds a ratio of 1 + 4 once in 10,000 times (F of 25 and 25).
LEAST_RATIO = 4.0
# Bits of the map of defects.
IN_DARK, IN_LIGHT, NOISY = 1, 2, 4
# Units of the maps that have one, and of their standard deviations.
UNITS = {"offset_dn": "DN", "dark_rate_dn_per_s": "DN/s", "variance_dn2": "DN^2"}


def smooth_part(image: NDArray) -> Array:
    """Return products of polynomials along rows and columns fitted to an image, constant
    included.
    """
    down, across = (
        np.linalg.qr(
            np.polynomial.legendre.legvander(
                np.linspace(-1.0, 1.0, size), min(SHADING_ORDER, size // PIXELS_PER_ORDER)
            )
        )[0]
        for size in image.shape
    )
    return down @ (down.T @ image @ across) @ across.T


def bands_of(shape: tuple[int, int]) -> NDArray[np.int64]:
    """Return the band of each amplitude of a cosine transform, shape (row, col).

    Bands are octaves of means of columns, of means of rows and of all directions, the last from
    1/16 cy/px on in steps of 1/32.
    """
    down, across = (np.arange(size) / size for size in shape)
    frequency = np.hypot(down[:, None], across)  # half cycles per pixel
    octave = np.maximum(-np.floor(np.log2(np.maximum(frequency, 1e-9))).astype(np.int64) - 1, 0)
    in_image, in_lines = (int(np.log2(max(max(shape) / n, 1.0))) for n in COARSEST)
    fine = np.minimum((16.0 * frequency).astype(np.int64), FINEST)
    bands = np.where(frequency >= 0.125, fine, FINEST + np.minimum(octave, in_image))
    bands[0] = CLASS + np.minimum(octave[0], in_lines)
    bands[:, 0] = 2 * CLASS + np.minimum(octave[:, 0], in_lines)
    return bands


def power_of(image: NDArray) -> Array:
    """Return the mean square amplitude of an image in each band, shape (band,)."""
    from scipy.fft import dctn

    bands = bands_of((image.shape[0], image.shape[1])).ravel()
    amplitudes: Any = dctn(image, norm="ortho")
    squares = amplitudes.ravel() ** 2
    counts = np.bincount(bands, minlength=3 * CLASS)
    return np.bincount(bands, squares, minlength=3 * CLASS) / np.maximum(counts, 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelMap:
    """Measured map of one property of the pixels, with the powers of its pattern and its noise."""

    value: NDArray[np.float32]  #: as measured, shape (row, col)
    sd: NDArray[np.float32]  #: standard deviation of its noise, shape (row, col)
    power: tuple[float, ...] = ()  #: S of the pattern by band, square of the map's unit
    noise: tuple[float, ...] = ()  #: N of the noise by band
    #: Power over noise from which a band is taken from the map; 0: all are
    least_ratio: float = LEAST_RATIO

    def __post_init__(self) -> None:
        for name in ("value", "sd"):
            object.__setattr__(self, name, read_only(np.asarray(getattr(self, name), np.float32)))

    @cached_property
    def smooth(self) -> Array:
        """Shading, shape (row, col)."""
        return smooth_part(self.value)

    @cached_property
    def _spots(self) -> tuple[Array, NDArray[np.bool_]]:
        """Heights of pixels and spots that stand out of their surroundings, and which pixels do."""
        from scipy.ndimage import gaussian_filter

        residual = self.value - self.smooth
        heights, pixels = np.zeros_like(residual), np.zeros(residual.shape, bool)
        for width_px in SPOT_PX:
            blurred = gaussian_filter(residual, width_px) if width_px else residual
            sd = 1.4826 * float(np.median(np.abs(blurred)))
            if not width_px:
                sd = max(sd, float(np.median(self.sd)))
            beyond = np.abs(blurred) > OUTLIER_SD * sd
            pixels = pixels if width_px else beyond
            heights = heights + np.where(beyond, blurred, 0.0)
            residual = residual - np.where(beyond, blurred, 0.0)
        return heights, pixels

    @property
    def shown(self) -> NDArray[np.bool_]:
        """Whether a band shows more pattern than noise, shape (band,)."""
        return np.asarray(self.power) > self.least_ratio * np.asarray(self.noise)

    @cached_property
    def hidden_part(self) -> float:
        """Standard deviation of the pattern in the other bands, for which that of the type stands,
        over that in all bands.
        """
        bands = bands_of((self.value.shape[0], self.value.shape[1]))
        power = np.bincount(bands.ravel(), minlength=3 * CLASS) * np.asarray(self.power)
        return float(np.sqrt(power[~self.shown].sum() / max(power.sum(), 1e-300)))

    @property
    def outliers(self) -> NDArray[np.bool_]:
        """Whether a pixel is no normal value of the map, shape (row, col)."""
        return self._spots[1]

    @property
    def remainder(self) -> Array:
        """Map without shading and spots, shape (row, col)."""
        return self.value - self.smooth - self._spots[0]

    @cached_property
    def _amplitudes(self) -> tuple[Array, NDArray[np.int64]]:
        """Return the cosine transform of the remainder, and the band of each amplitude."""
        from scipy.fft import dctn

        bands = bands_of((self.value.shape[0], self.value.shape[1]))
        amplitudes: Any = dctn(self.remainder, norm="ortho")
        return amplitudes, bands

    @cached_property
    def mean(self) -> NDArray[np.float32]:
        """Posterior mean of the pattern, shape (row, col)."""
        return self._pattern(np.where(self.shown, self.power, 0.0))

    def draw(self, seed: int) -> NDArray[np.float32]:
        """Return a draw of the pattern from its posterior, shape (row, col).

        The power S of a band of n amplitudes is the difference of two mean squares, S + N and N,
        and drawn with its variance, 2/n ((S + N)^2 + N^2).
        """
        return _draw(self, seed)

    def _pattern(self, power: Array, rng: np.random.Generator | None = None) -> NDArray[np.float32]:
        """Return the mean of the pattern of a power by band, or a draw of it."""
        from scipy.fft import idctn

        (amplitudes, bands), noise = self._amplitudes, np.asarray(self.noise)
        weight = power / np.maximum(power + noise, 1e-300)
        gaussian = weight[bands] * amplitudes
        if rng is not None:
            sd = np.sqrt(weight * noise).astype(np.float32)
            gaussian += sd[bands] * rng.standard_normal(bands.shape, dtype=np.float32)
        pattern: Any = idctn(gaussian, norm="ortho")
        drawn = self.smooth + self._spots[0] + pattern
        return read_only(drawn.astype(np.float32))


@lru_cache(maxsize=6)
def _draw(measured: PixelMap, seed: int) -> NDArray[np.float32]:
    rng = np.random.default_rng([seed, 6])
    power, noise = np.asarray(measured.power), np.asarray(measured.noise)
    counts = np.bincount(measured._amplitudes[1].ravel(), minlength=3 * CLASS)
    sd = np.sqrt(2.0 / np.maximum(counts, 1)) * np.hypot(power + noise, noise)
    drawn = np.maximum(power + sd * rng.standard_normal(power.size), 0.0)
    return measured._pattern(np.where(measured.shown, drawn, 0.0), rng)


@dataclass(frozen=True, kw_only=True, eq=False)
class SpecimenMaps:
    """Maps of one camera: those that its frames support, the others None.

    With a tube `pattern` is all that flats show together: fibres, screen, and the chip. Without one
    that is `response`. Both are 1 on average and contain the shading of the flats' light, which is
    their smooth part; the rest belongs to the camera.
    """

    offset_dn: PixelMap | None = None  #: level without light over the black level, DN
    #: growth of that level with the exposure over the mean's, DN/s; None: no dark current shows
    dark_rate_dn_per_s: PixelMap | None = None
    response: PixelMap | None = None  #: signal over its mean
    variance_dn2: PixelMap | None = None  #: variance in time without light, DN^2
    pattern: PixelMap | None = None  #: signal of flats behind a tube over its mean
    #: which pixels stand out: bits `IN_DARK`, `IN_LIGHT` and `NOISY`, shape (row, col)
    defect: NDArray[np.uint8] | None = None
    #: numbers of the frames that the maps were measured from, by label of the stack
    frames: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    #: CRC-32 of the first of them, by which their session is known again
    checksums: Mapping[str, int] = field(default_factory=dict)
    origin: tuple[int, int] = (0, 0)  #: first row and column of the maps within the frame
    corner: tuple[int, int] = (0, 0)  #: those of the camera's picture within the frame
    pitch_px: int = 1  #: distance of the maps' samples in pixels of the camera
    notes: tuple[str, ...] = ()  #: what the maps contain, and how they are used

    @property
    def light(self) -> PixelMap | None:
        """Map of what flats show."""
        return self.response or self.pattern

    def planes(self) -> dict[str, NDArray]:
        """Return the maps and their standard deviations by name, shape (row, col)."""
        planes = {} if self.defect is None else {"defect": self.defect}
        for name in MAPS:
            if (measured := getattr(self, name)) is not None:
                planes |= {name: measured.value, f"{name}_sd": measured.sd}
        return planes

    def window(self, image: NDArray, shape: tuple[int, int], neutral: float) -> NDArray[np.float32]:
        """Return a map's part under the camera's picture, `neutral` where the map shows nothing."""
        out = np.full(shape, neutral, np.float32)
        starts = [at - first for at, first in zip(self.corner, self.origin, strict=True)]
        inside = [
            (max(start, 0), min(start + length, size))
            for start, length, size in zip(starts, shape, image.shape, strict=True)
        ]
        rows, cols = (
            slice(low - start, max(high, low) - start)
            for (low, high), start in zip(inside, starts, strict=True)
        )
        out[rows, cols] = image[tuple(slice(low, max(high, low)) for low, high in inside)]
        return out


MAPS = tuple(item.name for item in fields(SpecimenMaps) if "PixelMap" in str(item.type))


def _digest_of(draws: Draws) -> str:
    """Return a digest of the draws of a fitted camera, by which its maps are known."""
    return sha256(json.dumps([draws.names, draws.values]).encode()).hexdigest()


def save_maps(maps: SpecimenMaps, draws: Draws, sensor: Path) -> Path:
    """Write maps next to the file of their fitted sensor, which its draws identify; return the
    path.
    """
    import zarr

    path = sensor.with_name(FILE)
    half = path.with_name(f".{FILE}.half")
    shutil.rmtree(half, ignore_errors=True)
    group = zarr.open_group(half, mode="w")
    for name, plane in maps.planes().items():
        group.create_array(name, data=np.asarray(plane))
    bands = {
        name: {key: getattr(measured, key) for key in ("power", "noise", "least_ratio")}
        for name in MAPS
        if (measured := getattr(maps, name)) is not None
    }
    group.attrs.update(
        {
            "draws": _digest_of(draws),
            "bands": bands,
            "frames": {label: list(numbers) for label, numbers in maps.frames.items()},
            "checksums": dict(maps.checksums),
            "origin": list(maps.origin),
            "pitch_px": maps.pitch_px,
            "notes": list(maps.notes),
        }
    )
    shutil.rmtree(path, ignore_errors=True)
    half.replace(path)
    return path


def load_maps(draws: Draws, sensor: Path) -> SpecimenMaps | None:
    """Read the maps next to the file of a fitted sensor; None where there are none, or those of
    another fit.
    """
    path = sensor.with_name(FILE)
    if not draws.values or not path.is_dir():
        return None
    import zarr

    try:
        group: Any = zarr.open_group(path, mode="r")
        known = group.attrs.asdict()
        if known["draws"] != _digest_of(draws):
            return None
        measured: dict[str, Any] = {
            name: PixelMap(
                value=group[name][:],
                sd=group[f"{name}_sd"][:],
                **{key: tuple(power) for key, power in powers.items() if key != "least_ratio"},
                least_ratio=powers["least_ratio"],
            )
            for name, powers in known["bands"].items()
        }
        return SpecimenMaps(
            **measured,
            defect=group["defect"][:] if "defect" in group else None,
            frames={label: tuple(numbers) for label, numbers in known["frames"].items()},
            checksums=known["checksums"],
            origin=tuple(known["origin"]),
            pitch_px=known["pitch_px"],
            notes=tuple(known["notes"]),
        )
    except Exception:
        raise BadInput(
            "maps of a specimen must be those that a fit writes, got damaged ones in "
            f"{path}: fit the session again"
        ) from None
