"""Observations of image lag and line noise of a camera with a tube, from the successive frames of
its flats.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.fitting import predicted_quantities as predicted
from charact.fitting.observation import Observation, scalar_observation
from charact.fitting.prior import rounds_its_darks, values_of_description
from charact.fitting.thresholds import FRAMES
from charact.observables import Values
from charact.observables.stack_level import StackLevel
from charact.transfer.stages import fibres, image_tube, slit
from charact.transfer.video_filter import sampled_response, transfer
from labdata.camera.description import Camera

Array = NDArray[np.float64]


DECAY = ("phosphor.fast_fraction", "phosphor.fast_decay_ms", "phosphor.slow_decay_ms")
EVENT = ("tube.post_gain_share", "tube.mtf_frequency_lp_per_mm", "tube.mtf_exponent")
LINE_NOISE = "video.line_noise_dn"


@dataclass(frozen=True, kw_only=True)
class Fields:
    """Frames of a steady scene as deviations from the mean of each pixel and each field, and their
    conditions.
    """

    deviation: NDArray[np.float32]  # shape (frame, row, col), DN
    interlaced: bool
    signal_dn: float  # mean level above black, DN
    gate_s: float
    mcp_v: float

    @property
    def fields_per_frame(self) -> int:
        """Fields that a frame is woven of."""
        return 2 if self.interlaced else 1

    @property
    def setting(self) -> tuple[int, float, float]:
        """Number of frames, gate and MCP voltage."""
        return len(self.deviation), self.gate_s, self.mcp_v


def frames_of(level: StackLevel, sensor: Camera) -> NDArray[np.float32] | None:
    """Return the middle of a stack's successive frames, DN, or None of too few, or of frames that
    were lost.
    """
    if level.entry is None:
        return None
    stack = level.entry.read()
    count = min(len(stack), FRAMES.most_frames)
    if count < FRAMES.least_frames or np.any(np.diff(stack.frame_number[:count]) != 1):
        return None
    rows, columns = stack.data.shape[1:]
    # An even first row keeps the order of the fields.
    top, first_column = (
        (max(rows - FRAMES.most_rows, 0) // 4) * 2,
        max(columns - FRAMES.most_columns, 0) // 2,
    )
    return stack.data[
        :count, top : top + FRAMES.most_rows, first_column : first_column + FRAMES.most_columns
    ].astype(np.float32)


def fields_of(level: StackLevel, sensor: Camera, black_dn: float) -> Fields | None:
    """Return the deviations of a stack's successive frames, or None where `frames_of` has none."""
    data = frames_of(level, sensor)
    if data is None:
        return None
    step = 2 if sensor.video.interlaced else 1
    for parity in range(step):
        field = data[:, parity::step]
        field -= field.mean(axis=(1, 2), keepdims=True, dtype=np.float64).astype(np.float32)
    data -= data.mean(axis=0)
    return Fields(
        deviation=data,
        interlaced=bool(sensor.video.interlaced),
        signal_dn=level.mean_dn - black_dn,
        gate_s=level.gate_s,
        mcp_v=level.mcp_v,
    )


def time_observations(sensor: Camera, levels: tuple[StackLevel, ...]) -> list[Observation]:
    """Return the observations of image lag and line noise; a session whose flats cannot show one
    has none of it.
    """
    black_dn = min(
        (level.mean_dn for level in levels if level.dark),
        default=float(sensor.video.black_level_dn),
    )
    lit = sorted((level for level in levels if not level.dark), key=lambda level: -level.mean_dn)
    noisy = [level for level in lit if level.noise_dn > FRAMES.least_noise_dn]
    darks = [level for level in levels if level.dark]
    observations: list[Observation] = []
    if LINE_NOISE in sensor.parameters():
        # Rounding multiplies the offset of a line where the noise of its pixels is small.
        observations += _line_noise(
            sensor, noisy if rounds_its_darks(sensor) else noisy + darks, black_dn
        )
    flats = [
        fields
        for level in noisy[: FRAMES.most_flats]
        if (fields := fields_of(level, sensor, black_dn)) is not None
    ]
    same_setting = [flat for flat in flats if flat.setting == flats[0].setting]
    observations += [_lag(same_setting, sensor)] if same_setting else []
    return [
        observed for observed in observations if depends_on(observed, sensor, (*DECAY, LINE_NOISE))
    ]


