"""Phosphor: electrons become photons, spread laterally and decay over later fields."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd import pattern
from simulate.iiccd.accuracy import ACCURACY
from simulate.iiccd.stage_image import NoiselessStage, StageImage
from simulate.iiccd.transfer import StageBlur


@dataclass(frozen=True, kw_only=True)
class Phosphor(NoiselessStage):
    """Phosphor with all the spread between the MCP's input and the fibre window.

    Parameters
    ----------
    photons_per_electron
        Photons out of the window per electron that leaves the MCP.
    spread
        Blur after the gain: whole pulses are spread, so that neighbouring pixels share their noise.
    gain_nonuniformity
        Relative standard deviation of the phosphor's granularity, dimensionless.
    pattern_seed
        Seed of the granularity: the same device always has the same.
    """

    photons_per_electron: float
    spread: StageBlur
    gain_nonuniformity: float = 0.0
    pattern_seed: int = 0
    name: str = "phosphor"
    takes: str = "electrons"
    emits: str = "screen photons"

    def mean(self, light: StageImage) -> StageImage:
        """Return photons per cell, with the spread pending."""
        values = light.values * np.asarray(self.photons_per_electron, light.values.dtype)
        if self.gain_nonuniformity > 0.0 and light.grid is not None:
            values *= pattern.phosphor_granularity(light.grid, self.gain_nonuniformity, self.pattern_seed)
        return light.with_values(values).with_blurs(self.spread)


@dataclass(frozen=True, kw_only=True)
class PhosphorDecay(NoiselessStage):
    """The phosphor's decay, field by field.

    It commutes with the linear optics behind the phosphor and stands after them, where images are small.

    Parameters
    ----------
    fast_fraction
        Fraction of the fast component in the light at the start of the decay, dimensionless.
    fast_decay_ms, slow_decay_ms
        Time constants, ms.
    gate_s
        Time that the gate is open at the start of each field, s.
    field_s
        Time from one field to the next, s.

    Notes
    -----
    A pulse that arrives u before the end of its field T leaves sum_i a_i exp(-u/tau_i) of its light to later fields,
    a_i the components' fractions of the light, tau_i their time constants. Pulses arrive evenly over the gate, so the
    fractions differ from pulse to pulse; that matters for the noise, whose fraction in one field is the mean square. A
    field is therefore drawn in two halves, early and late, whose fractions are the mean plus and minus the leading
    component of the fractions' covariance: their mean is exact, and their mean products are so to about one per cent.
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
                f"gate_ns must be positive and at most one field, {self.field_s * 1e9:.4g} ns, "
                f"got {self.gate_s * 1e9:.4g}"
            )

    @cached_property
    def pulse_shares(self) -> NDArray[np.float64]:
        """Fractions of the light of pulses at evenly spaced times, shape (pulse, field), each summing to 1.

        Field 0 is the pulse's own. What comes later than the last field is on average less than
        `Accuracy.max_lag_fraction` and is added to it."""
        # A phosphor without decay is one whose decay is far below any gate.
        tau = np.maximum(np.array([self.fast_decay_ms, self.slow_decay_ms]) * 1e-3, 1e-12)
        share = np.array([self.fast_fraction, 1.0 - self.fast_fraction]) * tau
        arrival = self.gate_s * (np.arange(ACCURACY.n_arrival_times) + 0.5) / ACCURACY.n_arrival_times
        # The slowest component alone has faded below what is forgotten after so many fields.
        longest = int(np.ceil(tau.max() / self.field_s * np.log(1.0 / ACCURACY.max_lag_fraction))) + 2
        ends = self.field_s * np.arange(1.0, longest + 1)
        late = np.exp(-(ends[None, :, None] - arrival[:, None, None]) / tau) @ (share / share.sum())
        last = int(np.argmax(late.mean(axis=0) < ACCURACY.max_lag_fraction))
        late[:, last:] = 0.0
        return -np.diff(late[:, : last + 1], axis=1, prepend=1.0)

    @property
    def weights(self) -> NDArray[np.float64]:
        """Mean fraction of a field's light that comes out in field j after it, shape (field,), summing to 1."""
        return self.pulse_shares.mean(axis=0)

    @cached_property
    def halves(self) -> NDArray[np.float64]:
        """Fractions of the early and the late half of a field's pulses, shape (2, field); equal without decay."""
        mean = self.weights
        values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(self.pulse_shares.T, bias=True)))
        spread = np.sqrt(max(values[-1], 0.0)) * vectors[:, -1]
        spread = spread * (1.0 if spread[0] >= 0.0 else -1.0)
        return np.stack([mean + spread, mean - spread])

    def residuals(self, fields: int) -> NDArray[np.float64]:
        """Fraction of a field's light that comes after the end of field j = 0, 1, ..., shape (fields,)."""
        later = 1.0 - np.cumsum(self.weights)
        return np.pad(later, (0, max(0, fields - len(later))))[:fields]

    @property
    def n_lag_fields(self) -> int:
        """Number of earlier fields that contribute to a field (lag fields)."""
        return len(self.weights) - 1

    def mean(self, light: StageImage) -> StageImage:
        """Return the light that each field emits, earlier fields included.

        Takes (field, row, col), or (field, half, row, col) with the halves' own fractions, and emits (field, row, col).
        Fields before the first are taken to have been like the first, so a steady scene stays as it is.
        """
        fields = light.values
        if fields.ndim < 3:
            return light
        before = np.repeat(fields[:1], self.n_lag_fields, axis=0)
        shares = self.weights if fields.ndim == 3 else self.halves
        return light.with_values(apply_phosphor_decay(np.concatenate([before, fields]), shares))


def apply_phosphor_decay(
    fields: NDArray, shares: NDArray[np.float64], order: NDArray[np.integer] | None = None
) -> NDArray:
    """Return the light emitted in each field that has all its lag fields, shape (field, row, col).

    Parameters
    ----------
    fields
        Fields, shape (field, row, col), or (field, half, row, col) with fractions of each half.
    shares
        Fraction of a field's light in field j after it, shape (m,) or (half, m).
    order
        Indices of the fields in the order of time, shape (field,); as they stand if None.

    Notes
    -----
    sum_j fractions[j] fields[n - j], summed over halves.
    """
    by_half = np.atleast_2d(shares)
    halves, fields_seen = by_half.shape
    slots = np.arange(len(fields)) if order is None else order
    images = fields.astype(np.float32, copy=False).reshape(-1, *fields.shape[-2:])
    # Latest field first, its halves side by side, as the images lie in memory.
    weights = by_half.T.ravel()
    shown = []
    for n in range(fields_seen - 1, len(fields)):
        latest_first = slots[n - fields_seen + 1 : n + 1][::-1]
        which = (latest_first[:, None] * halves + np.arange(halves)).ravel()
        total = np.zeros(images.shape[1:], np.float32)
        for image, weight in zip(which, weights.astype(np.float32), strict=True):
            total += weight * images[image]
        shown.append(total)
    return np.stack(shown)
