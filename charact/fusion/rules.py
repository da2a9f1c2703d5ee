"""Fusion rules of the literature, for comparison: they know neither blooming nor, but for one, the
noise.
"""

from collections.abc import Mapping, Sequence
from functools import reduce

import cv2
import numpy as np

from charact.fusion.bands import Band, Image, Plane, Span, display_planes, lamp_pixels
from charact.fusion.fused import Fused, finish, level_uncertainty, pixel_uncertainty
from charact.fusion.pyramid import (
    collapse,
    decompose,
    expand,
    halved,
    map_samples,
    reduce_image,
    weighted_sum,
)
from charact.fusion.thresholds import FUSION
from charact.method.registry import register

Spans = Mapping[str, Span] | None


def _mixture(
    method: str, planes: Sequence[Plane], weights: Sequence[float], uncertainty: bool
) -> Fused:
    """Return the sum of bands times fixed weights."""
    picture = planes[0].value * np.float32(weights[0])
    for plane, weight in zip(planes[1:], weights[1:], strict=True):
        cv2.scaleAdd(plane.value, float(weight), picture, picture)
    return finish(
        method, planes, picture, pixel_uncertainty(planes, weights) if uncertainty else None
    )


@register("fusion", "weighted")
def fuse_weighted(
    bands: Sequence[Band],
    *,
    spans: Spans = None,
    uncertainty: bool = True,
    weights: Sequence[float] | None = None,
) -> Fused:
    """Add bands with fixed weights (None: equal), each stretched from its least to its highest
    pixel.
    """
    planes = display_planes(bands, bloom=False, spans=spans, min_max=True)
    return _mixture("weighted", planes, weights or [1.0 / len(planes)] * len(planes), uncertainty)


@register("fusion", "pca")
def fuse_pca(bands: Sequence[Band], *, spans: Spans = None, uncertainty: bool = True) -> Fused:
    """Add bands with the weights of the first principal component of their covariance, with sum
    1.
    """
    planes = display_planes(bands, bloom=False, spans=spans)
    # Every third pixel of a row: the covariance of a picture needs no more.
    covariance = np.cov(np.stack([plane.value[:, ::3].ravel() for plane in planes]))
    first = np.abs(np.linalg.eigh(covariance)[1][:, -1])
    return _mixture("pca", planes, [float(weight) for weight in first / first.sum()], uncertainty)


@register("fusion", "inverse-noise")
def fuse_inverse_noise(
    bands: Sequence[Band], *, spans: Spans = None, uncertainty: bool = True
) -> Fused:
    """Add bands with weights of 1 over their noise power at each pixel; clipped lamps have no
    weight.

    The power is that of objects, (K + k F^2) mean + read noise^2, not the variance of a pixel,
    which blur after the gain lowers.
    """
    planes = display_planes(bands, bloom=False, spans=spans)
    precisions = []
    for plane in planes:
        light, dark = plane.powers
        power = np.float32(dark) if light is None else light[0] + np.float32(dark)
        clip = plane.band.clip
        lamps = (
            None
            if clip is None
            else lamp_pixels(plane.band.image >= np.float32(FUSION.clip_share * clip))
        )
        unclipped = 1.0 if lamps is None else (~map_samples(lamps)).astype(np.float32)
        precisions.append(unclipped / np.maximum(power, np.float32(1e-9)))
    total = np.maximum(sum(precisions), np.float32(1e-9))
    weights = [precision / total for precision in precisions]
    picture = weighted_sum([plane.value for plane in planes], weights)
    return finish(
        "inverse-noise",
        planes,
        picture,
        pixel_uncertainty(planes, weights) if uncertainty else None,
    )


