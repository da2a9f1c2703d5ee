"""Bloom map: fraction of every pixel's signal that entered the camera elsewhere."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.bloom.clipped_sources import ClippedSource, find_clipped_sources
from charact.bloom.point_stack import full_scale_of
from charact.bloom.posterior_psf import FrameGrid, PosteriorPsf, density_matrix, nodes, profiles, radial, spread_of
from charact.method import Context
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Result
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Light within this distance of its entry is not blooming: about a pixel of a thermal imager next to the camera.
NEAR_PX = 3.0
# Transfer below which noise is not amplified.
LEAST_TRANSFER = 0.03
# Uncertainty of the halo radius, and blurred margin around a patch, px.
SMALLER_PX, PATCH_MARGIN_PX = 0.5, 4.0


@dataclass(frozen=True, kw_only=True)
class BloomMap:
    """Fraction of every pixel's signal that is blooming.

    `fraction`: blooming over total signal, mean over the draws, shape (row, col), 0 to 1; NaN where unknown: near a
    clipped source of unknown signal, and without signal; `sd`: standard deviation over draws of the PSF and pixel
    noise, shape (row, col); NaN likewise; `blooming_dn`: blooming, DN above dark, mean over the draws, shape (row,
    col); NaN where unknown; `clipped`: pixels at full scale, shape (row, col); their signal is reconstructed;
    `near_border`: pixels within the range of sources outside the frame, shape (row, col); `sources`: the clipped
    sources; `near_px`: distance within which light is not blooming, column pitches; `noise_dn`: standard deviation of
    every pixel's noise, DN, shape (row, col).
    """

    fraction: NDArray[np.float32]
    sd: NDArray[np.float32]
    blooming_dn: NDArray[np.float32]
    clipped: Mask
    near_border: Mask
    sources: tuple[ClippedSource, ...]
    near_px: float
    noise_dn: NDArray[np.float32]

    @property
    def unknown(self) -> Mask:
        """Pixels without a result."""
        return np.isnan(self.fraction)


def bloom_map(
    signal: NDArray,
    spread: PosteriorPsf,
    *,
    clip_dn: float | None = None,
    clipped: Mask | None = None,
    noise_dn: ArrayLike | None = None,
    near_px: float = NEAR_PX,
    pitch_ratio: float = 1.0,
    most_draws: int = 30,
    rng: np.random.Generator,
) -> BloomMap:
    """Return the fraction of every pixel's signal that is blooming.

    Parameters
    ----------
    signal
        Frame, mean frame or expected image of a scene, above dark, shape (row, col), DN.
    spread
        Draws of the camera's PSF.
    clip_dn
        Full scale above dark, DN; None: nothing is clipped.
    clipped
        Pixels at full scale, shape (row, col); None: those near `clip_dn`. Required for a mean of partly clipped
        frames.
    noise_dn
        Standard deviation of a pixel's noise, DN, one number or per pixel; None: estimated from the frame.
    near_px
        Distance within which light is not blooming, column pitches.
    pitch_ratio
        Row pitch over column pitch.
    most_draws
        Maximum number of PSF draws.
    rng
        Generator of the noise in the signal of clipped sources.

    Raises
    ------
    BadInput
        If the frame is not two-dimensional or a number is not positive.

    Notes
    -----
    With P the transfer of the PSF and N that of its part within `near_px`, a frame S = P L of light L contains N L =
    (N/P) S that is not blooming; N/P is 1 where P is so small that S is noise. The light of clipped sources is
    estimated first, see `charact.bloom.clipped_sources`. The surroundings of the frame have its median signal.
    """
    _check(signal, near_px=near_px, pitch_ratio=pitch_ratio, clip_dn=clip_dn)
    image, spread = np.asarray(signal, np.float32), spread.subsample(most_draws)
    noise = pixel_noise(image) if noise_dn is None else np.broadcast_to(np.asarray(noise_dn, np.float32), image.shape)
    if clipped is None:
        clipped = np.zeros(image.shape, bool) if clip_dn is None else image >= 0.985 * clip_dn
    halo_px = 0.5 * float(spread.halo_diameter_px.max())
    lattice = FrameGrid(shape=(image.shape[0], image.shape[1]), room_px=int(halo_px + 20), pitch_ratio=pitch_ratio)
    sources = ()
    if clip_dn is not None and clipped.any():
        sources = find_clipped_sources(image, clipped, spread, lattice, noise_dn=noise, clip_dn=clip_dn, rng=rng)
    count, mean, square, bloom = 0, 0.0, 0.0, 0.0
    for far, total in _draws(image, clipped, clip_dn, sources, spread, lattice, near_px):
        share = np.clip(far / np.maximum(total, 1e-6), 0.0, 1.0)
        count, mean, square, bloom = count + 1, mean + share, square + share * share, bloom + far
    mean, bloom = mean / count, bloom / count
    of_noise = np.where(clipped, 0.0, mean * noise / np.maximum(image, noise))
    # Signal is counted pixel by pixel, so that no fraction is known better than 0.003.
    variance = np.maximum(square / count - mean**2, 0.0) + of_noise**2 + 0.003**2
    # Without signal there is no fraction: at least two standard deviations of a pixel's noise.
    unknown = image < 2.0 * noise
    for source in sources:
        if source.has_known_signal and source.shape == "patch":
            rows, cols = np.divmod(source.region, lattice.shape[1])
            # Next to a patch the fraction depends on its edge, which clipping hides to within a pixel.
            variance += 0.12**2 * (_within(rows, cols, PATCH_MARGIN_PX, lattice) & ~clipped)
        if not source.has_known_signal:
            unknown |= _pixels_of_unknown_source(source, image, spread.centre(), lattice, halo_px)
    return BloomMap(
        fraction=np.where(unknown, np.nan, mean).astype(np.float32),
        sd=np.where(unknown, np.nan, np.sqrt(variance)).astype(np.float32),
        blooming_dn=np.where(unknown, np.nan, bloom).astype(np.float32),
        clipped=clipped,
        near_border=_near_border(lattice, halo_px),
        sources=sources,
        near_px=near_px,
        noise_dn=noise,
    )


def _check(signal: NDArray, *, clip_dn: float | None, **positive: float) -> None:
    if np.ndim(signal) != 2 or min(np.shape(signal)) < 8:
        raise BadInput(f"a bloom map needs a frame of at least 8 rows and columns, got shape {np.shape(signal)}")
    given = positive if clip_dn is None else {**positive, "clip_dn": clip_dn}
    for name, value in given.items():
        if not value > 0:
            raise BadInput(f"{name} must be positive, got {value:g}")


def pixel_noise(image: NDArray) -> NDArray[np.float32]:
    """Estimate every pixel's noise, DN, shape (row, col); its variance is linear in the signal.

    Noise comes from second differences along rows, of pixels separated by more than the blur, in groups of similar
    signal.
    """
    lag = 4
    low, middle, high = image[:, : -2 * lag], image[:, lag:-lag], image[:, 2 * lag :]
    light = (low + middle + high).ravel() / 3.0
    second = np.abs(low - 2.0 * middle + high).ravel()
    order = np.argsort(light)
    groups = [group for group in np.array_split(order, 8) if len(group)]
    mean = np.array([max(0.0, float(light[group].mean())) for group in groups])
    variance = np.array([(1.4826 * float(np.median(second[group]))) ** 2 / 6.0 for group in groups])
    # Bright groups include edges: the law passes through the darkest group and has the median slope.
    rise = (variance - variance[0]) / np.maximum(mean - mean[0], 1e-3)
    slope = max(0.0, float(np.median(rise[1:])))
    return np.sqrt(np.maximum(variance[0] + slope * np.maximum(image - mean[0], 0.0), 1e-6)).astype(np.float32)


def _draws(
    image: NDArray,
    clipped: Mask,
    clip_dn: float | None,
    sources: tuple[ClippedSource, ...],
    spread: PosteriorPsf,
    lattice: FrameGrid,
    near_px: float,
) -> Iterator[tuple[NDArray, NDArray]]:
    """Blooming and total signal of every pixel, draw by draw."""
    background, glare = float(np.median(image)), np.asarray(spread.glare_fraction)
    tables = _Tables(
        whole=spread.transfer(lattice.frequency),
        near=spread.transfer(nodes()[0]) @ _near_transform(lattice.frequency, near_px),
        profile=(profiles(spread) * lattice.pitch_ratio).astype(np.float32),
    )
    known = [source for source in sources if source.has_known_signal]
    prints = [_footprint(source, lattice) for source in known]
    for draw in range(len(spread)):
        hidden, hidden_near = np.zeros_like(image), np.zeros_like(image)
        for source, footprint in zip(known, prints, strict=True):
            rows, cols, radius = footprint
            amount = np.float32(source.light_dn_px[draw])
            all_of_it, part = _of_source(source, radius, tables, draw, lattice, near_px)
            hidden[rows, cols] += amount * all_of_it
            hidden_near[rows, cols] += amount * part
        rest = np.where(clipped, np.float32(0.0), image - np.float32(background) - hidden)
        light = sum(float(source.light_dn_px[draw]) for source in known) / (1.0 - glare[draw])
        veil = _veil(float(glare[draw]), spread.glare_area_px or float(image.size),
                     float(rest.sum()) + background * image.size, light, image.size)  # fmt: skip
        whole, near = tables.whole[draw], tables.near[draw]
        ratio = (near * whole + LEAST_TRANSFER**2) / (whole**2 + LEAST_TRANSFER**2)
        belongs = lattice.filter(lattice.forward_transform(rest), ratio) + np.float32(ratio[0] * (background - veil))
        total = image
        if clipped.any():
            total = np.where(clipped, np.maximum(hidden + np.float32(background), np.float32(clip_dn or 0.0)), image)
        yield np.maximum(total - belongs - hidden_near, np.float32(0.0)), total


@dataclass(frozen=True, kw_only=True)
class _Tables:
    """Per draw: transfer functions of the whole PSF and of its part near the centre, and PSF by distance."""

    whole: Array
    near: Array
    profile: NDArray[np.float32]


def _veil(glare: float, area: float, rest: float, hidden: float, pixels: int) -> float:
    """Veiling glare per pixel, DN, for given signals outside and inside of clipped sources."""
    outside = rest / (1.0 - glare + glare * min(1.0, pixels / area))
    return glare * (outside + hidden) / area


def _footprint(source: ClippedSource, lattice: FrameGrid) -> tuple[slice, slice, NDArray[np.float32] | None]:
    """Pixels lit by a source, and their distances from it; None for a patch, which covers the frame."""
    if source.shape != "point":
        return slice(None), slice(None), None
    rows, cols = lattice.around(source.row, source.col)
    return rows, cols, lattice.distance(source.row, source.col)[rows, cols].astype(np.float32)


def _of_source(
    source: ClippedSource,
    radius: NDArray[np.float32] | None,
    tables: _Tables,
    draw: int,
    lattice: FrameGrid,
    near_px: float,
) -> tuple[NDArray, NDArray]:
    """Image of a unit source: in total, and the part that belongs to its pixels."""
    if radius is None:
        return lattice.patch(source.illuminated_pixels, tables.whole[draw]), lattice.patch(
            source.illuminated_pixels, tables.near[draw]
        )
    found = radial(radius, tables.profile[draw])
    return found, found * (radius <= near_px)


def _near_transform(frequency: Array, near_px: float) -> Array:
    """Matrix from a transfer function on `nodes` to that of the PSF within a distance, shape (node, frequency)."""
    from scipy.special import j0

    steps = 48
    radius = (np.arange(steps) + 0.5) * near_px / steps
    ring = 2.0 * np.pi * radius * near_px / steps
    return density_matrix(radius) @ (ring[:, None] * j0(2.0 * np.pi * np.outer(radius, frequency)))


def _pixels_of_unknown_source(
    source: ClippedSource, image: NDArray, one: PosteriorPsf, lattice: FrameGrid, halo_px: float
) -> Mask:
    """Pixels in which a source of unknown signal may exceed `REACHED` of the total."""
    rows, cols = np.divmod(source.region, lattice.shape[1])
    near, away = _within(rows, cols, halo_px, lattice), lattice.distance(source.row, source.col)
    veil = float(np.asarray(one.glare_fraction)[0]) / (one.glare_area_px or float(image.size))
    if source.shape == "point":
        profile = profiles(one)[0] * lattice.pitch_ratio
        # A smaller halo would contain more light for the same signal.
        share, least = radial(away, profile), radial(away + SMALLER_PX, profile)
        clear = ~_within(rows, cols, SMALLER_PX + 1.0, lattice)
    else:
        share = least = lattice.patch(source.illuminated_pixels, one.transfer(lattice.frequency)[0])
        clear = ~_within(rows, cols, PATCH_MARGIN_PX, lattice)
    share, least = np.maximum(share, 0.0) + veil, np.maximum(least, 0.0) + veil
    ring = (away / 2.0).astype(int).ravel()
    count = np.bincount(ring)
    signal, of_unit = (np.bincount(ring, of.ravel()) / np.maximum(count, 1) for of in (image, least))
    complete = np.bincount(ring, ~clear.ravel()) == 0
    most = (signal[complete] / np.maximum(of_unit[complete], 1e-12)).min(initial=np.inf)
    # Unknown where the source may exceed 5 % of the pixel's signal.
    return near | (most * share > 0.05 * np.maximum(image, 1e-6))


def _within(rows: NDArray, cols: NDArray, reach: float, lattice: FrameGrid) -> Mask:
    """Pixels within a distance of given pixels."""
    from scipy import ndimage

    away = np.ones(lattice.shape, bool)
    away[rows, cols] = False
    found = ndimage.distance_transform_edt(away, sampling=(lattice.pitch_ratio, 1.0))
    return np.asarray(found) <= reach


def _near_border(lattice: FrameGrid, halo_px: float) -> Mask:
    """Pixels closer to the border than the halo radius."""
    out = np.ones(lattice.shape, bool)
    down, across = int(np.ceil(halo_px / lattice.pitch_ratio)), int(np.ceil(halo_px))
    out[down : lattice.shape[0] - down, across : lattice.shape[1] - across] = False
    return out


def spread_from(result: Result, *, area_px: float, pitch_ratio: float = 1.0, rng: np.random.Generator) -> PosteriorPsf:
    """Return the point spread functions described by the measurements of a point series.

    `result`: result of `charact.bloom.measure`; `area_px`: pixels of a frame, the area of the veiling glare;
    `pitch_ratio`: row pitch over column pitch; `rng`: generator of the glare's draws. Raises BadInput if the result has
    no posterior of core and halo.
    """
    posterior = _posterior(result)
    found = [m for m in result.find("veiling_glare") if m.value is not None and m.interval68 is not None]
    glare = np.zeros(len(posterior.draws))
    if found and found[0].value is not None and found[0].interval68 is not None:
        low, high = found[0].interval68
        glare = 0.01 * np.clip(rng.normal(found[0].value, 0.5 * (high - low), len(glare)), 0.0, 99.0)
    return spread_of(posterior, pitch_ratio=pitch_ratio, glare_fraction=glare, glare_area_px=area_px)


def _posterior(result: Result) -> Posterior:
    """The posterior of core and halo."""
    for one in result.find("halo_fraction") + result.find("halo_diameter"):
        if one.posterior is not None and "halo_fraction" in one.posterior.names:
            return one.posterior
    reasons = [str(m.reason) for m in result.find("halo_diameter") if m.reason]
    raise BadInput(f"a bloom map needs the halo of a point series: {'; '.join(reasons) or 'none was measured'}")


def map_of(session: Session, result: Result, *, label: str | None = None, context: Context) -> tuple[BloomMap, NDArray]:
    """Return the bloom map of a stack's mean frame, and that frame above dark, shape (row, col), DN.

    Parameters
    ----------
    session
        Session with the stack, a point series and preferably darks.
    result
        Result of `charact.bloom.measure` on it.
    label
        Stack; None: the scene, else the brightest point source.
    context
        Seed, full scale and pitches.

    Raises
    ------
    BadInput
        If there is no such stack, or no halo was measured.
    """
    entry = _entry(session, label)
    stack = entry.read()
    full = full_scale_of(stack, context)
    dark = _dark_dn(session, entry, stack)
    rng = np.random.default_rng(context.seed)
    signal = stack.data.mean(axis=0, dtype=np.float64) - dark
    spread = spread_from(result, area_px=float(signal.size), pitch_ratio=context.pitch_ratio, rng=rng)
    # Above 2 % of clipped frames the mean of a pixel underestimates its signal.
    clipped = (stack.data >= full).mean(axis=0) > 0.02
    found = bloom_map(signal, spread, clip_dn=full - dark, clipped=clipped, pitch_ratio=context.pitch_ratio, rng=rng)
    return found, signal


def _entry(session: Session, label: str | None) -> StackEntry:
    """The requested stack, or the default one."""
    if label is not None:
        found = [entry for entry in session.stacks if entry.label == label]
        if not found:
            names = ", ".join(entry.label for entry in session.stacks)
            raise BadInput(f"the stack of a map must be one of {names}, got {label!r}")
        return found[0]
    scenes = session.of_kind("scene")
    found = scenes or session.of_kind("point")
    if not found:
        raise BadInput("a bloom map needs a stack of kind scene or point")
    return max(found, key=lambda entry: (entry.conditions.illuminance_lux or 0.0) * (entry.conditions.gate_ns or 1.0))


def _dark_dn(session: Session, entry: StackEntry, stack: FrameStack) -> float:
    """Black level: that of matching darks, as recorded, else the first percentile of the frame, DN."""
    dark = session.dark_like(entry.conditions)
    if dark is not None:
        return dark.read().mean_dn
    if stack.black_level_dn is not None:
        return float(stack.black_level_dn)
    return float(np.percentile(stack.data, 1.0))


def evidence_of(found: BloomMap, signal: NDArray) -> dict[str, Any]:
    """Figure data of a map for `charact.report.bloom_images.bloom_map`."""
    return {
        "figure": "bloom-map",
        "signal_dn": signal,
        "fraction": found.fraction,
        "sd": found.sd,
        "clipped": found.clipped,
        "near_px": found.near_px,
        "sources": [
            {"row": s.row, "col": s.col, "shape": s.shape, "known": s.has_known_signal, "reason": s.reason,
             "light_dn_px": float(np.median(s.light_dn_px))}
            for s in found.sources
        ],
    }  # fmt: skip
