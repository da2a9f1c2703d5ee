"""Bloom map: fraction of every pixel's signal that entered the camera elsewhere."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.estimators.bloom.clipped_sources import ClippedSource, find_clipped_sources
from charact.estimators.bloom.posterior_psf import (
    FrameGrid,
    PosteriorPsf,
    density_matrix,
    nodes,
    profiles,
    radial,
    spread_of,
)
from charact.frames.robust import robust_sd
from charact.frames.stack import Stack
from charact.method import Context
from labdata import Array, BadInput, Mask, Result, Session, StackEntry

# Light within this distance of its entry is not blooming: about a pixel of a thermal imager next to
# the camera.
NEAR_PX = 3.0
# Transfer below which noise is not amplified.
LEAST_TRANSFER = 0.03
# Uncertainty of the halo radius, and blurred margin around a patch, px.
SMALLER_PX, PATCH_MARGIN_PX = 0.5, 4.0


@dataclass(frozen=True, kw_only=True)
class BloomMap:
    """Fraction of every pixel's signal that is blooming.

    `fraction`: blooming over total signal, mean over the draws, shape (row, col), 0 to 1; NaN where
    unknown: near a clipped source of unknown signal, and without signal; `sd`: standard deviation
    over draws of the PSF and pixel noise, shape (row, col); NaN likewise; `blooming_dn`: blooming,
    DN above dark, mean over the draws, shape (row, col); NaN where unknown; `clipped`: pixels at
    full scale, shape (row, col); their signal is reconstructed; `near_border`: pixels within the
    range of sources outside the frame, shape (row, col); `sources`: the clipped sources; `near_px`:
    distance within which light is not blooming, column pitches.
    """

    fraction: NDArray[np.float32]
    sd: NDArray[np.float32]
    blooming_dn: NDArray[np.float32]
    clipped: Mask
    near_border: Mask
    sources: tuple[ClippedSource, ...]
    near_px: float

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
        Pixels at full scale, shape (row, col); None: those near `clip_dn`. Required for a mean of
        partly clipped frames.
    noise_dn
        Standard deviation of a pixel's noise, DN, one number or per pixel; None: estimated from the
        frame.
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
    With P the transfer of the PSF and N that of its part within `near_px`, a frame S = P L of light
    L contains N L = (N/P) S that is not blooming; N/P is 1 where P is so small that S is noise. The
    light of clipped sources is estimated first, see `charact.estimators.bloom.clipped_sources`. The
    surroundings of the frame have its median signal.
    """
    _check(signal, near_px=near_px, pitch_ratio=pitch_ratio, clip_dn=clip_dn)
    image, spread = np.asarray(signal, np.float32), spread.subsample(most_draws)
    noise = (
        pixel_noise(image)
        if noise_dn is None
        else np.broadcast_to(np.asarray(noise_dn, np.float32), image.shape)
    )
    if clipped is None:
        clipped = image >= np.float32(np.inf if clip_dn is None else clip_dn)
    halo_px = 0.5 * float(spread.halo_diameter_px.max())
    grid = FrameGrid(
        shape=(image.shape[0], image.shape[1]), room_px=int(halo_px + 20), pitch_ratio=pitch_ratio
    )
    sources = ()
    if clip_dn is not None and clipped.any():
        sources = find_clipped_sources(
            image, clipped, spread, grid, noise_dn=noise, clip_dn=clip_dn, rng=rng
        )
    count, mean, square, bloom = 0, 0.0, 0.0, 0.0
    for blooming_dn, total in _draws(image, clipped, clip_dn, sources, spread, grid, near_px):
        draw_fraction = np.clip(blooming_dn / np.maximum(total, 1e-6), 0.0, 1.0)
        count, mean, square, bloom = (
            count + 1,
            mean + draw_fraction,
            square + draw_fraction * draw_fraction,
            bloom + blooming_dn,
        )
    mean, bloom = mean / count, bloom / count
    of_noise = np.where(clipped, 0.0, mean * noise / np.maximum(image, noise))
    # Signal is counted pixel by pixel, so that no fraction is known better than 0.003.
    variance = np.maximum(square / count - mean**2, 0.0) + of_noise**2 + 0.003**2
    # Without signal there is no fraction: at least two standard deviations of a pixel's noise.
    unknown = image < 2.0 * noise
    for source in sources:
        if not source.has_known_signal:
            unknown |= _pixels_of_unknown_source(source, image, spread.centre(), grid, halo_px)
        elif source.shape == "patch":
            # Next to a patch the fraction depends on its edge, which clipping hides to within a
            # pixel.
            variance += 0.12**2 * (grid.within(source.region, PATCH_MARGIN_PX) & ~clipped)
    near_border = np.ones(image.shape, bool)
    down, across = int(np.ceil(halo_px / pitch_ratio)), int(np.ceil(halo_px))
    near_border[down : image.shape[0] - down, across : image.shape[1] - across] = False
    return BloomMap(
        fraction=np.where(unknown, np.nan, mean).astype(np.float32),
        sd=np.where(unknown, np.nan, np.sqrt(variance)).astype(np.float32),
        blooming_dn=np.where(unknown, np.nan, bloom).astype(np.float32),
        clipped=clipped,
        near_border=near_border,
        sources=sources,
        near_px=near_px,
    )