@register("fusion", "laplacian")
def fuse_laplacian(
    bands: Sequence[Band], *, spans: Spans = None, uncertainty: bool = True
) -> Fused:
    """Keep the detail of largest magnitude at each place of a Laplacian pyramid, and the mean base.

    P. J. Burt, E. H. Adelson, IEEE Trans. Communications 31 (1983) 532; choose-max rule of A. Toet,
    Opt. Eng. 28 (1989)
    789. Choosing the largest selects noise.
    """
    planes = display_planes(bands, bloom=False, spans=spans)
    levels = planes[0].levels
    pyramids = [decompose(plane.value, levels) for plane in planes]
    out, weights = [], [[] for _ in planes]
    for level in range(levels):
        own = [pyramid[level] for pyramid in pyramids]
        chosen = own[0].copy() if uncertainty else own[0]
        largest, square = cv2.multiply(chosen, chosen), None
        for number, detail in enumerate(own[1:], start=2):
            square = cv2.multiply(detail, detail, square)
            cv2.copyTo(detail, cv2.compare(square, largest, cv2.CMP_GT), chosen)
            if number < len(own):
                cv2.max(square, largest, largest)
        out.append(chosen)
        if uncertainty:
            for number, detail in enumerate(own):
                weights[number].append((detail == chosen).astype(np.float32))
    out.append(np.asarray(np.mean([pyramid[levels] for pyramid in pyramids], axis=0), np.float32))
    for own in weights:
        own.append(1.0 / len(planes))
    return finish(
        "laplacian",
        planes,
        collapse(out),
        level_uncertainty(planes, weights) if uncertainty else None,
    )


# Box of the base, window of the saliency, and radius, regularisation and halvings of the filters of
# base and detail. Slopes of the base are small, and vary over 91 px; those of the detail reach 100
# per unit and need every pixel.
BASE_BOX, SALIENCY = (31, 31), (11, 5.0)
BASE_FILTER, DETAIL_FILTER = (45, 0.3, 2), (7, 1e-6, 0)


@register("fusion", "guided-filter")
def fuse_guided(bands: Sequence[Band], *, spans: Spans = None, uncertainty: bool = True) -> Fused:
    """Fuse base and detail by weights of saliency, smoothed by a guided filter.

    S. Li, X. Kang, J. Hu, IEEE Trans. Image Processing 22 (2013) 2864, with the parameters of its
    section IV: saliency is the smoothed magnitude of the Laplacian, the band with the largest has
    weight 1. The filter is that of `guided_filter`.
    """
    planes = display_planes(bands, bloom=False, spans=spans)
    images = [np.clip(plane.value, 0.0, 1.0) for plane in planes]
    window, width = SALIENCY
    laplacian, saliency = np.empty_like(images[0]), []
    for image in images:
        cv2.Laplacian(image, cv2.CV_32F, laplacian)
        saliency.append(cv2.GaussianBlur(np.abs(laplacian, out=laplacian), (window, window), width))
    largest = reduce(cv2.max, saliency)
    weights: list[list[Image]] = []
    for image, own in zip(images, saliency, strict=True):
        chosen = (own == largest).astype(np.float32)
        weights.append(
            [guided_filter(image, chosen, *settings) for settings in (BASE_FILTER, DETAIL_FILTER)]
        )
    for part in (0, 1):
        total = np.maximum(sum(own[part] for own in weights), np.float32(1e-3))
        for own in weights:
            cv2.divide(own[part], total, own[part])
    picture = np.zeros_like(images[0])
    for plane, (of_base, of_detail) in zip(planes, weights, strict=True):
        # w_B B + w_D (I - B) = w_D I + (w_B - w_D) B
        base = cv2.blur(plane.value, BASE_BOX)
        picture += of_detail * plane.value
        picture += cv2.multiply(base, cv2.subtract(of_base, of_detail), base)
    # A box of 31 px keeps what the base of four halvings keeps.
    fine = min(4, planes[0].levels)
    of_levels = [[own[1]] * fine + [own[0]] * (planes[0].levels + 1 - fine) for own in weights]
    return finish(
        "guided-filter",
        planes,
        picture,
        level_uncertainty(planes, of_levels) if uncertainty else None,
    )


def guided_filter(
    guide: Image, image: Image, radius: int, regularisation: float, halvings: int = 0
) -> Image:
    """Return an image smoothed along the edges of a guide.

    K. He, J. Sun, X. Tang, ECCV 2010: in each window of 2 radius + 1 px the image is a line a guide
    + b; a and b are averaged over windows. After halvings of the size they are interpolated (He and
    Sun, arXiv:1505.00996), which holds where a is small.
    """
    g, p = (halved(picture, halvings) for picture in (guide, image))
    side = (2 * round((2 * radius + 1) / 2 ** (halvings + 1) - 0.5) + 1,) * 2
    mean_g, offset, scratch = cv2.blur(g, side), cv2.blur(p, side), np.empty_like(g)
    slope, variance = (cv2.blur(cv2.multiply(g, picture, scratch), side) for picture in (p, g))
    slope -= cv2.multiply(mean_g, offset, scratch)
    variance -= cv2.multiply(mean_g, mean_g, scratch)
    variance += np.float32(regularisation)
    cv2.divide(slope, variance, slope)
    offset -= cv2.multiply(slope, mean_g, scratch)
    slope, offset = (
        cv2.blur(picture, side, out) for picture, out in ((slope, variance), (offset, mean_g))
    )
    if halvings:
        slope, offset = (cv2.resize(picture, guide.shape[::-1]) for picture in (slope, offset))
    return cv2.add(cv2.multiply(slope, guide, slope), offset, slope)


