"""Observation of ion feedback: number and charge of the events in a dark that are larger than
pulses.
"""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from charact.fitting import predicted_quantities as predicted
from charact.fitting.prior import values_of_description
from charact.fitting.thresholds import DARK_ERRORS, DARKS, ION_ERRORS
from charact.fitting.tube_frames import frames_of
from charact.fitting.tube_light import field_products
from charact.observables import Estimates, Observable, Values, columns, observable
from charact.observables.stack_level import StackLevel
from labdata import Array, Camera, Result

RATE, SIZE = "microchannel_plate.ion_event_rate_per_s_cm2", "microchannel_plate.ion_event_size_pe"
IONS = (RATE, SIZE)
DETECTED, SHAPE = (
    "microchannel_plate.detection_probability",
    "microchannel_plate.pulse_height_shape",
)


@dataclass(frozen=True, kw_only=True)
class IonEvents:
    """Events of a dark that are larger than pulses, and pixels that they reach."""

    level: StackLevel
    sensor: Camera
    data: NDArray[np.float32]  # frames of the dark, shape (frame, row, col), DN
    reached: NDArray[
        np.bool_
    ]  # pixels that the light of an event may reach in any frame, shape (row, col)
    charge_dn: tuple[float, ...]  # charge of each event in its window and brightest field, DN
    least_dn: float  # charge in the window from which an event counts as that of an ion, DN
    in_window: float  # fraction of a pulse's light in a field that its window contains
    event_dn: float  # k F^2 as measured, DN
    variance_dn2: float  # what the events add to the variance of a pixel, DN^2

    @property
    def are_sparse(self) -> bool:
        """Whether most of the frame is free of them."""
        return float(self.reached.mean()) < DARK_ERRORS.most_reached

    @property
    def has_charge(self) -> bool:
        """Whether the events are enough for a mean charge."""
        return len(self.charge_dn) >= ION_ERRORS.least_events

    @property
    def exposure_of_pixels_s(self) -> float:
        """Time that all pixels of all fields were exposed, s."""
        return self.level.gate_s * self.data.size


def light_in_window(values: Values) -> float:
    """Return the fraction of a pulse's light in its window, for a Gaussian of the known blur."""
    from scipy.special import erf

    sizes = zip(DARKS.window, reversed(sizes_of_pulses(values)), strict=True)
    return float(np.prod([erf(width_px / (2.0 * np.sqrt(2.0) * size)) for width_px, size in sizes]))


def sizes_of_pulses(values: Values) -> tuple[float, float]:
    """Return the standard deviations of a Gaussian pulse along rows and columns, px.

    Two such Gaussians r px apart have the covariance exp(-r^2/(4 s^2)).
    """
    blur = predicted.pulse_covariance(values, ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))[0]
    across, along = (1.0 / np.sqrt(4.0 * np.log(blur[0] / neighbour)) for neighbour in blur[1:])
    return float(across), float(along)


def ions_of(sensor: Camera, result: Result, levels: tuple[StackLevel, ...]) -> IonEvents | None:
    """Return the ion events of the dark with most frames, or None without one of enough frames or a
    measured gain.
    """
    darks = [level for level in levels if level.dark and level.entry is not None]
    # A scale of the charge of pulses, for which any estimate will do.
    gains = [m.value for m in result.find("covariance_gain") if m.value]
    if not darks or not gains:
        return None
    level = max(darks, key=lambda level: level.shape[0])
    data = frames_of(level)
    if data is None or len(data) < DARKS.least_frames:
        return None
    return find_ions(data, level, sensor, gains[0])


def find_ions(
    data: NDArray[np.float32], level: StackLevel, sensor: Camera, event_dn: float
) -> IonEvents:
    """Return the ion events of a dark's frames (frame, row, col); `event_dn`: k F^2, DN."""
    from scipy.ndimage import label, maximum, maximum_filter, uniform_filter

    values, step = values_of_description(sensor), sensor.fields
    in_window = light_in_window(values)
    in_field = in_window * float(np.sqrt(field_products(values, level.gate_s, 1)[0, 0]))
    charge, window = np.empty_like(data), cast(Any, (0, *DARKS.window))
    for parity in range(step):
        charge[:, parity::step] = uniform_filter(data[:, parity::step], size=window) - data.mean()
    charge *= DARKS.window[0] * DARKS.window[1]
    low, middle = np.quantile(charge[0], (0.16, 0.5))
    noise_dn = max(
        DARKS.ion_sd * float(middle - low), DARKS.ion_pixel_dn * DARKS.window[0] * DARKS.window[1]
    )
    least_charge = max(DARKS.ion_charge * event_dn * in_field, noise_dn)
    seed = charge > least_charge
    # An event is seen in both fields and in later frames: what touches is one event.
    is_event = np.asarray(maximum_filter(seed, size=(1, 5, 5)), bool)
    parts, count = cast(Any, label(is_event, structure=np.ones((3, 3, 3))))
    largest = (
        np.atleast_1d(maximum(charge, parts, np.arange(1, count + 1))) if count else np.empty(0)
    )
    reached = maximum_filter(seed.any(axis=0), size=DARKS.ion_reach) > 0
    return IonEvents(
        level=level,
        sensor=sensor,
        data=data,
        reached=reached,
        least_dn=least_charge,
        in_window=in_window,
        event_dn=event_dn,
        variance_dn2=float(np.sum((data[is_event] - data.mean()) ** 2)) / data.size,
        charge_dn=tuple(float(charge_of_event) for charge_of_event in largest),
    )


