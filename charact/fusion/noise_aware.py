"""Fusion that knows its cameras: weights from the noise of each pyramid level, blooming removed,
holes filled.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from charact.fusion.bands import Band, Image, Plane, Span, display_planes
from charact.fusion.checks import find_problems
from charact.fusion.fused import Fused, LevelWeights, finish, level_uncertainty
from charact.fusion.pyramid import collapse, decompose, map_samples, weigh, weighted_sum
from charact.fusion.thresholds import FUSION
from charact.method.registry import register


@register("fusion", "noise-aware")
def fuse_noise_aware(
    bands: Sequence[Band],
    *,
    spans: Mapping[str, Span] | None = None,
    uncertainty: bool = True,
    check: bool = True,
) -> Fused:
    """Fuse bands into a grey picture, each detail weighted by the noise of its camera.

    `spans`: fixed display spans by the name of the band, None: from the trusted pixels;
    `uncertainty`, `check`: whether standard deviation and shares are computed, and noise law and
    blooming are checked against the frames. Bands of unlike shape, and an empty span, are BadInput.

    Notes
    -----
    At each level of a Laplacian pyramid the details D_b of the bands have the noise variance n_b(x)
    = s_l (gain mu(x) + r^2), with mu the light including the blooming that is subtracted and s_l
    the variance of the level for the camera's noise spectrum
    (`charact.fusion.pyramid.noise_gains`). The estimate of a contrast common to the bands is D =
    sum (D_b/n_b) / sum 1/n_b with the variance n = 1/sum 1/n_b, shrunk by P/(P + n), P = mean(D^2 -
    n) of the level. Where a band is clipped or occluded its 1/n_b is 0, so that the other bands
    fill its details; its base level is interpolated. The base is the mean of the bands: levels are
    no evidence. A band that holds nothing beyond its noise is left out. Opposite contrasts of equal
    evidence cancel in any grey picture; `noise-aware-colour` keeps them.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> from charact.frames.noise_law import NoiseLaw
    >>> law = NoiseLaw(gain_dn=0.0, read_dn=1.0)
    >>> frames = rng.normal(0.0, 1.0, (2, 64, 64))
    >>> frames[:, 24:40, 24:40] += 5.0
    >>> bands = [Band(name=n, image=image, noise=law) for n, image in zip("ab", frames)]
    >>> out = fuse_noise_aware(bands)
    >>> bool(np.allclose(out.share[0], 0.5))
    True
    """
    planes = display_planes(bands, bloom=True, spans=spans)
    picture, weights, finest = fuse_levels(planes)
    spread = level_uncertainty(planes, weights) if uncertainty else None
    findings, notes = find_problems(planes, finest) if check else ((), ())
    empty = [plane.band.name for plane, own in zip(planes, weights, strict=True) if own[-1] == 0.0]
    notes = (*notes, *(f"{name} holds nothing beyond its noise and was left out" for name in empty))
    return finish("noise-aware", planes, picture, spread, findings=findings, notes=notes)


def fuse_levels(
    planes: Sequence[Plane],
) -> tuple[Image, list[list[Image | np.float32]], list[Image]]:
    """Return the fused picture, the weights of each band at each level, and finest details of each
    band, sampled.

    See `fuse_noise_aware`; the samples are those of `charact.fusion.pyramid.map_samples`.
    """
    levels = planes[0].levels
    pyramids = [decompose(plane.value, levels) for plane in planes]
    shown = [has_signal(plane, pyramid) for plane, pyramid in zip(planes, pyramids, strict=True)]
    shown = shown if any(shown) else [True] * len(planes)
    finest = [map_samples(pyramid[0]) for pyramid in pyramids]
    out, weights = [], [[] for _ in planes]
    for level in range(levels):
        precisions = [
            _precision(plane, level) * np.float32(1.0 if one else 1e-6)
            for plane, one in zip(planes, shown, strict=True)
        ]
        noise = np.asarray(np.float32(1.0) / sum(precisions))
        details = [pyramid[level] for pyramid in pyramids]
        detail = weighted_sum(details, [one * noise for one in precisions])
        # Where no band is known the noise is a million times higher, and there are no details.
        mean_noise = float(np.mean(noise[noise < 1e3 * np.min(noise)]))
        power = max(
            float(cv2.norm(detail, cv2.NORM_L2SQR)) / detail.size - mean_noise,
            FUSION.signal_floor * mean_noise,
        )
        shrink = np.float32(power) / (np.float32(power) + noise)
        out.append(weigh(detail, shrink, details[0]))
        for own, precision in zip(weights, precisions, strict=True):
            own.append(precision * noise * shrink)
    shares = [np.float32(one / sum(shown)) for one in shown]
    out.append(weighted_sum([pyramid[levels] for pyramid in pyramids], shares))
    for own, share in zip(weights, shares, strict=True):
        own.append(share)
    return collapse(out), weights, finest


def has_signal(plane: Plane, pyramid: Sequence[Image]) -> bool:
    """Return whether a band holds more than its noise: in the power of a coarser level, or in a
    single detail.
    """
    for level in range(FUSION.map_level, plane.levels):
        noise = np.maximum(plane.variance(level), np.float32(1e-12))
        relative = pyramid[level] ** 2 / noise
        # Neighbouring coefficients are correlated: half of them count.
        error = 2.0 / np.sqrt(relative.size)
        if (
            relative.mean() > 1.0 + FUSION.signal_floor + 3.0 * error
            or relative.max() > FUSION.signal_sd**2
        ):
            return True
    return False


def _precision(plane: Plane, level: int) -> Image | np.float32:
    """Return 1/n of the details of a level; nearly 0 in holes, so that a pixel without any band has
    no details.
    """
    inverse = np.float32(1.0) / np.maximum(plane.variance(level), np.float32(1e-12))
    if plane.known is None:
        return inverse
    return inverse * np.maximum(plane.known[max(level - FUSION.map_level, 0)], np.float32(1e-6))


@register("fusion", "noise-aware-colour")
def fuse_colour(
    bands: Sequence[Band],
    *,
    spans: Mapping[str, Span] | None = None,
    uncertainty: bool = True,
    check: bool = True,
) -> Fused:
    """Fuse bands into a colour picture of restored bands: green the first, red the second, blue the
    third.

    The parameters are those of `fuse_noise_aware`. Of two bands, blue is 0.5 + 0.5 (first -
    second): contrasts of opposite sign differ in hue, where a grey picture would lose them. Each
    band is restored by itself: blooming is subtracted, clipped pixels are filled by the level of
    their surroundings, and the details of each pyramid level are shrunk by P/(P + n) as in
    `fuse_noise_aware`. Of more than three bands, blue is the mean of all from the third.
    """
    planes = display_planes(bands, bloom=True, spans=spans)
    restored, weights, finest = restore_bands(planes)
    green, red, *more = restored
    mixture = np.zeros((3, len(planes)), np.float32)
    mixture[0, 1] = mixture[1, 0] = 1.0
    if more:
        mixture[2, 2:] = 1.0 / len(more)
        blue = weighted_sum(more, [1.0 / len(more)] * len(more))
    else:
        mixture[2] = 0.5, -0.5
        blue = cv2.addWeighted(green, 0.5, red, -0.5, 0.5)
    picture = cv2.merge([red, green, blue])
    spread = None
    if uncertainty:
        sd = np.sqrt(
            np.square(deviations(planes, weights)).transpose(1, 2, 0) @ np.square(mixture).T
        )
        # The share of a band is that in the contrasts of all colours.
        seen = np.abs(mixture).sum(axis=0)
        _, share = level_uncertainty(
            planes, [[one * seen[k] for one in own] for k, own in enumerate(weights)]
        )
        spread = sd, share
    findings, notes = find_problems(planes, finest) if check else ((), ())
    return finish("noise-aware-colour", planes, picture, spread, findings=findings, notes=notes)


def restore_bands(
    planes: Sequence[Plane],
) -> tuple[list[Image], list[list[Image | np.float32]], list[Image]]:
    """Return each band restored by itself, its weight at each level, and its finest details; see
    `fuse_levels`.
    """
    pictures, weights, finest = zip(*(fuse_levels([plane]) for plane in planes), strict=True)
    return list(pictures), [own for (own,) in weights], [own for (own,) in finest]


def deviations(planes: Sequence[Plane], weights: Sequence[LevelWeights]) -> list[Image]:
    """Return the standard deviation of each restored band, shape (row, col)."""
    return [
        level_uncertainty([plane], [own])[0] for plane, own in zip(planes, weights, strict=True)
    ]