# Opponent processing: widths of centre and surround, px, and the constant A of the shunting
# equation.
CENTRE_PX, SURROUND_PX, SHUNT = 0.6, 4.0, 1.0
# Blur left to a quarter of the rows and columns: two reductions and expansions have a variance of 2
# (1 + 4) px^2.
SMALL_SURROUND_PX = (SURROUND_PX**2 - 10.0) ** 0.5 / 4.0
# Percentiles of each colour shown in 8 bits: two stages leave red and blue 1/16 of a band's
# contrast, green 1/4.
SHOWN_PERCENT = (0.5, 99.5)


@register("fusion", "opponent")
def fuse_opponent(bands: Sequence[Band], *, spans: Spans = None, uncertainty: bool = True) -> Fused:
    """Fuse two bands into opponent colours by centre and surround, in two stages.

    Each stage is the shunting equation at rest, E = (C - S)/(A + C + S), with C the centre and S
    the surround (A. M. Waxman et al., Neural Networks 10 (1997) 1). First V and T on-centre; then T
    against V (red), V on-centre (green) and V against T (blue), from -1..1 to 0..1. Only the first
    two bands are used. The standard deviation is of first order in the centre's noise.
    """
    planes = display_planes(bands, bloom=False, spans=spans)
    first, second = (
        cv2.threshold(plane.value, 0.0, 0.0, cv2.THRESH_TOZERO, plane.value)[1]
        for plane in planes[:2]
    )
    scratch = np.empty_like(first)
    v_on, t_on = (
        _oppose(centre, centre, np.empty_like(centre), scratch) for centre in (first, second)
    )
    red, blue = (
        _oppose(*pair, np.empty_like(first), scratch) for pair in ((t_on, v_on), (v_on, t_on))
    )
    picture = cv2.merge([red, v_on, blue])
    spread = None
    if uncertainty:
        # The derivative of a stage by its centre, where centre and surround are alike, is 1/(A + 2
        # C).
        slopes = [
            np.sqrt(plane.pixel_variance)
            / (SHUNT + 2.0 * reduce_image(centre, FUSION.map_level)[-1])
            for centre, plane in zip((first, second), planes, strict=False)
        ]
        second_stage = 0.5 / (SHUNT + 1.0)
        maps = np.stack([second_stage * slopes[1], slopes[0], second_stage * slopes[0]], axis=-1)
        sd = cv2.resize(
            np.float32(0.5) * maps.astype(np.float32),
            first.shape[::-1],
            interpolation=cv2.INTER_LINEAR,
        )
        share = np.zeros((len(planes), *first.shape), np.float32)
        share[:2] = 0.5
        spread = sd, share
    low, high = SHOWN_PERCENT
    notes = [f"codes of 8 bits show each colour from its percentile {low:g} to {high:g}"]
    notes += ["only the first two bands are used"] if len(planes) > 2 else []
    return finish("opponent", planes, picture, spread, notes=notes, shown_percent=SHOWN_PERCENT)


def _oppose(centre_of: Image, surround_of: Image, out: Image, scratch: Image) -> Image:
    """Return 1/2 + E/2 in `out`, E = (C - S)/(A + C + S); the surround is blurred at a quarter of
    rows and columns.
    """
    half = cv2.pyrDown(surround_of)
    small = cv2.GaussianBlur(cv2.pyrDown(half), (5, 5), SMALL_SURROUND_PX)
    surround = expand(expand(small, half.shape), surround_of.shape, scratch)
    centre = cv2.GaussianBlur(centre_of, (3, 3), CENTRE_PX, out)
    total = cv2.addWeighted(centre, 1.0, surround, 1.0, SHUNT, surround)
    # 1/2 + (C - S)/(A + C + S)/2 = (C + A/2)/(A + C + S)
    return cv2.divide(cv2.addWeighted(centre, 1.0, centre, 0.0, 0.5 * SHUNT, out), total, out)
