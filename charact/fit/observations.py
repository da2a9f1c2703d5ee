"""Observations of the fit: a session's measurements with covariance and predicted quantity."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from charact.fit import predicted_quantities
from charact.fit.predicted_quantities import Values
from charact.fit.prior import VisibleCamera, values_of_description
from charact.noise.illumination import gathering_s
from labdata.conditions import Conditions
from labdata.measurement import Curve, Measurement, Result
from labdata.sensor import Sensor
from labdata.session import Session, StackEntry
from labdata.solid_state import SolidStateCamera

Array = NDArray[np.float64]


SPREAD = (
    "optics.aberration_blur_um",
    "photocathode.gap_mm",
    "photocathode.halo_fraction",
    "photocathode.halo_elastic_share",
    "tube.mtf_frequency_lp_per_mm",
    "tube.mtf_exponent",
    "taper.demagnification",
    "taper.interface_mtf_lp_per_mm",
    "video.bandwidth_mhz",
)
GAIN = (
    "photocathode.luminous_sensitivity_ua_per_lm",
    "tube.luminous_gain",
    "taper.transmission",
    "ccd.quantum_efficiency",
    "video.conversion_gain_dn_per_e",
)
NOISE = (*GAIN, "microchannel_plate.detection_probability", "microchannel_plate.pulse_height_shape")
SHAPE = (*SPREAD, *NOISE, "tube.post_gain_share")
LEVEL = (
    *GAIN,
    "photocathode.ebi_lm_per_cm2",
    "microchannel_plate.strip_current_ua_per_cm2",
    "video.black_level_dn",
    "taper.demagnification",
)
# Flags that add no bias; any other flag excludes a measurement from the fit.
MILD = {"defects", "drift", "flicker", "gradient", "low-signal", "not-converged", "prior-bound", "too-few-frames"}


def is_admissible(m: Measurement) -> bool:
    """Whether a measurement is ok, or suspect only for reasons that add no bias."""
    return m.status != "refused" and m.interval68 is not None and set(m.flags) <= MILD


def admissible_measurements(result: Result, quantity: str, unit: str | None = None) -> list[Measurement]:
    """Return the measurements of a quantity with status ok, or the mildly suspect ones where there are none."""
    found = [m for m in result.find(quantity) if is_admissible(m) and unit in (None, m.unit)]
    return [m for m in found if m.status == "ok"] or found


def sd_of(m: Measurement) -> float:
    """Return half the 68 % interval: the standard deviation of a Gaussian one."""
    low, high = m.interval68 or (float("nan"), float("nan"))
    return (high - low) / (2.0 * 0.994458)


Predict = Callable[[Values], Array]


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Measured numbers with Gaussian errors and their predicted values."""

    name: str  # name of the quantity, for messages
    value: Array  # measured numbers, shape (k,)
    covariance: Array  # covariance of their errors, model error included, shape (k, k)
    predict: Predict  # predictions for parameter draws: values of shape (n,) each -> (n, k)
    speaks_of: tuple[str, ...]  # paths of the sensor parameters that it depends on

    def chi_squared(self, values: Values) -> Array:
        """Return each draw's chi squared, shape (n,)."""
        away = (self.predict(values) - self.value) @ self._whitening
        return np.sum(away**2, axis=1)

    def scale_errors(self, factor: float) -> "Observation":
        """Return the same numbers with all errors larger by a factor."""
        return replace(self, covariance=self.covariance * factor**2)

    @cached_property
    def _whitening(self) -> Array:
        """Root of the inverse covariance: residuals times it are independent and of unit variance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)).T, np.float64)


def one(
    name: str, value: float, sd: float, predict: Callable[[Values], Array], speaks_of: tuple[str, ...]
) -> Observation:
    """Return an observation of one number; its prediction has shape (n,)."""
    return Observation(
        name=name, value=np.array([value]), covariance=np.array([[sd**2]]),
        predict=lambda values: predict(values)[:, None], speaks_of=speaks_of,
    )  # fmt: skip


def at_least(name: str, value: float, sd: float, predict: Callable[[Values], Array], speaks_of: tuple[str, ...]
             ) -> Observation:  # fmt: skip
    """Return the observation of a lower bound: a prediction above it agrees."""
    return one(name, value, sd, lambda values: np.minimum(predict(values), value), speaks_of)


@dataclass(frozen=True, kw_only=True)
class StackMean:
    """Mean of one stack, its temporal variance and that of its fixed pattern."""

    label: str  # label of the stack
    mean_dn: float  # mean over frames and pixels, DN
    sd_dn: float  # its standard error, from the scatter of the frames' means, DN
    noise_dn: float  # robust noise of a pixel, DN: half the range of the central 68 %
    # illuminance_lux, gate_s, exposure_s, mcp_v: conditions; a dark has no illuminance, nan is unknown
    illuminance_lux: float
    gate_s: float
    exposure_s: float
    mcp_v: float
    entry: StackEntry | None = None  # the stack
    # mean over pixels of the variance between frames, variance over pixels of the mean frame without its noise, and the
    # standard errors of both, DN^2; nan of a single frame
    temporal_dn2: tuple[float, float] = (np.nan, np.nan)
    spatial_dn2: tuple[float, float] = (np.nan, np.nan)

    @property
    def conditions(self) -> Conditions:
        """Conditions of the stack."""
        return Conditions() if self.entry is None else self.entry.conditions

    @property
    def dark(self) -> bool:
        """Whether the stack is a dark."""
        return self.illuminance_lux == 0.0


# Fraction of pixels at an end of the scale, and level over full scale, up to which a stack is in the linear range.
MOST_CLIPPED, HIGHEST_LEVEL = 1e-3, 0.85


def levels_of(session: Session) -> tuple[StackMean, ...]:
    """Return the means of the session's darks and flats of known light within the linear range."""
    found = (_level(session, entry) for entry in session.of_kind("dark", "flat"))
    return tuple(level for level in found if level is not None)


