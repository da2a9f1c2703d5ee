"""Phosphor: electrons become photons, spread laterally and decay over later fields.

A decay law is a sum of exponentials, `decay_components`: the frames of all samplers, and the
bounds, follow from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput, Conditions
from simulate.camera import pattern
from simulate.camera.chain import Slot, Stage, values_of
from simulate.camera.grid import ACCURACY, CameraFrame
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import StageBlur, TubeShare

# Weight of each component at the start of the decay, dimensionless, and its time constant, s.
Components = tuple[tuple[float, float], ...]


def decay_components(phosphor: Any) -> Components:
    """Return the decay law of a described phosphor as exponentials: here a fast and a slow one."""
    fast = float(phosphor.fast_fraction)
    return (fast, float(phosphor.fast_decay_ms) * 1e-3), (
        1.0 - fast,
        float(phosphor.slow_decay_ms) * 1e-3,
    )


@dataclass(frozen=True, kw_only=True)
class Phosphor(
    Stage,
    slot=Slot.PHOSPHOR,
    section="phosphor",
    quantity="photons per exposure and cell",
    takes="electrons",
    emits="screen photons",
):
    """Phosphor with all the spread between the MCP's input and the fibre window."""

    photons_per_electron: float  # photons out of the window per electron that leaves the MCP
    # blur after the gain: whole pulses are spread, so that neighbouring pixels share their noise
    spread: StageBlur
    # relative standard deviation of the phosphor's granularity, dimensionless
    gain_nonuniformity: float = 0.0
    pattern_seed: int = 0  # seed of the granularity: the same device always has the same
    effects: ClassVar = {"phosphor granularity": {"gain_nonuniformity": 0.0}}

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        """Return the phosphor of a camera, with the share of the tube's blur behind the gain."""
        tube = camera.description.tube
        spread = TubeShare.of(tube, float(tube.post_gain_share))
        phosphor, drawn = camera.description.phosphor, camera.specimen.drawn_light
        return values_of(
            cls,
            phosphor,
            spread=spread,
            gain_nonuniformity=float(phosphor.gain_nonuniformity) * drawn,
            pattern_seed=camera.pattern_seed,
        )

    def mean(self, light: StageImage) -> StageImage:
        """Return photons per cell, with the spread pending."""
        values = light.values * np.asarray(self.photons_per_electron, light.values.dtype)
        if self.gain_nonuniformity > 0.0 and light.grid is not None:
            values *= pattern.phosphor_granularity(
                light.grid, self.gain_nonuniformity, self.pattern_seed
            )
        return light.with_values(values).with_blurs(self.spread)

    def bounds(self, budget: Any) -> dict[str, float]:
        """Return the influence of the granularity: a change of gain by its largest value."""
        cells = budget.camera.cells
        grains = (
            budget.mean_pe.size * cells.pitch_x_mm * cells.pitch_y_mm / pattern.GRANULARITY_MM**2
        )
        return {
            "phosphor granularity": budget.extreme(2.0 * grains)
            * self.gain_nonuniformity
            * budget.of_gain(1.0)
        }