def moment_below(shape: Array, mean: Array | float, limit: Array, order: int) -> Array:
    """Return the part of the moment of an order of gamma distributed charges below a limit."""
    from scipy.special import gammainc, poch

    shape, scale = np.asarray(shape, float), np.asarray(mean) / shape
    return (
        scale**order * poch(shape, order) * gammainc(shape + order, np.maximum(limit, 0.0) / scale)
    )


def square_below(shape: Array, limit: Array) -> Array:
    """Return the part of the mean square of detected pulses below a limit, both in mean detected
    pulses.
    """
    return moment_below(shape, 1.0, limit, 2) / (1.0 + 1.0 / shape)


def single_pulse_limit(values: Values, events: IonEvents) -> Array:
    """Return the charge from which an event counts as that of an ion, in mean detected pulses,
    shape (n,).
    """
    return events.least_dn / _in_window(values, events)


def weak_ions(values: Values, events: IonEvents) -> tuple[Array, Array]:
    """Return mean and mean square light of ion events too small to be counted, by field pixel and
    field.

    Shapes (n,), DN and DN^2.
    """
    rate, height = predicted.ion_rate(values) * events.level.gate_s, _pulse_dn(values, events)
    mean, square = (_moment_of_weak(values, events, order) for order in (1, 2))
    return rate * mean * height, rate * square * height**2


def _pulse_dn(values: Values, events: IonEvents) -> Array:
    """Return the charge of the mean detected pulse k/p, shape (n,), DN."""
    return predicted.photoelectron_gain(values, events.level.mcp_v) / values[DETECTED]


def _in_window(values: Values, events: IonEvents) -> Array:
    """Return the charge of the mean detected pulse in its window and brightest field, shape (n,),
    DN.
    """
    in_field = np.sqrt(field_products(values, events.level.gate_s, 1)[:, 0])
    return _pulse_dn(values, events) * events.in_window * in_field


def _moment_of_weak(values: Values, events: IonEvents, order: int) -> Array:
    """Return the part of a moment of the charge of ion events that is below the limit, in mean
    detected pulses.

    The charge of an event is the sum of a Poisson number of pulses, here as the gamma distribution
    of its mean m and variance m (1 + 1/shape).
    """
    size, spread = values[SIZE], 1.0 + 1.0 / values[SHAPE]
    return moment_below(size / spread, size, single_pulse_limit(values, events), order)


def _coincidences(values: Values, limit: Array, gate_s: float) -> Array:
    """Return the number of pulses and groups of pulses above a limit, by field pixel and second,
    shape (n,).

    Of k pulses besides one in its window, a Poisson number, the charge is gamma distributed of the
    shape (1 + k) a; the group is one event.
    """
    from scipy.special import gammaincc

    rate = predicted.background_rate(values) * values[DETECTED]
    besides = rate * gate_s * DARKS.window[0] * DARKS.window[1]
    total, probability = np.zeros(np.broadcast(rate, limit).shape), np.exp(-besides)
    for k in range(12):
        fraction_above = gammaincc((1 + k) * values[SHAPE], limit * values[SHAPE])
        total = total + probability * fraction_above / (1 + k)
        probability = probability * besides / (1 + k)
    return rate * total


@observable
class IonEventNumber(Observable[IonEvents]):
    """Square root of the number of counted ion events, and logarithm of their mean charge.

    The root of a Poisson number plus 3/8 has the variance 1/4 nearly (Anscombe 1948). Of few events
    only the number is observed, not the charge.
    """

    name = "ion events"
    order = 72
    tube = True
    depends = IONS

    def usable(self, stacks: Any) -> IonEvents | None:
        """Return the ion events of the dark if most of the frame is free of them."""
        return stacks.ions if stacks.ions is not None and stacks.ions.are_sparse else None

    def measure(self, shown: IonEvents) -> Estimates:
        charges = np.array(shown.charge_dn)
        number = charges.size
        value, sd = [float(np.sqrt(number + 0.375))], [0.5]
        if shown.has_charge:
            value.append(float(np.log(charges.mean())))
            sd.append(float(charges.std(ddof=1) / charges.mean() / np.sqrt(number)))
        return Estimates(value=np.array(value), covariance=np.diag(np.square(sd)))

    def model_covariance(self, estimates: Estimates, shown: IonEvents) -> Array:
        """Return the covariance by number, coincidences of pulses, and charge."""
        # At the charge of pulses as measured: the described gain may be far from it.
        sheet, root = values_of_description(shown.sensor), float(estimates.value[0])
        pulse_dn = shown.event_dn / (1.0 + 1.0 / sheet[SHAPE])
        limit = single_pulse_limit(sheet, shown) * _pulse_dn(sheet, shown) / pulse_dn
        groups = _coincidences(sheet, limit, shown.level.gate_s)[0] * shown.exposure_of_pixels_s
        of_number = np.hypot(
            ION_ERRORS.number * root, 0.5 * ION_ERRORS.coincidences * float(groups) / root
        )
        return np.diag(np.square([of_number, ION_ERRORS.charge][: estimates.value.size]))

    def predict(self, values: Values, shown: IonEvents) -> Array:
        ions = predicted.ion_rate(values) * shown.exposure_of_pixels_s
        counted = ions * (1.0 - _moment_of_weak(values, shown, 0))
        charge_above_limit = ions * (values[SIZE] - _moment_of_weak(values, shown, 1))
        limit = single_pulse_limit(values, shown)
        pulses = _coincidences(values, limit, shown.level.gate_s) * shown.exposure_of_pixels_s
        expected = counted + pulses
        # Where none is expected, an event is one at the limit.
        few = 1e-9
        charge = (charge_above_limit + (pulses + few) * (limit + 1.0)) / (expected + few)
        numbers = np.sqrt(expected + 0.375), np.log(charge * _in_window(values, shown))
        return columns(*numbers[: 1 + shown.has_charge])