def _level(session: Session, entry: StackEntry) -> StackMean | None:
    conditions, camera = entry.conditions, session.camera
    illuminance = 0.0 if entry.kind == "dark" else conditions.illuminance_lux
    if isinstance(camera, SolidStateCamera):
        if illuminance is None and conditions.photons_per_px and conditions.wavelength_nm:
            illuminance = np.nan
        reference_v, field_s = 0.0, 1.0 / float(camera.video.field_rate_hz)
        shutter_s = gathering_s(conditions) or field_s
    elif isinstance(camera, Sensor):
        reference_v, field_s = float(camera.microchannel_plate.reference_v), 1.0 / float(camera.video.field_rate_hz)
        shutter_s = conditions.exposure_s or field_s
    else:
        return None
    if illuminance is None:
        return None
    stack = entry.read()
    top = stack.full_scale_dn or float(2**camera.video.bit_depth - 1)
    means = stack.data.mean(axis=(1, 2), dtype=np.float64)
    clipped = max(np.mean(stack.data >= top), np.mean(stack.data <= 0))
    if clipped > MOST_CLIPPED or means.mean() > HIGHEST_LEVEL * top:
        return None
    scatter = float(means.std(ddof=1)) / np.sqrt(len(means)) if len(means) > 1 else float(stack.data.std()) / 10.0
    gate_s = shutter_s if conditions.gate_ns is None else min(conditions.gate_ns * 1e-9, shutter_s)
    temporal, spatial = _variances(stack.data)
    return StackMean(
        label=entry.label, mean_dn=float(means.mean()), sd_dn=scatter, noise_dn=_noise_dn(stack.data[0]),
        illuminance_lux=float(illuminance), gate_s=float(gate_s), exposure_s=float(shutter_s),
        mcp_v=float(conditions.mcp_v or reference_v), entry=entry, temporal_dn2=temporal, spatial_dn2=spatial,
    )  # fmt: skip