def _check(signal: NDArray, *, clip_dn: float | None, **positive: float) -> None:
    if np.ndim(signal) != 2 or min(np.shape(signal)) < 8:
        raise BadInput(
            f"a bloom map needs a frame of at least 8 rows and columns, got shape "
            f"{np.shape(signal)}"
        )
    positive_numbers = positive if clip_dn is None else {**positive, "clip_dn": clip_dn}
    for name, value in positive_numbers.items():
        if not value > 0:
            raise BadInput(f"{name} must be positive, got {value:g}")


def pixel_noise(image: NDArray) -> NDArray[np.float32]:
    """Estimate every pixel's noise, DN, shape (row, col); its variance is linear in the signal.

    Noise comes from second differences along rows, of pixels separated by more than the blur, in
    groups of similar signal.
    """
    lag = 4
    low, middle, high = image[:, : -2 * lag], image[:, lag:-lag], image[:, 2 * lag :]
    light = (low + middle + high).ravel() / 3.0
    second = np.abs(low - 2.0 * middle + high).ravel()
    groups = [group for group in np.array_split(np.argsort(light), 8) if len(group)]
    mean = np.array([max(0.0, float(light[group].mean())) for group in groups])
    variance = np.array([robust_sd(second[group], 0.0) ** 2 / 6.0 for group in groups])
    # Bright groups include edges: the law passes through the darkest group and has the median
    # slope.
    rise = (variance - variance[0]) / np.maximum(mean - mean[0], 1e-3)
    slope = max(0.0, float(np.median(rise[1:])))
    return np.sqrt(np.maximum(variance[0] + slope * np.maximum(image - mean[0], 0.0), 1e-6)).astype(
        np.float32
    )