def depends_on(observed: Observation, sensor: Camera, paths: tuple[str, ...]) -> bool:
    """Whether any of the parameters moves a prediction by a standard error or more over its prior
    range.
    """
    known, values = sensor.parameters(), values_of_description(sensor)
    ends = {
        path: (known[path].low, known[path].high)
        for path in observed.parameters
        if path in paths and path in known
    }
    tried = [
        (path, end) for path, range_ends in ends.items() for end in range_ends if end is not None
    ]
    nominal = observed.predict(values)[0]
    shifted = [
        replace(observed, value=nominal).chi_squared({**values, path: np.array([float(end)])})[0]
        for path, end in tried
    ]
    return max(shifted, default=0.0) > 1.0


def _lag(flats: list[Fields], sensor: Camera) -> Observation:
    """Observe the mean correlations of flats of one setting: they hardly depend on the signal."""
    measured = [measure_correlations(fields) for fields in flats]
    value = np.mean([correlations for correlations, _ in measured], axis=0)
    covariance = np.sum([errors for _, errors in measured], axis=0) / len(flats) ** 2
    middle = replace(flats[0], signal_dn=float(np.mean([fields.signal_dn for fields in flats])))
    reference_v = float(sensor.microchannel_plate.reference_v)

    def predict(values: Values) -> Array:
        return predict_correlations(values, middle, reference_v)

    return Observation(
        name="image lag",
        value=value,
        covariance=covariance + FRAMES.correlation_model_sd**2 * np.eye(value.size),
        predict=predict,
        parameters=(*DECAY, *EVENT),
    )