def _variances(data: NDArray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return temporal variance and variance of the fixed pattern with their standard errors, frame offsets removed.

    Standard errors are from the scatter over pixels, taken as independent: for white noise.
    """
    count, pixels = len(data), data[0].size
    if count < 2:
        return (np.nan, np.nan), (np.nan, np.nan)
    total, square = np.zeros(data.shape[1:]), np.zeros(data.shape[1:])
    for frame in data:
        away = frame - frame.mean(dtype=np.float64)
        total += away
        square += away**2
    each = (square - total**2 / count) / (count - 1)
    own = (total / count) ** 2 - each / count
    root = np.sqrt(pixels)
    return (
        (float(each.mean()), float(each.std() / root)),
        (float(own.mean()), float(own.std() / root)),
    )


def _noise_dn(frame: NDArray) -> float:
    """Return half the width of the central 68 % of the grey values, sub-DN where one value dominates."""
    codes, counts = np.unique(frame, return_counts=True)
    share = float(counts.max()) / frame.size
    if share < 0.38 or len(codes) < 2:
        low, high = np.quantile(frame, (0.16, 0.84))
        return float(high - low) / 2.0
    from scipy.special import erfinv

    return float(0.5 / (np.sqrt(2.0) * erfinv(min(share, 1.0 - 1e-9))))


# Model error of the MTF, and spacing of its points; closer points are correlated.
MTF_MODEL_SD = 0.004
MTF_SPACING_CY_PER_PX = 0.04


def mtf_observations(
    session: Session, sensor: VisibleCamera, result: Result, depends: tuple[str, ...] = SPREAD
) -> list[Observation]:
    """Return the observations of MTF curves and bar targets, each along its own direction.

    `depends`: paths of the parameters that the MTF depends on.
    """
    stacks = {m.stack for m in admissible_measurements(result, "mtf50")}
    found = [
        _curve(name, line, session, sensor, result, depends)
        for name, line in result.curves.items()
        if name.split(":")[0] in ("mtf", "mtf_vertical")
        and line.interval68 is not None
        and _stack_of(name, line) in stacks
    ]
    bars = {entry.label: entry for entry in session.of_kind("bars")}
    for m in admissible_measurements(result, "mtf"):
        if m.stack in bars and m.frequency_cy_per_px:
            angle_deg = m.orientation_deg if m.orientation_deg is not None else bars[m.stack].target.angle_deg
            fx, fy = _components(np.array([m.frequency_cy_per_px]), angle_deg or 0.0, sensor)
            sd = float(np.hypot(sd_of(m), MTF_MODEL_SD))
            predict = partial(predicted_quantities.mtf, across=fx, along=fy)
            found.append(one(f"mtf of {m.stack}", m.value or 0.0, sd, lambda v, f=predict: f(v)[:, 0], depends))
    return found


def _stack_of(name: str, line: Curve) -> str | None:
    """Return the stack of a curve."""
    return line.stack or (name.split(":", 1)[1] if ":" in name else None)


def _curve(name: str, line: Curve, session: Session, sensor: VisibleCamera, result: Result, depends: tuple[str, ...]
           ) -> Observation:  # fmt: skip
    """Observe an MTF curve at frequencies far enough apart."""
    wanted = np.arange(MTF_SPACING_CY_PER_PX, 0.45 + 1e-9, MTF_SPACING_CY_PER_PX)
    frequency = np.asarray(line.frequency_cy_per_px, float)
    low, high = np.asarray(line.interval68, float)
    value = np.interp(wanted, frequency, line.value)
    sd = np.interp(wanted, frequency, (high - low) / (2.0 * 0.994458))
    used = (wanted >= frequency[0]) & (wanted <= frequency[-1]) & (value > 0.03)
    angle_deg = _angle_deg(name, line, session, result)
    fx, fy = _components(wanted[used], angle_deg, sensor)
    # Errors are correlated over 0.08 cy/px: closely spaced points add little information.
    apart, sd = np.abs(np.subtract.outer(wanted[used], wanted[used])), sd[used]
    covariance = np.outer(sd, sd) * np.exp(-apart / 0.08) + MTF_MODEL_SD**2 * np.eye(sd.size)
    return Observation(name=name, value=value[used], covariance=covariance, speaks_of=depends,
                       predict=partial(predicted_quantities.mtf, across=fx, along=fy))  # fmt: skip


def _angle_deg(name: str, line: Curve, session: Session, result: Result) -> float:
    """Return the direction of a curve's frequencies, degrees from the row direction."""
    if name.startswith("mtf_vertical"):
        return 90.0
    stack = _stack_of(name, line)
    entry = next((entry for entry in session.stacks if entry.label == stack), None)
    if entry is not None and entry.kind == "point":
        return 0.0
    if entry is not None and entry.target.angle_deg is not None:
        return entry.target.angle_deg
    angles = [m.orientation_deg for m in result.find("mtf50") if m.orientation_deg is not None and m.stack == stack]
    return angles[0] if angles else 0.0


def _components(frequency: Array, angle_deg: float, sensor: VisibleCamera) -> tuple[Array, Array]:
    """Split frequencies in cy per column pitch: along rows in the same, along columns in cy per row pitch."""
    pitch_ratio = float(sensor.ccd.pitch_y_um) / float(sensor.ccd.pitch_x_um)
    angle = np.deg2rad(angle_deg)
    return frequency * abs(np.cos(angle)), frequency * abs(np.sin(angle)) * pitch_ratio


# Relative model error of noise quantities: sampling of the sensor rows, image lag.
NOISE_MODEL_SD = 0.01
# Minimum noise at which quantisation is additive, DN.
LEAST_NOISE_DN = 0.5


@dataclass(frozen=True, kw_only=True)
class _Noise:
    """One noise quantity, predicted from values, photoelectron gain and (blur factor, correlation)."""

    mcp_v: float
    value: float
    sd: float
    predict: Callable[[Values, Array, tuple[Array, Array]], Array]
    speaks_of: tuple[str, ...] = NOISE


def noise_observations(
    session: Session, sensor: Sensor, result: Result, levels: tuple[StackMean, ...]
) -> list[Observation]:
    """Observe covariance gain, blur factor and dark variance, grouped by MCP voltage."""
    reference_v = float(sensor.microchannel_plate.reference_v)
    known = [float(entry.conditions.mcp_v) for entry in session.of_kind("flat") if entry.conditions.mcp_v]
    # Of several voltages, the one with most flats is the session's.
    volts = max(dict.fromkeys(known), key=known.count) if known else reference_v
    own_volts = {entry.label: entry.conditions.mcp_v for entry in session.stacks}
    found = []
    for quantity, unit, predict, depends in (
        ("covariance_gain", "DN", lambda values, gain, _: predicted_quantities.covariance_gain(values, gain), NOISE),
        ("blur_factor", None, lambda _, __, shape: shape[0], SHAPE),
    ):
        for m in admissible_measurements(result, quantity, unit):
            value = m.value or 0.0
            sd = float(np.hypot(sd_of(m), NOISE_MODEL_SD * value))
            at = float(own_volts.get(m.stack or "") or volts)
            found.append(_Noise(mcp_v=at, value=value, sd=sd, predict=predict, speaks_of=depends))
    found += _neighbours(result, volts)
    darks = [level for level in levels if level.dark]
    # The read noise must be large against the quantisation step, so that rounding is additive.
    least_e = sensor.ccd.read_noise_e.low or float(sensor.ccd.read_noise_e)
    if darks and least_e * float(sensor.video.conversion_gain_dn_per_e) > LEAST_NOISE_DN:
        own = {level.label: level for level in darks}
        reads = admissible_measurements(result, "read_noise", "DN")
        found += [_dark(m, own.get(m.stack or "", darks[0]), sensor, reference_v) for m in reads]
    return [
        _together([one for one in found if one.mcp_v == mcp_v], mcp_v, reference_v)
        for mcp_v in dict.fromkeys(one.mcp_v for one in found)
    ]


def _neighbours(result: Result, volts: float) -> list[_Noise]:
    """Observe the horizontal neighbour correlation of the brightest flat that is neither clipped nor saturated."""
    measured = result.evidence.get("autocorrelation", {})
    transfer = result.evidence.get("photon-transfer", {})
    columns = [transfer.get(name, ()) for name in ("label", "signal_dn", "fitted")]
    signal = {label: mean for label, mean, fitted in zip(*columns, strict=True) if fitted}
    columns = [measured.get(name, ()) for name in ("label", "neighbour_correlation", "neighbour_sd")]
    usable = [(signal[label], value, sd) for label, value, sd in zip(*columns, strict=True) if label in signal]
    return [
        _Noise(mcp_v=volts, value=value, sd=float(np.hypot(sd, 0.004)), predict=lambda _, __, shape: shape[1],
               speaks_of=SHAPE)
        for _, value, sd in sorted(usable)[-1:]
    ]  # fmt: skip


def _together(parts: list[_Noise], mcp_v: float, reference_v: float) -> Observation:
    """Combine quantities of one MCP voltage, so that the blur is computed once."""

    def predict(values: Values) -> Array:
        gain = predicted_quantities.photoelectron_gain(values, mcp_v, reference_v)
        shape = predicted_quantities.noise_shape(values, gain)
        return np.stack(np.broadcast_arrays(*(part.predict(values, gain, shape) for part in parts)), axis=1)

    return Observation(
        name="noise", value=np.array([part.value for part in parts]),
        covariance=np.diag([part.sd**2 for part in parts]), predict=predict,
        speaks_of=tuple(dict.fromkeys(path for part in parts for path in part.speaks_of)),
    )  # fmt: skip


def _dark(m: Measurement, dark: StackMean, sensor: Sensor, reference_v: float) -> _Noise:
    """Observe the temporal noise of darks: read noise and EBI; ion feedback enters by its prior range."""
    ions = sensor.microchannel_plate.ion_event_rate_per_s_cm2
    sheet = values_of_description(sensor)
    gain = predicted_quantities.photoelectron_gain(sheet, dark.mcp_v, reference_v)
    usual = float(
        predicted_quantities.ion_variance(sheet, gain, predicted_quantities.blur_factor(sheet, gain), dark.gate_s)[0]
    )
    low, high = (float(ions) if end is None else end for end in (ions.low, ions.high))
    spread = usual * (high - low) / (4.0 * float(ions)) if float(ions) > 0 else 0.0
    variance = (m.value or 0.0) ** 2

    def predict(values: Values, gain: Array, shape: tuple[Array, Array]) -> Array:
        own = predicted_quantities.dark_variance(values, gain, shape[0], dark.gate_s)
        return own + predicted_quantities.ion_variance(values, gain, shape[0], dark.gate_s)

    return _Noise(
        mcp_v=dark.mcp_v, value=variance,
        sd=float(np.hypot.reduce([2.0 * (m.value or 0.0) * sd_of(m), NOISE_MODEL_SD * variance, spread])),
        predict=predict, speaks_of=("ccd.read_noise_e", "photocathode.ebi_lm_per_cm2", *NOISE),
    )  # fmt: skip


def observations(
    session: Session, sensor: Sensor, result: Result, levels: tuple[StackMean, ...]
) -> tuple[Observation, ...]:
    """Return the observations in the order MTF, noise, halo, stack means.

    A mildly suspect measurement is used only if there is none with status ok; refused and otherwise flagged ones are
    excluded.
    """
    reference_v = float(sensor.microchannel_plate.reference_v)
    found = mtf_observations(session, sensor, result) + noise_observations(session, sensor, result, levels)
    for m in admissible_measurements(result, "halo_diameter"):
        # The halo edge is located on pixels.
        sd, depends = float(np.hypot(sd_of(m), 0.1)), ("photocathode.gap_mm", "taper.demagnification")
        found.append(one("halo diameter", m.value or 0.0, sd, predicted_quantities.halo_diameter_px, depends))
    path = "photocathode.halo_fraction"
    for m in admissible_measurements(result, "halo_fraction"):
        found.append(one("halo fraction", m.value or 0.0, sd_of(m), lambda values: values[path], (path,)))
    found += _fixed_patterns(sensor, result)
    found += [_levels(levels, reference_v)] if levels else []
    return tuple(found)


# Relative model error of the variance of a tube's fixed pattern: blur of the screen's grain.
PATTERN_MODEL_SD = 0.1
# Variance of a hexagonal pattern of lines over its squared contrast: 2 w/P sqrt(pi)/2 of Gaussian lines of width w, a
# fibre or two of 6 um, at the pitch P of 0.5 mm.
LINE_AREA = 0.03


def _fixed_patterns(sensor: Sensor, result: Result) -> list[Observation]:
    """Observe the relative variance of the fixed pattern; the lines of the multi-fibres are a systematic error."""
    plates = (sensor.taper.pattern_contrast, sensor.microchannel_plate.pattern_contrast)
    lines = sum(LINE_AREA * (plate.high or float(plate)) ** 2 / 2.0 for plate in plates)
    found = []
    for m in admissible_measurements(result, "prnu", "%"):
        value = 1e-4 * (m.value or 0.0) ** 2
        sd = float(np.hypot.reduce([2e-4 * (m.value or 0.0) * sd_of(m), PATTERN_MODEL_SD * value, lines]))
        depends = ("ccd.prnu", "phosphor.gain_nonuniformity")
        found.append(one("fixed pattern", value, sd, predicted_quantities.spatial_variance, depends))
    return found


def _levels(levels: tuple[StackMean, ...], reference_v: float) -> Observation:
    """Observe stack means: black level plus gain times photoelectrons; the clamp removes dark charge."""
    lux, gate_s, mcp_v = (
        np.array([getattr(level, name) for level in levels]) for name in ("illuminance_lux", "gate_s", "mcp_v")
    )
    mean = np.array([level.mean_dn for level in levels])
    own = np.array([level.sd_dn for level in levels])

    def predict(values: Values) -> Array:
        one = {path: value[:, None] for path, value in values.items()}
        events = (
            predicted_quantities.photoelectrons(one, lux, gate_s) + predicted_quantities.background_rate(one) * gate_s
        )
        gain = predicted_quantities.photoelectron_gain(one, mcp_v, reference_v)
        load = predicted_quantities.mcp_load(one, lux, gate_s, mcp_v, reference_v)
        return one["video.black_level_dn"] + gain * events / (1.0 + load)

    # With little noise the mean is attracted to whole numbers.
    leaning = np.array([0.1 if level.noise_dn < LEAST_NOISE_DN else 0.0 for level in levels])
    variance = own**2 + 0.03**2 + (0.003 * mean) ** 2 + leaning**2
    extra = ("microchannel_plate.gain_exponent",) if len(set(mcp_v.tolist())) > 1 else ()
    return Observation(
        name="levels", value=mean, covariance=np.diag(variance), predict=predict, speaks_of=(*LEVEL, *extra)
    )