def _draws(
    image: NDArray,
    clipped: Mask,
    clip_dn: float | None,
    sources: tuple[ClippedSource, ...],
    spread: PosteriorPsf,
    grid: FrameGrid,
    near_px: float,
) -> Iterator[tuple[NDArray, NDArray]]:
    """Blooming and total signal of every pixel, draw by draw."""
    background, glares = float(np.median(image)), np.asarray(spread.glare_fraction)
    wholes, tables = (
        spread.transfer(grid.frequency),
        (profiles(spread) * grid.pitch_ratio).astype(np.float32),
    )
    nears = spread.transfer(nodes()[0]) @ _near_transform(grid.frequency, near_px)
    known = [source for source in sources if source.has_known_signal]
    windows = [
        grid.around(source.row, source.col) if source.shape == "point" else np.s_[:, :]
        for source in known
    ]
    radii = [
        grid.distance(source.row, source.col)[window].astype(np.float32)
        for source, window in zip(known, windows, strict=True)
    ]
    area = spread.glare_area_px or float(image.size)
    for draw, (psf_transfer, near_transfer, table, glare) in enumerate(
        zip(wholes, nears, tables, glares, strict=True)
    ):
        hidden, hidden_near = np.zeros_like(image), np.zeros_like(image)
        for source, window, radius in zip(known, windows, radii, strict=True):
            if source.shape == "point":
                image_of = radial(radius, table)
                near_of = image_of * (radius <= near_px)
            else:
                image_of, near_of = (
                    grid.patch(source.illuminated_pixels, transfer)
                    for transfer in (psf_transfer, near_transfer)
                )
            amount = np.float32(source.light_dn_px[draw])
            hidden[window] += amount * image_of
            hidden_near[window] += amount * near_of
        unclipped_signal = np.where(
            clipped, np.float32(0.0), image - np.float32(background) - hidden
        )
        # Veiling glare per pixel, for the signals outside and inside of clipped sources.
        light = sum(float(source.light_dn_px[draw]) for source in known) / (1.0 - glare)
        unclipped_light = float(unclipped_signal.sum()) + background * image.size
        veil = (
            glare
            * (unclipped_light / (1.0 - glare + glare * min(1.0, image.size / area)) + light)
            / area
        )
        ratio = (near_transfer * psf_transfer + LEAST_TRANSFER**2) / (
            psf_transfer**2 + LEAST_TRANSFER**2
        )
        belongs = grid.blur(unclipped_signal, ratio) + np.float32(ratio[0] * (background - veil))
        total = image
        if clipped.any():
            total = np.where(
                clipped,
                np.maximum(hidden + np.float32(background), np.float32(clip_dn or 0.0)),
                image,
            )
        yield np.maximum(total - belongs - hidden_near, np.float32(0.0)), total


def _near_transform(frequency: Array, near_px: float) -> Array:
    """Matrix from a transfer function on `nodes` to that of the PSF within a distance, shape (node,
    frequency).
    """
    from scipy.special import j0

    steps = 48
    radius = (np.arange(steps) + 0.5) * near_px / steps
    ring = 2.0 * np.pi * radius * near_px / steps
    return density_matrix(radius) @ (ring[:, None] * j0(2.0 * np.pi * np.outer(radius, frequency)))


def _pixels_of_unknown_source(
    source: ClippedSource, image: NDArray, psf: PosteriorPsf, grid: FrameGrid, halo_px: float
) -> Mask:
    """Pixels in which a source of unknown signal may exceed 5 % of the total."""
    distance = grid.distance(source.row, source.col)
    veil = float(np.asarray(psf.glare_fraction)[0]) / (psf.glare_area_px or float(image.size))
    if source.shape == "point":
        profile, margin = profiles(psf)[0] * grid.pitch_ratio, SMALLER_PX + 1.0
        # A smaller halo would contain more light for the same signal.
        unit_signal, smallest_unit_signal = (
            radial(distance, profile),
            radial(distance + SMALLER_PX, profile),
        )
    else:
        unit_signal = smallest_unit_signal = grid.patch(
            source.illuminated_pixels, psf.transfer(grid.frequency)[0]
        )
        margin = PATCH_MARGIN_PX
    unit_signal, smallest_unit_signal = (
        np.maximum(unit_signal, 0.0) + veil,
        np.maximum(smallest_unit_signal, 0.0) + veil,
    )
    ring = (distance / 2.0).astype(int).ravel()
    count = np.bincount(ring)
    signal, of_unit = (
        np.bincount(ring, of.ravel()) / np.maximum(count, 1) for of in (image, smallest_unit_signal)
    )
    complete = np.bincount(ring, grid.within(source.region, margin).ravel()) == 0
    light_limit = (signal[complete] / np.maximum(of_unit[complete], 1e-12)).min(initial=np.inf)
    return grid.within(source.region, halo_px) | (
        light_limit * unit_signal > 0.05 * np.maximum(image, 1e-6)
    )