@dataclass(frozen=True, kw_only=True)
class PhosphorDecay(
    Stage,
    slot=Slot.DECAY,
    section="phosphor",
    quantity="photons per exposure and pixel",
    takes="screen photons on pixels",
    emits="screen photons on pixels",
):
    """The phosphor's decay, field by field.

    It commutes with the linear optics behind the phosphor and stands after them, where images are
    small.

    Notes
    -----
    A pulse that arrives u before the end of its field T leaves sum_i a_i exp(-u/tau_i) of its light
    to later fields, a_i the components' fractions of the light, tau_i their time constants. Pulses
    arrive evenly over the gate, so the fractions differ from pulse to pulse; that matters for the
    noise, whose fraction in one field is the mean square. A field of the stage-by-stage chain is
    therefore drawn in two halves, early and late, whose fractions are the mean plus and minus the
    leading component of the fractions' covariance: their mean is exact, and their mean products are
    so to about one per cent.
    """

    components: Components  # decay law, see `decay_components`
    gate_s: float  # time that the gate is open at the start of each field, s
    field_s: float  # time from one field to the next, s
    effects: ClassVar = {"phosphor decay": {"components": ((1.0, 0.0),)}}

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        components = decay_components(camera.description.phosphor)
        return cls(components=components, gate_s=camera.open_s(conditions), field_s=camera.field_s)

    def __post_init__(self) -> None:
        if not 0.0 < self.gate_s <= self.field_s * (1.0 + 1e-6):
            raise BadInput(
                f"gate_ns must be positive and at most one field, {self.field_s * 1e9:.4g} ns, "
                f"got {self.gate_s * 1e9:.4g}"
            )

    @cached_property
    def arrivals(self) -> NDArray[np.float64]:
        """Evenly spaced arrival times over which decay is averaged, as fractions of the gate."""
        return (np.arange(ACCURACY.n_arrival_times) + 0.5) / ACCURACY.n_arrival_times

    def remainder(self, arrival: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the fraction that each component leaves of pulses to later fields, shape
        (component, pulse).
        """
        weight, tau = self._weight, self._tau
        component_light = weight * tau
        decay = np.exp(-(self.field_s - self.gate_s * arrival) / tau[:, None])
        return component_light[:, None] / component_light.sum() * decay

    @property
    def _weight(self) -> NDArray[np.float64]:
        return np.array([weight for weight, _ in self.components])

    @property
    def _tau(self) -> NDArray[np.float64]:
        # A phosphor without decay is one whose decay is far below any gate.
        return np.maximum(np.array([tau for _, tau in self.components]), 1e-12)

    @property
    def retention(self) -> NDArray[np.float64]:
        """Fraction of what each component stores that stays stored for one field more, shape
        (component,).
        """
        return np.exp(-self.field_s / self._tau)

    @cached_property
    def lasting(self) -> NDArray[np.bool_]:
        """Which components leave any light to later fields, shape (component,)."""
        return self.remainder(self.arrivals).mean(axis=1) > ACCURACY.min_stored_fraction

    @cached_property
    def recursion(self) -> NDArray[np.float32]:
        """Mean fraction stored, its spread, and fraction kept, of each lasting component, shape (3,
        component).

        Notes
        -----
        The spread of each component over arrival times is its regression on what all leave
        together, so that the variance of the field and its covariance with later ones are exact.
        """
        remainders = self.remainder(self.arrivals)
        mean, total = remainders.mean(axis=1), remainders.sum(axis=0)
        spread = (remainders - mean[:, None]) @ total / total.size / (float(total.std()) or 1.0)
        return np.stack([mean, spread, self.retention]).astype(np.float32)[:, self.lasting]

    @cached_property
    def lateness(self) -> float:
        """Skewness over arrival times of what all components leave together, dimensionless."""
        total = self.remainder(self.arrivals).sum(axis=0)
        scatter = float(total.std())
        return float(np.mean(((total - total.mean()) / scatter) ** 3)) if scatter > 1e-30 else 0.0

    @cached_property
    def pulse_shares(self) -> NDArray[np.float64]:
        """Fractions of the light of pulses at evenly spaced times, shape (pulse, field), each
        summing to 1.

        Field 0 is the pulse's own. What comes later than the last field is on average less than
        `Accuracy.max_lag_fraction` and is added to it.
        """
        # The slowest component alone has faded below what is forgotten after so many fields.
        log_limit = np.log(1.0 / ACCURACY.max_lag_fraction)
        longest = int(np.ceil(self._tau.max() / self.field_s * log_limit)) + 2
        remainders = self.remainder(self.arrivals).T @ self.retention[:, None] ** np.arange(longest)
        n_fields = int(np.argmax(remainders.mean(axis=0) < ACCURACY.max_lag_fraction))
        remainders[:, n_fields:] = 0.0
        return -np.diff(remainders[:, : n_fields + 1], axis=1, prepend=1.0)

    @property
    def weights(self) -> NDArray[np.float64]:
        """Mean fraction of a field's light that comes out in field j after it, shape (field,),
        summing to 1.
        """
        return self.pulse_shares.mean(axis=0)

    @property
    def n_lag_fields(self) -> int:
        """Number of earlier fields that contribute to a field (lag fields)."""
        return len(self.weights) - 1

    @cached_property
    def halves(self) -> NDArray[np.float64]:
        """Fractions of the early and the late half of a field's pulses, shape (2, field); equal
        without decay.
        """
        mean = self.weights
        values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(self.pulse_shares.T, bias=True)))
        spread = np.sqrt(max(values[-1], 0.0)) * vectors[:, -1]
        spread = spread * (1.0 if spread[0] >= 0.0 else -1.0)
        return np.stack([mean + spread, mean - spread])

    def residuals(self, fields: int) -> NDArray[np.float64]:
        """Fraction of a field's light that comes after the end of field j = 0, 1, ..., shape
        (fields,).
        """
        remainder = 1.0 - np.cumsum(self.weights)
        return np.pad(remainder, (0, max(0, fields - len(remainder))))[:fields]

    def mean(self, light: StageImage) -> StageImage:
        """Return the light that each field emits, earlier fields included.

        Takes (field, row, col), or (field, half, row, col) with the halves' own fractions, and
        emits (field, row, col). Fields before the first are taken to have been like the first, so a
        steady scene stays as it is.
        """
        fields = light.values
        if fields.ndim < 3:
            return light
        lag_fields = [fields[0]] * self.n_lag_fields
        return light.with_values(
            apply_phosphor_decay(
                [*lag_fields, *fields], self.weights if fields.ndim == 3 else self.halves
            )
        )

    def bounds(self, budget: Any) -> dict[str, float]:
        """Return the influence of decay: without it the noise of each field is larger and fields
        are uncorrelated.
        """
        pulse_share = float(np.max(budget.of_pulses / budget.variance))
        second, third = budget.of_chain.decay
        correlation = budget.of_chain.next_field / second
        noise_increase = np.sqrt(1.0 + pulse_share * (1.0 / second - 1.0)) - 1.0
        skewed = budget.of_skewness(budget.mean_pe) * abs(1.0 - second**1.5 / third)
        return {"phosphor decay": max(float(noise_increase) + skewed, correlation * pulse_share)}


def apply_phosphor_decay(
    fields: Sequence[NDArray] | NDArray, weights_by_field: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the light emitted in each field that has all its lag fields, shape (field, row, col).

    Parameters
    ----------
    fields
        Images in the order of time, each of shape (row, col), or (half, row, col) with fractions of
        each half.
    weights_by_field
        Fraction of a field's light in field j after it, shape (m,) or (half, m).

    Notes
    -----
    sum_j fractions[j] fields[n - j], summed over halves.
    """
    weights = np.atleast_2d(weights_by_field).T.astype(np.float32)
    images = []
    for n in range(len(weights) - 1, len(fields)):
        total = np.zeros(fields[n].shape[-2:], np.float32)
        for lag, of_halves in enumerate(weights):
            halves = np.asarray(fields[n - lag], np.float32).reshape(-1, *total.shape)
            for weight, half in zip(of_halves, halves, strict=True):
                total += weight * half
        images.append(total)
    return np.stack(images)
