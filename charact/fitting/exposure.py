"""Exposure that reaches a signal-to-noise ratio: signal and noise of a flat, and the search.

    SNR = C s / sqrt((v + 2 sum_j (1 - j / N) c_j) / N)

s: signal of the light above the dark level, DN; C: contrast of what is to be seen in it; v:
temporal variance of a pixel; c_j: its covariance with the j-th later frame, by image lag; N:
frames. Fixed patterns are no noise here. Without lag and of contrast 1 it is the SNR of EMVA 1288
Release 4.0, 2.3.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from charact.fitting import predicted_quantities as predicted
from charact.fitting.model import TIED
from charact.fitting.prior import values_of_description
from charact.fitting.silicon_observations import electrons_per_lumen, signal_of_light
from charact.fitting.thresholds import EXPOSURE
from charact.fitting.tube_light import field_products
from charact.observables import Values
from charact.observables.silicon import (
    COMPRESSION,
    CONVERSION_GAIN,
    dark_variance,
    dn_per_electron,
    em_gain,
    neighbour_variance,
    register_excess,
)
from labdata import Array, BadInput, Camera, Conditions
from labdata.limits import LimitsInForce, limits_in_force


@dataclass(frozen=True, kw_only=True)
class ExposedFlat:
    """Signal and noise of evenly lit pixels, one number a draw, shape (n,)."""

    light_dn: Array  # signal of the light, DN
    level_dn: Array  # level above black, DN
    well_e: Array  # charge in the well, e-
    variance_dn2: Array  # temporal variance of a pixel in a frame
    #: Covariance with each later frame, by image lag, shape (n, lag)
    lag_dn2: Array

    def variance_of_mean_dn2(self, frames: Array | float) -> Array:
        """Return the variance of the mean of successive frames."""
        count = np.broadcast_to(np.asarray(frames, float), self.variance_dn2.shape)[:, None]
        later = np.arange(1, self.lag_dn2.shape[1] + 1)
        lag = 2.0 * np.sum(np.maximum(1.0 - later / count, 0.0) * self.lag_dn2, axis=1)
        return (self.variance_dn2 + lag) / count[:, 0]

    def snr(self, frames: Array | float, contrast: float) -> Array:
        """Return the SNR of the mean of frames."""
        return contrast * self.light_dn / np.sqrt(self.variance_of_mean_dn2(frames))

    def frames(self, snr: float, contrast: float) -> Array:
        """Return the number of frames that reach an SNR."""
        needed = np.square(snr / (contrast * self.light_dn))
        # From above, as the covariance with later frames counts less the fewer there are.
        frames = needed * (self.variance_dn2 + 2.0 * self.lag_dn2.sum(axis=1))
        for _ in range(EXPOSURE.rounds):
            frames = np.maximum(frames, 1.0)
            frames = np.ceil(needed * frames * self.variance_of_mean_dn2(frames) - 1e-9)
        return np.maximum(frames, 1.0)


def exposed_flat(camera: Camera, values: Values, at: Conditions) -> ExposedFlat:
    """Return signal and noise of a flat.

    Parameters
    ----------
    camera
        The description, which says what kind of camera it is.
    values
        Its parameters, one value or n draws each.
    at
        Illuminance on photocathode or chip, gate and MCP voltage; without a tube the exposure and
        the gain of a register.
    """
    if not camera.has_tube:
        return _flat_of_chip(camera, values, at)
    lux, gate_s, mcp_v = at.illuminance_lux or 0.0, 1e-9 * (at.gate_ns or 0.0), at.mcp_v or 0.0
    load = predicted.mcp_load(values, lux, gate_s, mcp_v)
    gain = predicted.photoelectron_gain(values, mcp_v) / (1.0 + load)
    light = gain * predicted.photoelectrons(values, lux, gate_s)
    background = predicted.background_rate(values) + predicted.ion_light(values)
    signal = light + gain * background * gate_s
    blur = predicted.pulse_covariance(values, ((0, 0),), predicted.FINE)[:, 0]
    lags = field_products(values, gate_s, EXPOSURE.lag_frames * camera.fields)[:, :: camera.fields]
    pulses = gain * predicted.excess_noise_factor(values) * blur * signal
    ions = predicted.ion_variance(values, gain, blur, gate_s)
    return ExposedFlat(
        light_dn=light,
        level_dn=signal,
        well_e=signal / values[CONVERSION_GAIN],
        variance_dn2=predicted.detector_variance(values, signal) + ions + pulses * lags[:, 0],
        lag_dn2=pulses[:, None] * lags[:, 1:],
    )


def _flat_of_chip(camera: Camera, values: Values, at: Conditions) -> ExposedFlat:
    exposure_s, full_dn = at.exposure_s or 0.0, float(2**camera.video.bit_depth - 1)
    gain = dn_per_electron(values, at) * em_gain(values, at)
    lux_s = (at.illuminance_lux or 0.0) * exposure_s
    light = np.array([electrons_per_lumen(camera.silicon) * lux_s])
    per_level = (light, np.array([True]), gain[:, None], np.array([exposure_s]), full_dn)
    signal = signal_of_light(values, *per_level)[:, 0]
    # Of y = s (1 - c s / full) the squared slope is 1 - 4 c y / full.
    bend = np.maximum(1.0 - 4.0 * values[COMPRESSION] * signal / full_dn, 0.0)
    shot = gain * register_excess(values, at) * 2.0 * signal / (1.0 + np.sqrt(bend)) * bend
    variance = shot + dark_variance(values, at, exposure_s)
    variance = variance + neighbour_variance(values, camera.shape[0])
    return ExposedFlat(
        light_dn=signal,
        level_dn=signal,
        well_e=signal / gain,
        variance_dn2=variance,
        lag_dn2=np.zeros((len(variance), 1)),
    )


@dataclass(frozen=True, kw_only=True)
class ExposureRequest:
    """What an exposure is to reach, and with what."""

    camera: Camera
    lux: float  # illuminance of 2856 K light on photocathode or chip
    snr: float
    contrast: float
    longest_s: float  # longest gate or exposure, at most a field
    max_frames: int

    @cached_property
    def best(self) -> Values:
        """Best values of the camera's parameters, shape (1,)."""
        return values_of_description(self.camera)

    @property
    def draws(self) -> Values:
        """Posterior draws of the camera's parameters, shape (n,) each; the best without any."""
        draws = self.camera.draws
        drawn = dict(zip(draws.names, np.array(draws.values).T, strict=True))
        ratios = {path: self.best[path] / self.best[by] for path, by in TIED.items() if by in drawn}
        tied = {path: drawn[TIED[path]] * ratio for path, ratio in ratios.items()}
        return {**self.best, **drawn, **tied}

    @cached_property
    def limits(self) -> LimitsInForce | None:
        """Limits of the tube."""
        return limits_in_force(sensor=self.camera) if self.camera.has_tube else None

    @property
    def gains(self) -> tuple[float | None, ...]:
        """MCP voltages, V, or gains of a register, that are tried; rising."""
        if self.limits is None and not self.camera.multiplies:
            return (None,)
        ends = (
            (1.0, float(self.camera.register.em_gain))
            if self.limits is None
            else (EXPOSURE.lowest_voltage * self.limits.mcp_v, self.limits.mcp_v)
        )
        return tuple(np.geomspace(*ends, EXPOSURE.gains).tolist())

    def conditions(self, gain: float | None, seconds: float) -> Conditions:
        """Return the settings of a gain and a gate or an exposure."""
        if self.camera.has_tube:
            return Conditions(mcp_v=gain, gate_ns=1e9 * seconds, illuminance_lux=self.lux)
        return Conditions(em_gain=gain, exposure_s=seconds, illuminance_lux=self.lux)

    def flat(self, at: Conditions) -> ExposedFlat:
        """Return signal and noise at settings, best values."""
        return exposed_flat(self.camera, self.best, at)

    def frames(self, at: Conditions) -> float:
        """Return the number of frames at settings."""
        return float(self.flat(at).frames(self.snr, self.contrast)[0])

    def loads(self, at: Conditions) -> dict[str, tuple[float, float]]:
        """Return what the settings load, by name with its unit, and the most it takes."""
        flat, video = self.flat(at), self.camera.video
        noise = EXPOSURE.headroom_sd * float(np.sqrt(flat.variance_dn2[0]))
        level = float(flat.level_dn[0])
        well_e = float(flat.well_e[0]) * (1.0 + noise / level)
        black_dn, full_dn = float(video.black_level_dn), 2.0**video.bit_depth - 1.0
        loads = {
            "level and noise, DN": (black_dn + level + noise, full_dn),
            "charge of a pixel, e-": (well_e, float(self.camera.ccd.full_well_e)),
        }
        if self.limits is not None:
            duty = 1e-9 * (at.gate_ns or 0.0) * float(video.field_rate_hz)
            anode = self.limits.load.anode_na_per_cm2(self.lux, at.mcp_v or 0.0, duty)
            loads["photocathode, lux"] = self.lux, self.limits.illuminance_lux
            loads["microchannel plate, nA/cm2"] = anode, self.limits.anode_na_per_cm2
        return loads

    def is_allowed(self, at: Conditions) -> bool:
        """Whether nothing is loaded beyond what it takes."""
        return all(load <= most for load, most in self.loads(at).values())