def spread_from(
    result: Result, *, area_px: float, pitch_ratio: float = 1.0, rng: np.random.Generator
) -> PosteriorPsf:
    """Return the point spread functions described by the measurements of a point series.

    `result`: result of `charact.estimators.bloom.measure`; `area_px`: pixels of a frame, the area
    of the veiling glare; `pitch_ratio`: row pitch over column pitch; `rng`: generator of the
    glare's draws. Raises BadInput if the result has no posterior of core and halo.
    """
    posteriors = [
        measurement.posterior
        for measurement in result.find("halo_fraction") + result.find("halo_diameter")
    ]
    posterior = next(
        (draws for draws in posteriors if draws is not None and "halo_fraction" in draws.names),
        None,
    )
    if posterior is None:
        reasons = "; ".join(str(m.reason) for m in result.find("halo_diameter") if m.reason)
        raise BadInput(
            f"a bloom map needs the halo of a point series: {reasons or 'none was measured'}"
        )
    glare = np.zeros(len(posterior.draws))
    for measurement in result.find("veiling_glare")[:1]:
        if measurement.value is not None and measurement.interval68 is not None:
            low, high = measurement.interval68
            glare = 0.01 * np.clip(
                rng.normal(measurement.value, 0.5 * (high - low), len(glare)), 0.0, 99.0
            )
    return spread_of(
        posterior, pitch_ratio=pitch_ratio, glare_fraction=glare, glare_area_px=area_px
    )


def map_of(
    session: Session, result: Result, *, label: str | None = None, context: Context
) -> tuple[BloomMap, NDArray]:
    """Return the bloom map of a stack's mean frame, and that frame above dark, shape (row, col),
    DN.

    Parameters
    ----------
    session
        Session with the stack, a point series and preferably darks.
    result
        Result of `charact.estimators.bloom.measure` on it.
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
    stack = Stack.of(entry.read(), context)
    black = session.dark_like(entry.conditions)
    dark, _ = stack.black_level_dn(None if black is None else black.read().mean_dn)
    rng = np.random.default_rng(context.seed)
    signal = stack.mean_frame_dn - dark
    spread = spread_from(
        result, area_px=float(signal.size), pitch_ratio=context.pitch_ratio, rng=rng
    )
    frame_map = bloom_map(
        signal,
        spread,
        clip_dn=stack.top_dn - dark,
        clipped=stack.often_full(),
        pitch_ratio=context.pitch_ratio,
        rng=rng,
    )
    return frame_map, signal


def _entry(session: Session, label: str | None) -> StackEntry:
    """The requested stack, or the default one."""
    if label is not None:
        candidates = [entry for entry in session.stacks if entry.label == label]
        if not candidates:
            names = ", ".join(entry.label for entry in session.stacks)
            raise BadInput(f"the stack of a map must be one of {names}, got {label!r}")
        return candidates[0]
    candidates = session.of_kind("scene") or session.of_kind("point")
    if not candidates:
        raise BadInput("a bloom map needs a stack of kind scene or point")
    return max(
        candidates,
        key=lambda entry: (
            (entry.conditions.illuminance_lux or 0.0) * (entry.conditions.gate_ns or 1.0)
        ),
    )


def evidence_of(frame_map: BloomMap, signal: NDArray) -> dict[str, Any]:
    """Figure data of a map for `charact.reporting.bloom_images.bloom_map`."""
    return {
        "figure": "bloom-map",
        "signal_dn": signal,
        "fraction": frame_map.fraction,
        "sd": frame_map.sd,
        "clipped": frame_map.clipped,
        "near_px": frame_map.near_px,
        "sources": [
            {
                "row": s.row,
                "col": s.col,
                "shape": s.shape,
                "known": s.has_known_signal,
                "reason": s.reason,
                "light_dn_px": float(np.median(s.light_dn_px)),
            }
            for s in frame_map.sources
        ],
    }
