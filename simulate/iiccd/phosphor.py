"""The screen: electrons become light, spread sideways and linger over the following fields."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd import pattern
from simulate.iiccd.light import Light
from simulate.iiccd.transfer import Blur

# Light that comes later than the remembered fields is less than this share.
FORGOTTEN = 1e-3


@dataclass(frozen=True, kw_only=True)
class Phosphor:
    """Screen with all the spread between the plate's input and the fibre window.

    Parameters
    ----------
    photons_per_electron
        Photons out of the window per electron that leaves the plate.
    spread
        Blur after the gain: whole pulses are spread, so that neighbouring pixels share their noise.
    gain_nonuniformity
        Relative standard deviation of the screen's mottle, dimensionless.
    specimen
        Seed of the mottle: the same specimen always has the same.
    """

    photons_per_electron: float
    spread: Blur
    gain_nonuniformity: float = 0.0
    specimen: int = 0
    name: str = "phosphor"
    takes: str = "electrons"
    emits: str = "screen photons"

    def mean(self, light: Light) -> Light:
        """Return photons per cell, owing the spread."""
        values = light.values * np.asarray(self.photons_per_electron, light.values.dtype)
        if self.gain_nonuniformity > 0.0 and light.grid is not None:
            values *= pattern.mottle(light.grid, self.gain_nonuniformity, self.specimen)
        return light.with_values(values).blurred(self.spread)

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return the mean: photons are so many that their noise is drawn where they are detected."""
        return self.mean(light)


@dataclass(frozen=True, kw_only=True)
class Afterglow:
    """The screen's decay, field by field.

    It commutes with the linear optics behind the screen and stands after them, where images are small.

    Parameters
    ----------
    fast_fraction
        Share of the fast component in the light at the start of the decay, dimensionless.
    fast_decay_ms, slow_decay_ms
        Time constants, ms.
    gate_s
        Time that the gate is open at the start of each field, s.
    field_s
        Time from one field to the next, s.

    Notes
    -----
    Electrons arrive evenly over the gate tg at the start of a field T. Of a component of time constant tau the share
    that comes out after the end of the j-th field (j = 0: its own) is (tau/tg)(exp(tg/tau) - 1) exp(-(j + 1) T/tau).
    A field's pulses share these mean shares; that pulses early in the gate leave a little less is neglected.
    """

    fast_fraction: float
    fast_decay_ms: float
    slow_decay_ms: float
    gate_s: float
    field_s: float
    name: str = "afterglow"
    takes: str = "screen photons on pixels"
    emits: str = "screen photons on pixels"

    def __post_init__(self) -> None:
        if not 0.0 < self.gate_s <= self.field_s * (1.0 + 1e-6):
            raise BadInput(
                f"gate_ns must be positive and at most one field, {self.field_s * 1e9:.4g} ns, got {self.gate_s * 1e9:.4g}"
            )

    def residuals(self, fields: int) -> NDArray[np.float64]:
        """Share of a field's light that comes after the end of field j = 0, 1, ..., shape (fields,)."""
        # A screen without decay is one whose decay is far below any gate.
        tau = np.maximum(np.array([self.fast_decay_ms, self.slow_decay_ms]) * 1e-3, 1e-12)
        shares = np.array([self.fast_fraction, 1.0 - self.fast_fraction]) * tau
        ends = (np.arange(fields)[:, None] + 1.0) * self.field_s
        late = tau / self.gate_s * -np.expm1(-self.gate_s / tau) * np.exp(-(ends - self.gate_s) / tau)
        return late @ (shares / shares.sum())

    @property
    def weights(self) -> NDArray[np.float64]:
        """Share of a field's light that comes out in field j after it, shape (field,), summing to 1.

        What comes later than the last is less than `FORGOTTEN` and is added to the last.
        """
        late = self.residuals(64)
        last = int(np.argmax(late < FORGOTTEN))
        late[last:] = 0.0
        return -np.diff(late[: last + 1], prepend=1.0)

    @property
    def memory(self) -> int:
        """Earlier fields whose light is still seen."""
        return len(self.weights) - 1

    def mean(self, light: Light) -> Light:
        """Return what each field shows of itself and of those before it, shape (field, row, col).

        Fields before the first are taken to have been like the first, so a steady scene stays as it is.
        """
        if light.values.ndim != 3:
            return light
        weights = self.weights.astype(light.values.dtype)
        before = np.repeat(light.values[:1], self.memory, axis=0)
        return light.with_values(lingering(np.concatenate([before, light.values]), weights))

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return the mean: decay adds no noise of its own."""
        return self.mean(light)


def lingering(fields: NDArray, weights: NDArray) -> NDArray:
    """Return sum_j weights[j] fields[n - j] for every field n that has all its predecessors.

    Shapes: fields (field, row, col), weights (m,), result (field - m + 1, row, col).
    """
    count = len(fields) - len(weights) + 1
    total = weights[0] * fields[len(weights) - 1 :]
    for j, weight in enumerate(weights[1:], start=1):
        total += weight * fields[len(weights) - 1 - j :][:count]
    return total