def choose_exposure(request: ExposureRequest) -> tuple[Conditions, int]:
    """Return settings and number of frames: the lowest gain with at most a tenth more frames than
    the best, and of that the shortest time that needs no more.

    Raises
    ------
    BadInput
        If no settings are allowed, or the best needs too many frames.
    """
    shortest_s = request.longest_s * EXPOSURE.shortest
    timed = [partial(request.conditions, gain) for gain in request.gains]
    longest = {
        at: _bisect(lambda s, at=at: request.is_allowed(at(s)), request.longest_s, shortest_s)
        for at in timed
        if request.is_allowed(at(shortest_s))
    }
    if not longest:
        loads = request.loads(timed[0](shortest_s)).items()
        name, (load, most) = max(loads, key=lambda item: item[1][0] / item[1][1])
        raise BadInput(
            f"{name} must be at most {most:.3g}, got {load:.3g} with the least exposure: dim the "
            "light, or close the lens by `f_number`"
        )
    frames = {at: request.frames(at(seconds)) for at, seconds in longest.items()}
    fewest = min(frames.values())
    if not fewest <= request.max_frames:
        raise BadInput(
            f"`snr` {request.snr:g} must be reached within `max_frames` {request.max_frames}, got "
            f"{fewest:.0f} as the fewest; more light, a faster lens or a sum over pixels helps"
        )
    # Rounding is noise only where other noise is larger.
    least_dn2, most = EXPOSURE.least_noise_dn**2, np.ceil(EXPOSURE.more_frames * fewest)
    chosen = next(
        at
        for at, seconds in longest.items()
        if frames[at] == fewest
        or (frames[at] <= most and request.flat(at(seconds)).variance_dn2[0] > least_dn2)
    )
    needed = frames[chosen]
    seconds = _bisect(lambda s: request.frames(chosen(s)) <= needed, shortest_s, longest[chosen])
    return chosen(seconds), round(needed)


def _bisect(holds: Callable[[float], bool], sought: float, known: float) -> float:
    """Return the time nearest to `sought` for which a condition holds, as it does at `known`."""
    if holds(sought):
        return sought
    for _ in range(EXPOSURE.halvings):
        middle = float(np.sqrt(sought * known))
        sought, known = (sought, middle) if holds(middle) else (middle, known)
    return known
