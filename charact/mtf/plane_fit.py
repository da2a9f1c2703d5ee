"""Fitting a small target: its place by Gauss-Newton steps, then the transfer with place and levels marginalised."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge_model import EdgeModel, Wide
from charact.mtf.evidence import Evidence, evidence_of
from charact.mtf.plane import Plane, Shape
from charact.mtf.plane_noise import PlaneNoise, noise_of_residual
from charact.mtf.radial_model import RadialModel
from charact.mtf.spread import nodes
from charact.mtf.transfer import exponential
from charact.posterior import maximum

Array = NDArray[np.float64]

DEPARTURE_SD = 0.1
FIRST_EXPONENT = 1.4


@dataclass(frozen=True, kw_only=True)
class PlaneFit:
    """A fitted small target.

    Parameters
    ----------
    shape
        The object where it lies.
    model
        The model of its transfer.
    point, covariance
        Peak of the posterior and the inverse of the curvature there.
    value, picture
        Data and best picture, shape (row, col), DN.
    used
        Pixels that counted.
    noise
        The noise.
    amplitude, background
        Object's brightness, DN, and level around it, DN.
    chi2, free, chi2_without
        Chi squared, its degrees of freedom, and chi squared without a target.
    """

    shape: Shape
    model: RadialModel
    point: Array
    covariance: Array
    value: Array
    picture: Array
    used: NDArray[np.bool_]
    noise: PlaneNoise
    amplitude: float
    background: float
    chi2: float
    free: int
    chi2_without: float


def placed(
    plane: Plane, value: Array, used: NDArray[np.bool_], shape: Shape, half_frequency: float, weight: Array
) -> tuple[Shape, float, Array]:
    """Move an object to where the picture has it; return it, the blur's half frequency, and the picture's light.

    Each step solves for brightness, level and first-order changes of place, form and blur at once.
    """
    root = np.sqrt(weight * used).ravel()
    light = np.zeros_like(value)
    for _ in range(8):
        picture = plane.through(shape, _radial(half_frequency))
        columns = [picture, np.ones_like(picture)]
        columns += [_change(plane, shape, half_frequency, index) for index in range(shape.vector.size)]
        columns.append(plane.through(shape, _radial(half_frequency * 1.05)) - picture)
        design = np.stack([column.ravel() for column in columns], axis=1) * root[:, None]
        found = np.linalg.lstsq(design, value.ravel() * root, rcond=1e-10)[0]
        light = found[0] * picture
        if not found[0] > 0:
            break
        moves = np.clip(found[2:-1] / found[0], -3.0, 3.0)
        shape = shape.moved(shape.vector + moves * shape.steps)
        half_frequency *= float(np.exp(np.clip(0.05 * found[-1] / found[0], -0.4, 0.4)))
        half_frequency = float(np.clip(half_frequency, 0.01, 1.5))
        if np.abs(moves).max() < 1e-3:
            break
    return shape, half_frequency, light


def fit_plane(
    plane: Plane, value: Array, used: NDArray[np.bool_], shape: Shape, noise: PlaneNoise, light: Array,
    half_frequency: float, halo: Wide | None,
) -> PlaneFit:  # fmt: skip
    """Fit the transfer of a placed object; first-order changes of its place are marginalised with the level."""
    grid = nodes(fine=halo is not None)
    evidence, pictures = _evidence(plane, value, used, shape, noise, light, half_frequency, grid)
    transfers = EdgeModel(
        grid=grid,
        fixed=np.ones(grid.size, complex),
        evidence=evidence,
        scale=half_frequency,
        departure_sd=DEPARTURE_SD,
        halo=halo,
    )
    model = RadialModel(transfers=transfers)
    start = model.start(half_frequency, FIRST_EXPONENT)
    point, covariance = maximum(model.log_probability, start, model.bounds)
    modulus = model.modulus(point[None])[0]
    amplitude, chi2 = evidence.amplitude(modulus.astype(complex))
    picture = amplitude * (pictures @ modulus).reshape(value.shape)
    root = np.where(used, 1.0 / noise.variance(light), 0.0)
    background = float(np.sum(root * (value - picture)) / np.sum(root))
    return PlaneFit(
        shape=shape,
        model=model,
        point=point,
        covariance=covariance,
        value=value,
        picture=picture + background,
        used=used,
        noise=noise,
        amplitude=amplitude,
        background=background,
        chi2=chi2,
        free=max(int(used.sum()) - shape.vector.size - 8, 1),
        chi2_without=evidence.power,
    )


def with_residual_noise(
    plane: Plane, fit: PlaneFit, half_frequency: float, halo: Wide | None, floor: float
) -> PlaneFit:
    """Fit again with the noise that the fit left over: for pictures without frames to compare."""
    light = fit.picture - fit.background
    noise = noise_of_residual(fit.value - fit.picture, light, fit.used, floor)
    return fit_plane(plane, fit.value, fit.used, fit.shape, noise, light, half_frequency, halo)


def _evidence(
    plane: Plane, value: Array, used: NDArray[np.bool_], shape: Shape, noise: PlaneNoise, light: Array,
    half_frequency: float, grid: Array,
) -> tuple[Evidence, Array]:  # fmt: skip
    """Return the evidence of a picture on nodes, and the pictures of the nodes."""
    pictures = plane.basis(shape, grid)
    level = np.ones(value.size)
    changes = [_change(plane, shape, half_frequency, index).ravel() for index in range(shape.vector.size)]
    nuisance = np.stack([level, *changes], axis=1)
    variance = noise.variance(light)
    columns = np.concatenate([pictures, nuisance, value.reshape(-1, 1)], axis=1)
    white = noise.whitened(columns, variance, used)
    scale = max(float(light.max()), 1e-9) / max(float(plane.through(shape, _radial(half_frequency)).max()), 1e-12)
    priors = np.array([np.inf, *[np.inf] * len(changes)])
    return _projected(white, grid.size, priors, scale, int(used.sum())), pictures


def _projected(white: Array, size: int, priors: Array, scale: float, pixels: int) -> Evidence:
    """Return the evidence of whitened columns (nodes, nuisance, data)."""
    joint = white.T @ white
    # The columns' own products hold all; a square root of them stands for the pixels.
    values, vectors = np.linalg.eigh(joint)
    keep = values > 1e-13 * values[-1]
    small = (vectors[:, keep] * np.sqrt(values[keep])).T
    evidence = evidence_of(
        small[:, -1],
        np.eye(len(small)),
        small[:, :size],
        np.zeros_like(small[:, :size]),
        small[:, size:-1],
        priors,
        scale,
    )
    return replace(evidence, free=pixels)


def _change(plane: Plane, shape: Shape, half_frequency: float, index: int) -> Array:
    """Return the change of the picture with one parameter of place or form, for one step of it."""
    step = np.zeros(shape.vector.size)
    step[index] = shape.steps[index]
    ahead, behind = (
        plane.through(shape.moved(shape.vector + sign * step), _radial(half_frequency)) for sign in (0.5, -0.5)
    )
    return ahead - behind


def _radial(half_frequency: float):
    """Return a typical transfer as a function of radial frequency."""

    def transfer(radial: Array) -> Array:
        at = np.maximum(radial, 1e-6)
        return np.exp(exponential(at, np.asarray(half_frequency), np.asarray(FIRST_EXPONENT)))

    return transfer