def measure_correlations(fields: Fields) -> tuple[Array, Array]:
    """Return the correlations of a pixel with itself in later frames and, of interlaced video, with
    the next field.

    The next field's is that of a row with its neighbours of the other field. The covariance of the
    errors is from the scatter over blocks of the image.
    """
    x, lags = fields.deviation, range(min(FRAMES.largest_lag, len(fields.deviation) // 2) + 1)
    count = len(x)
    products = [np.einsum("frc,frc->rc", x[: count - lag], x[lag:]) / (count - lag) for lag in lags]
    maps = [_blocks(product) for product in products]
    if fields.interlaced:
        maps.append(_blocks(_next_field(x)))
    table = np.stack(maps)
    mean = table.mean(axis=1)
    ratio = mean[1:] / mean[0]
    departure = (table[1:] - ratio[:, None] * table[0]) / mean[0]
    return ratio, np.cov(departure) / departure.shape[1]


def _next_field(x: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean product of rows with their neighbours of the next field, shape (row, col) of
    a field.
    """
    rows = (x.shape[1] - 1) // 2
    upper, middle, lower = (
        x[:, 0 : 2 * rows : 2],
        x[:, 1 : 2 * rows : 2],
        x[:, 2 : 2 * rows + 1 : 2],
    )
    neighbours = 0.5 * (upper[:, : len(middle[0])] + lower)
    same = np.einsum("frc,frc->rc", neighbours, middle) / len(x)
    # Of the two fields of a frame either may be the first: the neighbour in time correlates more.
    even_first = np.einsum("frc,frc->rc", middle[:-1], neighbours[1:]) / (len(x) - 1)
    odd_first = np.einsum("frc,frc->rc", neighbours[:-1], middle[1:]) / (len(x) - 1)
    return 0.5 * (same + (even_first if even_first.mean() >= odd_first.mean() else odd_first))


def block_sums(image: NDArray) -> Array:
    """Return the sums of the blocks of an image, shape (block,)."""
    rows, columns = (
        (np.arange(parts) * n) // parts for n, parts in zip(image.shape, FRAMES.blocks, strict=True)
    )
    return np.add.reduceat(
        np.add.reduceat(image.astype(np.float64), rows, axis=0), columns, axis=1
    ).ravel()


def _blocks(image: NDArray[np.floating]) -> Array:
    """Return the means of the blocks of an image, shape (block,)."""
    return block_sums(image) / block_sums(np.ones(image.shape))


def predict_correlations(values: Values, fields: Fields, reference_v: float) -> Array:
    """Return the correlations that `measure_correlations` measures, shape (n, k), dimensionless.

    Pulses of the signal s have, j fields apart, the covariance s k F^2 B c_j with the blur factor B
    and the products c_j of `field_products`; what the detector adds, s K sum w^2 and the noise of
    the dark, is of one field alone. The deviations from the means of n frames have the covariance P
    C P, P = 1 - 1/n.
    """
    count, step = len(fields.deviation), fields.fields_per_frame
    gain = predicted.photoelectron_gain(values, fields.mcp_v, reference_v)
    event = gain * predicted.excess_noise_factor(values)
    shape = pulse_covariance(values, ((0.0, 0.0), (0.0, 0.5)))
    decay = field_products(values, fields.gate_s, step * count)
    white = detector_variance(values, fields.signal_dn)
    pulses = (fields.signal_dn * event)[:, None] * decay
    same = pulses[:, ::step] * shape[:, :1]
    same[:, 0] += white
    lags = min(FRAMES.largest_lag, count // 2)
    expected = same @ _diagonal_means(count, tuple(range(lags + 1))).T
    if fields.interlaced:
        later = pulses[:, 1::2] * shape[:, 1:]
        expected = np.concatenate([expected, later @ _next_field_means(count)[:, None]], axis=1)
    return expected[:, 1:] / expected[:, :1]


def _projection(count: int) -> Array:
    return np.eye(count) - 1.0 / count


@lru_cache(maxsize=16)
def _diagonal_means(count: int, lags: tuple[int, ...]) -> Array:
    """Return the means of diagonals of P C P for unit covariances at each lag, shape (lag,
    count).
    """
    separation = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    project = _projection(count)
    columns = []
    for lag in range(count):
        projected = project @ (separation == lag) @ project
        columns.append([np.diagonal(projected, which).mean() for which in lags])
    return np.array(columns).T


@lru_cache(maxsize=16)
def _next_field_means(count: int) -> Array:
    """Return the mean over neighbours in time of P C P for unit covariances of fields 1, 3, 5, ...
    apart, (count,).
    """
    early, late = 2 * np.arange(count), 2 * np.arange(count) + 1
    separation = np.abs(np.subtract.outer(early, late))
    project = _projection(count)
    out = []
    for lag in range(count):
        projected = project @ (separation == 2 * lag + 1) @ project
        out.append(0.5 * (np.diagonal(projected).mean() + np.diagonal(projected, -1).mean()))
    return np.array(out)


def field_products(values: Values, gate_s: float, fields: int) -> Array:
    r"""Return the mean over arrival times of sum_i l_i l_(i+j) for j = 0 ... fields - 1, shape (n,
    fields).

    l_i is the fraction of a pulse's light in the i-th field after it.

    Notes
    -----
    Of two components with the fractions a of the light and the times tau, a pulse u before the end
    of its field T leaves E = exp(-u/tau) of a to later fields, of which the i-th shows (1 - q)
    q^(i-1), q = exp(-T/tau): l_0 = 1 - sum a E. Arrivals are even over the gate g at the start of
    the field, so that the mean of E is (tau/g) (exp(-(T - g)/tau) - exp(-T/tau)), and that of E E'
    the same with 1/tau + 1/tau'.
    """
    light_fraction, once, twice, keep = _fraction_in_later(values, gate_s)
    pair_products = light_fraction[:, :, None] * light_fraction[:, None, :] * twice
    out = np.empty((len(light_fraction), fields))
    out[:, 0] = 1.0 - 2.0 * np.sum(light_fraction * once, axis=1) + pair_products.sum(axis=(1, 2))
    # What is left of both components, once for each field after the first.
    lasting = (
        pair_products
        * (1.0 - keep)[:, :, None]
        * (1.0 - keep)[:, None, :]
        / (1.0 - keep[:, :, None] * keep[:, None, :])
    )
    out[:, 0] += lasting.sum(axis=(1, 2))
    first_later = (1.0 - keep) * (light_fraction * once - pair_products.sum(axis=1))
    for lag in range(1, fields):
        out[:, lag] = np.sum(
            first_later * keep ** (lag - 1) + lasting.sum(axis=1) * keep**lag, axis=1
        )
    return out


def field_light(values: Values, gate_s: float, fields: int) -> Array:
    """Return the mean fractions l_0 ... of a pulse's light in its field and later ones, shape (n,
    fields).
    """
    light_fraction, once, _, keep = _fraction_in_later(values, gate_s)
    later = (
        light_fraction[:, None, :]
        * once[:, None, :]
        * keep[:, None, :] ** np.arange(fields)[None, :, None]
    )
    return -np.diff(later.sum(axis=2), axis=1, prepend=1.0)


def _fraction_in_later(values: Values, gate_s: float) -> tuple[Array, Array, Array, Array]:
    """Return the fractions a of two components, the means of E and E E', and q; shape (n, 2), but E
    E' (n, 2, 2).
    """
    field_s = 1.0 / values["video.field_rate_hz"][:, None]
    fast = np.minimum(values["phosphor.fast_fraction"], 1.0)
    tau = np.stack(
        np.broadcast_arrays(
            *(values[f"phosphor.{name}_decay_ms"] * 1e-3 for name in ("fast", "slow"))
        )
    )
    light = np.stack(np.broadcast_arrays(fast * tau[0], (1.0 - fast) * tau[1]))
    light_fraction, rate = (light / light.sum(axis=0)).T, 1.0 / tau.T
    open_s = np.minimum(gate_s, field_s)

    def fraction(rate: Array, open_s: Array, field_s: Array) -> Array:
        return (np.exp(-(field_s - open_s) * rate) - np.exp(-field_s * rate)) / (open_s * rate)

    twice = fraction(rate[:, :, None] + rate[:, None, :], open_s[:, :, None], field_s[:, :, None])
    return light_fraction, fraction(rate, open_s, field_s), twice, np.exp(-field_s * rate)


def detector_variance(values: Values, signal_dn: float) -> Array:
    """Return the variance of a pixel that the detector adds to the pulses of a signal, shape (n,),
    DN^2.
    """
    filtered = filter_covariance(values, 1)[:, 0]
    electron = values["video.conversion_gain_dn_per_e"]
    dark_e = (
        predicted.rows_per_pixel(values)
        * values["ccd.dark_current_e_per_s"]
        / values["video.field_rate_hz"]
    )
    charge = electron * signal_dn + electron**2 * (values["ccd.read_noise_e"] ** 2 + dark_e)
    return charge * filtered + values.get(LINE_NOISE, np.zeros(1)) ** 2 + 1.0 / 12.0


def filter_covariance(values: Values, count: int) -> Array:
    """Return the covariances of filtered white noise of variance 1 at 0 ... count - 1 columns,
    shape (n, count).
    """
    if "video.bandwidth_mhz" not in values:
        return np.eye(1, count)
    weights = _weights(values)
    length = weights.shape[1]
    return np.stack(
        [np.sum(weights[:, : length - lag] * weights[:, lag:], axis=1) for lag in range(count)],
        axis=1,
    )


def _nodes() -> tuple[Array, Array, Array, Array]:
    """Return nodes and weights of a quadrant of the frequency plane, cycles per field pixel, across
    and along.
    """
    out = []
    for edges, counts in (((0.0, 0.2, 0.8, 2.0), (3, 4, 5)), ((0.0, 0.2, 1.0, 3.0), (3, 5, 7))):
        points, weights = [], []
        for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True):
            node, weight = np.polynomial.legendre.leggauss(count)
            points.append(low + (high - low) * (node + 1.0) / 2.0)
            weights.append(weight * (high - low) / 2.0)
        out += [np.concatenate(points), np.concatenate(weights)]
    return out[0], out[1], out[2], out[3]


_ACROSS, _ACROSS_WEIGHT, _ALONG, _ALONG_WEIGHT = _nodes()


def pulse_covariance(values: Values, separations: tuple[tuple[float, float], ...]) -> Array:
    """Return covariance over covariance sum of pulses at (columns, field rows) apart, shape (n, k),
    dimensionless.

    The integral of |H|^2 cos(2 pi f x) over the plane of frequencies in cycles per field pixel, H
    the transfer of all stages after the gain; at no distance it is the blur factor.
    """
    power = (_analog_power if "video.bandwidth_mhz" in values else _tube_power)(values)
    out = []
    for columns, rows in separations:
        down = np.cos(2.0 * np.pi * _ALONG * rows) * _ALONG_WEIGHT
        across = np.cos(2.0 * np.pi * _ACROSS * columns) * _ACROSS_WEIGHT
        out.append(4.0 * np.einsum("nrc,r,c->n", power, down, across))
    return np.stack(out, axis=1)


class _LastCall:
    """A function of values that keeps its last result: several observations evaluate it at the same
    draws.
    """

    def __init__(self, function: Callable[[Values], Array], paths: tuple[str, ...]) -> None:
        self._function, self._paths = function, paths
        self._known: tuple[Array, ...] = ()
        self._result: Array | None = None

    def __call__(self, values: Values) -> Array:
        """Return the function of the values, computed anew if any array is another one than
        before.
        """
        needed = tuple(values[path] for path in self._paths)
        same = len(needed) == len(self._known) and all(
            a is b for a, b in zip(needed, self._known, strict=True)
        )
        if self._result is None or not same:
            self._known, self._result = needed, self._function(values)
        return self._result


_POWER = (
    "ccd.pitch_x_um",
    "ccd.pitch_y_um",
    "taper.demagnification",
    "tube.mtf_frequency_lp_per_mm",
    "tube.mtf_exponent",
    "tube.post_gain_share",
    "taper.fibre_pitch_um",
    "taper.interface_mtf_lp_per_mm",
)


def _power_of(values: Values) -> Array:
    """Return |H|^2 of the stages after the gain at the nodes, shape (n, along, across)."""
    pitch_x_mm, pitch_y_mm, large, cut_off, exponent, tube_fraction, fibre_um, interface = (
        values[path][:, None, None] * (1e-3 if path.startswith("ccd.") else 1.0) for path in _POWER
    )
    detector = np.hypot(
        _ACROSS / pitch_x_mm, _ALONG[:, None] / (predicted.rows_per_pixel(values) * pitch_y_mm)
    )
    after = image_tube(detector / large, cut_off, exponent, tube_fraction)
    after = after * fibres(detector, fibre_um * 1e-3, interface)
    aperture = slit(_ALONG)[:, None] * slit(_ACROSS)
    video = np.ones((1, _ACROSS.size))
    if "video.bandwidth_mhz" in values:
        video = np.abs(transfer(_weights(values), _ACROSS))
    return (after * aperture * video[:, None, :]) ** 2


def _video_weights(values: Values) -> Array:
    clock_mhz, order = (
        float(values["video.pixel_clock_mhz"][0]),
        int(values["video.filter_order"][0]),
    )
    return sampled_response(values["video.bandwidth_mhz"], clock_mhz, order, predicted.VIDEO_CLOCKS)


_tube_power = _LastCall(_power_of, _POWER)
_analog_power = _LastCall(_power_of, (*_POWER, "video.bandwidth_mhz"))
_weights = _LastCall(_video_weights, ("video.bandwidth_mhz",))


def _line_noise(sensor: Camera, levels: list[StackLevel], black_dn: float) -> list[Observation]:
    """Observe the variance of an offset common to a line, from all stacks with enough noise
    together.
    """
    parts = [
        measure_line_variance(fields)
        for level in levels
        if (fields := fields_of(level, sensor, black_dn))
    ]
    if not parts:
        return []
    value, variance = (np.array(column) for column in zip(*parts, strict=True))
    weight = 1.0 / variance
    mean, sd = float(np.sum(weight * value) / weight.sum()), float(weight.sum() ** -0.5)
    return [
        scalar_observation(
            "line noise", mean, sd, lambda values: values[LINE_NOISE] ** 2, (LINE_NOISE,)
        )
    ]


def measure_line_variance(fields: Fields) -> tuple[float, float]:
    """Return the variance of an offset common to a line and the square of its standard error, DN^2
    and DN^4.

    Half the covariance between distant parts of the difference of a line to the next of its field:
    pulses are shared by neighbouring parts alone, and an offset of a whole field cancels. The error
    is from the scatter over lines and frames.
    """
    x, step = fields.deviation, fields.fields_per_frame
    count, rows, columns = x.shape
    parts = (
        x[:, :, : columns - columns % FRAMES.line_parts]
        .reshape(count, rows, FRAMES.line_parts, -1)
        .mean(axis=3, dtype=np.float64)
    )
    line = parts[:, step:] - parts[:, :-step]
    pair_products = (
        line.sum(axis=2) ** 2
        - np.sum(line**2, axis=2)
        - 2.0 * np.sum(line[:, :, 1:] * line[:, :, :-1], axis=2)
    )
    pairs = FRAMES.line_parts**2 - FRAMES.line_parts - 2 * (FRAMES.line_parts - 1)
    line_variance = pair_products / pairs / 2.0 / (1.0 - 1.0 / count)
    # Differences of overlapping lines are correlated: blocks of lines, every frame on its own.
    groups = np.array_split(line_variance, max(rows // 25, 2), axis=1)
    means = np.concatenate([group.mean(axis=1) for group in groups])
    return float(line_variance.mean()), float(means.var(ddof=1) / means.size)
