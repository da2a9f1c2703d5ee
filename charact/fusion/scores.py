"""No-reference scores of a fused picture, each with a noise and a copy control.

The eleven scores have the conventions of the VIFB benchmark (Zhang, Ye and Xiao, CVPR Workshops
2020), so that values compare with published tables: 8-bit codes, each channel scored alone and the
channels averaged. None of them measures how much of a scene the fused picture keeps: noise raises
several, and a copy of one band wins others. The same scores of a noisier picture and of a copy are
therefore part of every row.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput

Array = NDArray[np.float64]
Codes = NDArray[np.uint8]

CODES = 256
# standard deviation of the noise control; raises entropy 6.9 -> 7.1 bits and gradients x3
CONTROL_NOISE_DN = 10.0
LEAST_PX = 16  # rows and columns: one block of Qcv; the SSIM window needs 11
SOBEL_X = np.array([[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]])
# Qabf: ceiling, slope and midpoint of the sigmoids of strength and of orientation (Xydeas and
# Petrovic 2000).
QABF_STRENGTH, QABF_ORIENTATION = (0.9994, 15.0, 0.5), (0.9879, 22.0, 0.8)
QCV_BLOCK_PX = 16


class Score(NamedTuple):
    """A score of a fused picture, and of its two controls; None where the score is undefined."""

    quantity: str
    unit: str
    value: float | None
    noise_control: float | None  # of the fused picture with white noise of 10 DN
    copy_control: float | None  # of the visible picture in place of the fused one


def score(
    visible: Codes, thermal: Codes, fused: Codes, *, rng: np.random.Generator
) -> tuple[Score, ...]:
    """Return eleven no-reference scores of a fused picture, with controls.

    Parameters
    ----------
    visible, thermal, fused
        Pictures of one size, 8-bit codes (DN), shape (row, col), or (row, col, 3); a grey one among
        colour pictures counts as three equal channels.
    rng
        Generator of the noise control.

    Returns
    -------
    tuple of Score
        One for each key of `UNITS`. Smaller is better for `cross_entropy` and `qcv`, larger for the
        others. A value is None where the formula divides by zero, as `qcb` of constant pictures.

    Raises
    ------
    BadInput
        If pictures are not 8-bit, differ in size, or have less than 16 rows or columns.

    Notes
    -----
    The formulas stand with the functions of this module. Values agree with 33 published ones of
    VIFB within 3e-5. Its "RMSE" and "PSNR" are neither and are left out.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> visible, thermal = rng.integers(0, 256, (2, 32, 32), dtype=np.uint8)
    >>> rows = {row.quantity: row for row in score(visible, thermal, visible, rng=rng)}
    >>> rows["entropy"].value == rows["entropy"].copy_control
    True
    """
    pictures = [np.asarray(picture) for picture in (visible, thermal, fused)]
    check_pictures(pictures)
    noisy = _add_noise(pictures[2], rng)
    columns = [
        _values(pictures[0], pictures[1], each) for each in (pictures[2], noisy, pictures[0])
    ]
    return tuple(Score(name, UNITS[name], *(column[name] for column in columns)) for name in UNITS)


def check_pictures(pictures: list[NDArray]) -> None:
    """Raise BadInput unless pictures have 8-bit codes, one size of at least 16 px, and one or three
    channels.
    """
    for picture in pictures:
        if picture.dtype != np.uint8:
            raise BadInput(
                f"a scored picture must have 8-bit codes, got {picture.dtype}; map it to 0..255 "
                "first"
            )
        if picture.ndim not in (2, 3) or (picture.ndim == 3 and picture.shape[2] != 3):
            raise BadInput(
                f"a scored picture must be (row, col) or (row, col, 3), got shape {picture.shape}"
            )
        if min(picture.shape[:2]) < LEAST_PX:
            raise BadInput(
                f"a scored picture must have {LEAST_PX} rows and columns or more, got "
                f"{picture.shape[:2]}"
            )
    if len(sizes := {picture.shape[:2] for picture in pictures}) > 1:
        raise BadInput(
            f"scored pictures must have one size, got {sorted(sizes)}; register them first"
        )


def _add_noise(picture: Codes, rng: np.random.Generator) -> Codes:
    """Return a picture with equal white noise in all channels, rounded and limited to 0..255 as any
    8-bit picture.
    """
    noise = CONTROL_NOISE_DN * rng.standard_normal(picture.shape[:2])
    noisy = picture + (noise if picture.ndim == 2 else noise[..., None])
    return np.clip(np.round(noisy), 0, CODES - 1).astype(np.uint8)


def _values(visible: Codes, thermal: Codes, fused: Codes) -> dict[str, float | None]:
    """Return the scores of one fused picture, averaged over the channels."""
    own = [fused] if fused.ndim == 2 else list(np.moveaxis(fused, -1, 0))
    colour = any(picture.ndim == 3 for picture in (visible, thermal, fused))
    planes = [_channels(picture) if colour else [picture] for picture in (visible, thermal, fused)]
    found: dict[str, float] = {}
    with np.errstate(divide="ignore", invalid="ignore"):
        for name, single in OF_FUSED.items():
            found[name] = float(np.mean([single(plane.astype(np.float64)) for plane in own]))
        found["spatial_frequency"] = spatial_frequency(np.hstack(own).astype(np.float64))
        for name, of_three in OF_THREE.items():
            triples = zip(*planes, strict=True)
            found[name] = float(
                np.mean([of_three(*(plane.astype(np.float64) for plane in one)) for one in triples])
            )
    return {name: value if np.isfinite(value) else None for name, value in found.items()}


def _channels(picture: Codes) -> list[Codes]:
    """Return three channels; those of a grey picture are equal."""
    return [picture] * 3 if picture.ndim == 2 else list(np.moveaxis(picture, -1, 0))


def histogram(plane: Array) -> Array:
    """Return the relative frequency of each code, shape (256,)."""
    return np.bincount(plane.astype(np.intp).ravel(), minlength=CODES) / plane.size


def entropy(fused: Array) -> float:
    """Return the entropy of the codes, -sum p log2 p, bits."""
    p = histogram(fused)
    return float(-np.sum(p[p > 0] * np.log2(p[p > 0])))


def stretch(plane: Array) -> Array:
    """Return a plane stretched to 0..255 and rounded half up; a constant one becomes NaN, a black
    one 0.
    """
    low, high = plane.min(), plane.max()
    return plane if high == low == 0.0 else np.floor((plane - low) / (high - low) * 255.0 + 0.5)


def mutual_information(visible: Array, thermal: Array, fused: Array) -> float:
    """Return I(V;F) + I(T;F) of stretched planes, nats; a constant plane has no information."""
    return sum(_information(band, fused) for band in (visible, thermal))


def _information(a: Array, b: Array) -> float:
    first, second = (np.nan_to_num(stretch(plane)).astype(np.intp) for plane in (a, b))
    joint = (
        np.bincount((first * CODES + second).ravel(), minlength=CODES**2).reshape(CODES, CODES)
        / a.size
    )
    independent = np.outer(joint.sum(axis=1), joint.sum(axis=0))
    some = joint > 0
    return float(np.sum(joint[some] * np.log(joint[some] / independent[some])))


def sobel(plane: Array, border: int = cv2.BORDER_CONSTANT) -> tuple[Array, Array]:
    """Return the Sobel derivatives along x and y, not normalised; beyond the border lie zeros
    unless said.
    """
    x, y = (cv2.filter2D(plane, -1, kernel, borderType=border) for kernel in (SOBEL_X, SOBEL_X.T))
    return np.asarray(x, np.float64), np.asarray(y, np.float64)


def qabf(visible: Array, thermal: Array, fused: Array) -> float:
    """Return Qabf: gradients of the bands preserved in the fused plane, 0 to about 0.987.

    Product of two sigmoids, of the ratio of Sobel moduli and of the angle between them, averaged
    over both bands with the modulus as weight (Xydeas and Petrovic, Electron. Lett. 36, 2000).
    Where moduli are equal VIFB takes the modulus for the ratio, so that a copy scores slightly
    higher; kept here.
    """
    strength, angle = _gradient(fused)
    total, weight = 0.0, 0.0
    for band in (visible, thermal):
        own, own_angle = _gradient(band)
        ratio = np.minimum(own, strength) / np.maximum(own, strength)
        ratio = np.where(own == strength, strength, ratio)
        alignment = 1.0 - np.abs(own_angle - angle) / (np.pi / 2.0)
        total += float(
            np.sum(own * sigmoid(ratio, *QABF_STRENGTH) * sigmoid(alignment, *QABF_ORIENTATION))
        )
        weight += float(np.sum(own))
    return total / weight if weight else np.nan


def _gradient(plane: Array) -> tuple[Array, Array]:
    """Return strength and orientation (rows upwards, -pi/2 to pi/2; pi/2 where nothing changes
    along x).
    """
    x, y = sobel(plane)
    return np.sqrt(x**2 + y**2), np.where(x == 0.0, np.pi / 2.0, np.arctan(-y / x))


def sigmoid(value: Array, ceiling: float, slope: float, middle: float) -> Array:
    """Return ceiling / (1 + exp(-slope (value - middle)))."""
    return ceiling / (1.0 + np.exp(-slope * (value - middle)))


def ssim_sum(visible: Array, thermal: Array, fused: Array) -> float:
    """Return the sum of both bands' structural similarity to the fused plane (Wang et al., IEEE TIP
    13, 2004).
    """
    from skimage.metrics import structural_similarity

    settings: dict[str, Any] = {
        "data_range": 255.0,
        "gaussian_weights": True,
        "use_sample_covariance": False,
    }
    similarities: list[Any] = [
        structural_similarity(band, fused, **settings) for band in (visible, thermal)
    ]
    return float(sum(similarities))


def average_gradient(fused: Array) -> float:
    """Return sum sqrt((Fx^2 + Fy^2)/2) / ((rows - 1)(columns - 1)) of central differences,
    DN/px.
    """
    y, x = np.gradient(fused)
    rows, columns = fused.shape
    return float(np.sum(np.sqrt((x**2 + y**2) / 2.0)) / ((rows - 1) * (columns - 1)))


def edge_intensity(fused: Array) -> float:
    """Return the mean modulus of the Sobel gradient, DN."""
    return float(np.mean(np.hypot(*sobel(fused, cv2.BORDER_REPLICATE))))


def spatial_frequency(fused: Array) -> float:
    """Return the root of the mean square differences along rows and columns, DN.

    As in VIFB, the three channels are given side by side as one picture, seams included.
    """
    differences = np.sum(np.diff(fused, axis=0) ** 2) + np.sum(np.diff(fused, axis=1) ** 2)
    return float(np.sqrt(differences / fused.size))


def cross_entropy(visible: Array, thermal: Array, fused: Array) -> float:
    """Return the mean over both bands of sum p_B log2(p_B/p_F) over codes that occur in both,
    bits.
    """
    q = histogram(fused)
    total = 0.0
    for band in (visible, thermal):
        p = histogram(band)
        both = (p > 0) & (q > 0)
        total += 0.5 * float(np.sum(p[both] * np.log2(p[both] / q[both])))
    return total


def _filter(plane: Array, sensitivity: Callable[[Array], Array], cycles: float) -> Array:
    """Return a plane filtered by an isotropic contrast sensitivity, its Nyquist frequency at
    size/`cycles`.
    """
    rows, columns = plane.shape
    u, v = (
        2.0 * np.fft.fftfreq(columns) * columns / cycles,
        2.0 * np.fft.fftfreq(rows) * rows / cycles,
    )
    return np.real(np.fft.ifft2(np.fft.fft2(plane) * sensitivity(np.hypot(u, v[:, None]))))


def qcb(visible: Array, thermal: Array, fused: Array) -> float:
    """Return Qcb: contrast of the bands preserved in the fused plane, 0 to 1 (Chen and Blum, IVC
    27, 2009).

    Stretched planes are filtered by exp(-(r/15.387)^2) - 0.7622 exp(-(r/1.3456)^2), r in size/30;
    the contrast c = |G(2 px) / G(4 px) - 1|, from Gaussian means over 31 x 31 px with zeros beyond
    the border, is masked as C = c^3 / (c^2 + 1e-4); min/max of C of band and fused plane is
    averaged with weight C^2 of the band.
    """
    c_fused = _masked_contrast(fused)
    c_visible, c_thermal = _masked_contrast(visible), _masked_contrast(thermal)
    kept = [np.minimum(own, c_fused) / np.maximum(own, c_fused) for own in (c_visible, c_thermal)]
    weighted = c_visible**2 * kept[0] + c_thermal**2 * kept[1]
    return float(np.mean(weighted / (c_visible**2 + c_thermal**2)))


def _masked_contrast(plane: Array) -> Array:
    """Return the masked local contrast of Qcb, dimensionless."""
    filtered = _filter(
        stretch(plane),
        lambda r: np.exp(-((r / 15.387) ** 2)) - 0.7622 * np.exp(-((r / 1.3456) ** 2)),
        30.0,
    )
    x = np.arange(-15.0, 16.0)
    means = []
    for sigma in (2.0, 4.0):
        taps = np.exp(-(x**2) / (2.0 * sigma**2)) / np.sqrt(2.0 * np.pi * sigma**2)
        means.append(cv2.sepFilter2D(filtered, -1, taps, taps, borderType=cv2.BORDER_CONSTANT))
    contrast = np.abs(means[0] / means[1] - 1.0)
    return contrast**3 / (contrast**2 + 1e-4)


def qcv(visible: Array, thermal: Array, fused: Array) -> float:
    """Return Qcv: visible differences between bands and fused plane, DN2 (Chen and Varshney, Inf.
    Fusion 8, 2007).

    Differences of stretched planes are filtered by 2.6 (0.0192 + 0.144 r) exp(-(0.144 r)^1.1), r in
    size/8 (Mannos and Sakrison 1974); their mean square in blocks of 16 x 16 px, zeros beyond the
    border, is averaged over blocks and bands with the sum of the fifth power of the band's Sobel
    modulus as weight.
    """
    stretched = stretch(fused)
    total, weight = 0.0, 0.0
    for band in (stretch(visible), stretch(thermal)):
        seen = _filter(
            band - stretched,
            lambda r: 2.6 * (0.0192 + 0.144 * r) * np.exp(-((0.144 * r) ** 1.1)),
            8.0,
        )
        saliency = _block_sums(np.hypot(*sobel(band)) ** 5)
        total += float(np.sum(saliency * _block_sums(seen**2) / QCV_BLOCK_PX**2))
        weight += float(np.sum(saliency))
    return total / weight if weight else np.nan


def _block_sums(plane: Array) -> Array:
    """Return sums over blocks of 16 x 16 px, zeros beyond the border."""
    size = QCV_BLOCK_PX
    rows, columns = (-(-length // size) for length in plane.shape)
    padded = np.zeros((rows * size, columns * size))
    padded[: plane.shape[0], : plane.shape[1]] = plane
    return padded.reshape(rows, size, columns, size).sum(axis=(1, 3))


OF_FUSED: dict[str, Callable[[Array], Any]] = {
    "entropy": entropy,
    "average_gradient": average_gradient,
    "edge_intensity": edge_intensity,
    "standard_deviation": np.std,
}
OF_THREE: dict[str, Callable[[Array, Array, Array], float]] = {
    "mutual_information": mutual_information,
    "qabf": qabf,
    "ssim_sum": ssim_sum,
    "cross_entropy": cross_entropy,
    "qcb": qcb,
    "qcv": qcv,
}
UNITS = {
    "entropy": "bits",
    "mutual_information": "nats",
    "qabf": "1",
    "ssim_sum": "1",
    "average_gradient": "DN/px",
    "edge_intensity": "DN",
    "spatial_frequency": "DN",
    "standard_deviation": "DN",
    "cross_entropy": "bits",
    "qcb": "1",
    "qcv": "DN2",
}
