"""Theory of an intensified camera's pulses: the simulator's draws are held against it.

Nothing here knows the simulator. Photoelectrons fall as a Poisson process at continuous places and
times; each is detected or lost, gets a pulse of its own height, spreads its light over the pixels
by the continuous point spread, releases it through a decay of two exponentials, and the charge is
counted and read. By Campbell's theorem the cumulants of that process are lambda E[g^n] int h^n, and
its characteristic function gives quantiles. Physics reference, sections 1.4 to 1.12 and 10;
Kingman, Poisson Processes, 3.2.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from functools import lru_cache
from math import gamma
from typing import Any

import numpy as np
from numpy.typing import NDArray

ELECTRON_C = 1.602176634e-19
LAGS = 4
# Places within a pixel, along each axis: at eight cycles per pixel no camera has transfer left, so
# that the sum over them is the integral.
PHASES = 8
FAR_PX = 48

Transfer = Callable[[NDArray[np.floating]], NDArray[np.floating]]


@dataclass(frozen=True)
class Johnson:
    """Post-gain share of the tube's transfer times fibres and interface; frequencies at the
    photocathode, lp/mm.
    """

    share: float
    frequency_lp_per_mm: float
    exponent: float
    fibre_pitch_um: float
    interface_lp_per_mm: float
    demagnification: float

    def __call__(self, frequency: NDArray[np.floating]) -> NDArray[np.floating]:
        from scipy.special import jv

        at_detector = self.demagnification * frequency
        u = np.maximum(np.pi * self.fibre_pitch_um * 1e-3 * at_detector, 1e-9)
        tube = np.exp(-self.share * (frequency / self.frequency_lp_per_mm) ** self.exponent)
        return (
            tube
            * np.abs(2.0 * jv(1, u) / u)
            * np.exp(-((at_detector / self.interface_lp_per_mm) ** 2))
        )


@dataclass(frozen=True, kw_only=True)
class EventCamera:
    """The numbers of an intensified camera behind its photocathode.

    Parameters
    ----------
    pitch_x_mm, pitch_y_mm
        Sides of a chip pixel at the photocathode, mm.
    spread
        Transfer of all blur after the gain but the pixel's, of the frequency at the photocathode,
        lp/mm.
    detection_probability, pulse_height_shape
        Share of photoelectrons that start a pulse; shape of the gamma law of pulse heights.
    charge_e
        CCD electrons per photoelectron, the undetected counted.
    fast_fraction, fast_decay_s, slow_decay_s
        Share of the fast component in the light at the start of the decay; time constants, s (0:
        none).
    field_s, gate_s
        Time from field to field and open time at its start, s.
    interlaced
        Fields alternate and every pixel sums two rows of the chip; else each exposure is a frame of
        single rows.
    video_taps
        Impulse response along the line, per pixel; one tap of 1 for none.
    read_noise_e, dark_e
        Standard deviation of reading, and mean dark charge whose noise stays after the clamp, e-
        per pixel as read.
    """

    pitch_x_mm: float
    pitch_y_mm: float
    spread: Transfer
    detection_probability: float
    pulse_height_shape: float
    charge_e: float
    fast_fraction: float
    fast_decay_s: float
    slow_decay_s: float
    field_s: float
    gate_s: float
    interlaced: bool
    video_taps: tuple[float, ...]
    read_noise_e: float
    dark_e: float

    @property
    def rows_summed(self) -> int:
        """Rows of the chip in a pixel as read."""
        return 2 if self.interlaced else 1

    @property
    def taps(self) -> NDArray[np.floating]:
        """Video impulse response, shape (tap,)."""
        return np.array(self.video_taps)

    def height_moment(self, power: int) -> float:
        """E[g^n] of a photoelectron's pulse in CCD electrons, the undetected counted as zero."""
        k, p = self.pulse_height_shape, self.detection_probability
        return p * (self.charge_e / p / k) ** power * gamma(k + power) / gamma(k)


def of_sensor(sensor: Any) -> EventCamera:
    """Return the numbers of a camera with a tube, by the formulas of sections 1.6 to 1.10."""
    tube, taper, ccd, video, phosphor = (
        sensor.tube,
        sensor.taper,
        sensor.ccd,
        sensor.video,
        sensor.phosphor,
    )
    demagnification = float(taper.demagnification)
    lumen_s = (
        float(phosphor.luminous_efficacy_lm_per_w) * float(phosphor.photon_energy_ev) * ELECTRON_C
    )
    per_lumen_s = float(sensor.photocathode.luminous_sensitivity_ua_per_lm) * 1e-6 / ELECTRON_C
    photons = float(tube.luminous_gain) / lumen_s / per_lumen_s
    field_s = 1.0 / float(video.field_rate_hz)
    rows = 2 if video.interlaced else 1
    johnson = Johnson(
        float(tube.post_gain_share),
        float(tube.mtf_frequency_lp_per_mm),
        float(tube.mtf_exponent),
        float(taper.fibre_pitch_um),
        float(taper.interface_mtf_lp_per_mm),
        demagnification,
    )
    return EventCamera(
        pitch_x_mm=float(ccd.pitch_x_um) * demagnification * 1e-3,
        pitch_y_mm=float(ccd.pitch_y_um) * demagnification * 1e-3,
        spread=johnson,
        detection_probability=float(sensor.microchannel_plate.detection_probability),
        pulse_height_shape=float(sensor.microchannel_plate.pulse_height_shape),
        charge_e=photons * float(taper.transmission) * float(ccd.quantum_efficiency),
        fast_fraction=float(phosphor.fast_fraction),
        fast_decay_s=float(phosphor.fast_decay_ms) * 1e-3,
        slow_decay_s=float(phosphor.slow_decay_ms) * 1e-3,
        field_s=field_s,
        gate_s=field_s,
        interlaced=video.interlaced,
        video_taps=butterworth(
            float(video.bandwidth_mhz) / float(video.pixel_clock_mhz), video.filter_order
        ),
        read_noise_e=float(ccd.read_noise_e),
        dark_e=float(ccd.dark_current_e_per_s) * field_s * rows,
    )


def butterworth(bandwidth_cy_per_px: float, order: int, length: int = 32) -> tuple[float, ...]:
    """Return what a Butterworth low pass makes of one held pixel, sampled at the ends of the
    following pixels.
    """
    from scipy import signal

    system: Any = signal.butter(order, 2.0 * np.pi * bandwidth_cy_per_px, analog=True)
    fine = np.linspace(0.0, length, 200 * length + 1)
    response: Any = signal.lsim(system, np.ones_like(fine), fine)[1]
    taps = np.diff(response[::200])
    return tuple((taps / taps.sum()).tolist())


@lru_cache(maxsize=8)
def point_spread(
    spread: Transfer, reach_mm: float
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return distances (r,), mm, and the point spread there, per mm2: the Hankel transform of the
    transfer.

    Notes
    -----
    h(r) = 2 pi int H(f) J0(2 pi f r) f df.
    """
    from scipy.special import j0

    top = 20.0
    while spread(np.array([top]))[0] > 1e-9:
        top *= 1.2
    # Panels short enough for the fastest ripple, at the last radius; radii dense enough for the
    # core.
    panels = int(max(1000, 4.0 * top * reach_mm))
    node, node_weight = np.polynomial.legendre.leggauss(4)
    edge = np.linspace(0.0, top, panels + 1)
    frequency = (edge[:-1, None] + (node + 1.0) / 2.0 * edge[1]).ravel()
    radius = (
        np.concatenate([np.arange(0.0, 16.0, 0.04), np.geomspace(16.0, 16.0 + reach_mm * top, 300)])
        / top
    )
    weight = (
        2.0 * np.pi * spread(frequency) * frequency * np.tile(node_weight, panels) * edge[1] / 2.0
    )
    profile = np.array([np.sum(weight * j0(2.0 * np.pi * frequency * r)) for r in radius])
    return radius, profile


@lru_cache(maxsize=8)
def pixel_response(
    camera: EventCamera, rows: int, columns: int, phases: int
) -> NDArray[np.floating]:
    """Return the share of an event's light that one chip pixel gets, by the event's place.

    Returns
    -------
    NDArray
        Shape (rows * phases, columns * phases): places from half of `rows`, `columns` pixels before
        the pixel's centre to as far after it, in steps of one phase.
    """
    from scipy.interpolate import CubicSpline

    y = (np.arange(rows * phases) + 0.5) / phases - rows / 2.0
    x = (np.arange(columns * phases) + 0.5) / phases - columns / 2.0
    reach = np.hypot((rows / 2 + 1) * camera.pitch_y_mm, (columns / 2 + 1) * camera.pitch_x_mm)
    spline = CubicSpline(*point_spread(camera.spread, float(reach)))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    total = np.zeros((len(y), len(x)))
    # The point spread is even: one quadrant of places is enough.
    below, right = y[: len(y) // 2], x[: len(x) // 2]
    quadrant = np.zeros((len(below), len(right)))
    for dy, wy in zip(nodes / 2.0, weights / 2.0, strict=True):
        for dx, wx in zip(nodes / 2.0, weights / 2.0, strict=True):
            distance = np.hypot(
                (below + dy)[:, None] * camera.pitch_y_mm, (right + dx)[None, :] * camera.pitch_x_mm
            )
            quadrant += wy * wx * spline(distance)
    total[: len(below), : len(right)] = quadrant
    total[: len(below), len(right) :] = quadrant[:, ::-1]
    total[len(below) :] = total[: len(below)][::-1]
    return total * camera.pitch_x_mm * camera.pitch_y_mm


def components(camera: EventCamera) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the decay's time constants, s, and shares of the light, both of shape (2,)."""
    tau = np.maximum(np.array([camera.fast_decay_s, camera.slow_decay_s]), 1e-12)
    light = np.array([camera.fast_fraction, 1.0 - camera.fast_fraction]) * tau
    return tau, light / light.sum()


# What is compared: the same statistics of either kind of frames and of the theory.


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Moments of a pixel above its dark level, or their standard errors.

    Parameters
    ----------
    mean, variance, skewness
        Of one pixel of a frame; its units, their square, dimensionless.
    quantile
        The value that one pixel in a thousand exceeds.
    horizontal, vertical
        Covariances with pixels 1 .. 4 farther along the row and along the column of a frame, shape
        (4,).
    """

    mean: float
    variance: float
    skewness: float
    quantile: float
    horizontal: NDArray[np.floating]
    vertical: NDArray[np.floating]


def measured(blocks: Iterable[NDArray[np.floating]], reference: float) -> tuple[Moments, Moments]:
    """Return the moments of frames and their standard errors, from the scatter of blocks of frames.

    Parameters
    ----------
    blocks
        Frames (frame, row, col), block by block of equal size; blocks are long against the screen's
        memory.
    reference
        A value near the mean, about which powers are summed.
    """
    table = np.array([_raw(np.asarray(block, np.float64) - reference) for block in blocks])
    # Leaving out one block at a time gives errors of ratios as well as of means (jackknife).
    partial = [
        _from_raw(np.delete(table, n, axis=0).mean(axis=0), reference) for n in range(len(table))
    ]
    error = {
        part.name: np.sqrt((len(table) - 1) * np.var([vars(m)[part.name] for m in partial], axis=0))
        for part in fields(Moments)
    }
    return _from_raw(table.mean(axis=0), reference), Moments(**error)


def _raw(x: NDArray[np.floating]) -> NDArray[np.floating]:
    square = x * x
    along = [float(np.mean(x[:, :, n:] * x[:, :, :-n])) for n in range(1, LAGS + 1)]
    across = [float(np.mean(x[:, n:] * x[:, :-n])) for n in range(1, LAGS + 1)]
    quantile = float(np.quantile(x, 0.999))
    return np.array([x.mean(), square.mean(), (square * x).mean(), quantile, *along, *across])


def _from_raw(raw: NDArray[np.floating], reference: float) -> Moments:
    m1, m2, m3, quantile = raw[:4]
    variance = m2 - m1 * m1
    third = m3 - 3.0 * m1 * m2 + 2.0 * m1**3
    covariance = raw[4:] - m1 * m1
    return Moments(
        mean=m1 + reference,
        variance=variance,
        skewness=third / variance**1.5,
        quantile=quantile + reference,
        horizontal=covariance[:LAGS],
        vertical=covariance[LAGS:],
    )


# The theory of the same process.


def field_shares(camera: EventCamera) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return shares of the light of pulses (pulse, field) and the pulses' weights (pulse,),
    arrivals even in time.
    """
    node, weight = np.polynomial.legendre.leggauss(48)
    arrival = camera.gate_s * (node + 1.0) / 2.0
    tau, share = components(camera)
    end = camera.field_s * np.arange(1.0, 41.0)
    late = np.exp(-(end[None, :, None] - arrival[:, None, None]) / tau) @ share
    return -np.diff(late, axis=1, prepend=1.0), weight / 2.0


def campbell(camera: EventCamera, photoelectrons: float, *, step_e: float = 0.0) -> Moments:
    """Return the moments of a flat by Campbell's theorem.

    Parameters
    ----------
    camera
        The camera.
    photoelectrons
        Expected per chip pixel and exposure.
    step_e
        Step of the digitiser, e-; its rounding adds a twelfth of its square.

    Notes
    -----
    A pulse g at x gives the pixel a = sum_c f_c h_c(x) of mean charge, f the video taps, h_c the
    pixels' shares. Charge is counted, so its cumulant function is log E exp(t X) = lambda int E
    exp(g sum_c h_c (exp(t f_c) - 1)) - 1: to the pulses' lambda E[g^n] int a^n come the counting
    terms of sum_c h_c f_c^2 and f_c^3.
    """
    a1, a2, a3 = (_line_response(camera, power) for power in (1, 2, 3))
    shares, weight = field_shares(camera)
    g1, g2, g3 = (camera.height_moment(n) for n in (1, 2, 3))
    taps = camera.taps
    decay = [float(weight @ np.sum(shares**n, axis=1)) for n in (1, 2, 3)]
    next_field = float(weight @ np.sum(shares[:, 1:] * shares[:, :-1], axis=1))
    cell = 1.0 / PHASES**2
    noise = camera.dark_e + camera.read_noise_e**2

    def between(rows: int, columns: int) -> float:
        shifted = a1[: a1.shape[0] - rows * PHASES, : a1.shape[1] - columns * PHASES]
        return float(np.sum(shifted * a1[rows * PHASES :, columns * PHASES :])) * cell

    counted = photoelectrons * camera.rows_summed * g1
    variance = (
        photoelectrons * g2 * decay[1] * between(0, 0)
        + (counted + noise) * np.sum(taps**2)
        + step_e**2 / 12.0
    )
    third = (
        photoelectrons
        * (g3 * decay[2] * np.sum(a1**3) + 3.0 * g2 * decay[1] * np.sum(a1 * a2))
        * cell
    )
    third += photoelectrons * g1 * np.sum(a3) * cell + camera.dark_e * np.sum(taps**3)
    white = [
        float(np.sum(taps[n:] * taps[:-n])) if n < len(taps) else 0.0 for n in range(1, LAGS + 1)
    ]
    horizontal = [
        photoelectrons * g2 * decay[1] * between(0, n) + (counted + noise) * white[n - 1]
        for n in range(1, LAGS + 1)
    ]
    # Lines an odd number apart come from fields that follow each other.
    vertical = [
        photoelectrons
        * g2
        * (next_field if camera.interlaced and n % 2 else decay[1])
        * between(n, 0)
        for n in range(1, LAGS + 1)
    ]
    return Moments(
        mean=counted,
        variance=float(variance),
        skewness=float(third / variance**1.5),
        quantile=_quantile(camera, photoelectrons, float(variance), step_e),
        horizontal=np.array(horizontal),
        vertical=np.array(vertical),
    )


def campbell_of_columns(
    camera: EventCamera, photoelectrons: Transfer, period: int
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return mean and variance of columns under light that changes along the row, shape (period,).

    Parameters
    ----------
    camera
        The camera.
    photoelectrons
        Expected per chip pixel and exposure at a place along the row, columns; repeats with the
        period.
    period
        Columns after which light repeats.
    """
    place = (np.arange(2 * FAR_PX * PHASES) + 0.5) / PHASES - FAR_PX + 0.5
    light = photoelectrons(np.arange(period)[:, None] + place) / PHASES**2
    a1, a2 = _line_response(camera, 1), _line_response(camera, 2)
    shares, weight = field_shares(camera)
    white = np.sum(camera.taps**2)
    # What goes beyond the lattice of places is light of all columns alike.
    missing = light.mean() * (PHASES**2 * camera.rows_summed - np.sum(a1))
    mean = camera.height_moment(1) * (light @ a1.sum(axis=0) + missing)
    counted = camera.height_moment(1) * (light @ a2.sum(axis=0) + missing * white)
    pulses = camera.height_moment(2) * (light @ (a1**2).sum(axis=0))
    decay = float(weight @ np.sum(shares**2, axis=1))
    noise = (camera.dark_e + camera.read_noise_e**2) * white
    return mean, pulses * decay + counted + noise


@lru_cache(maxsize=8)
def _line_response(camera: EventCamera, power: int) -> NDArray[np.floating]:
    """sum_c f_c^power h_c by the event's place, on the lattice of phases; h of the rows that a
    pixel sums.
    """
    share = pixel_response(camera, 2 * FAR_PX, 2 * FAR_PX, PHASES)
    if camera.rows_summed == 2:
        share = share + np.roll(share, PHASES, axis=0)
    total = np.zeros_like(share)
    for n, tap in enumerate(camera.video_taps):
        if abs(tap) > 1e-9:
            total += tap**power * np.roll(share, -n * PHASES, axis=1)
    return total


def _quantile(camera: EventCamera, photoelectrons: float, variance: float, step_e: float) -> float:
    """The charge that one pixel in a thousand exceeds, from the characteristic function of the
    compound process.

    The counting noise of a pulse's charge is taken in proportion to what the pulse gives the pixel.
    """
    response, weight = _levels(camera)
    a1, a2 = _line_response(camera, 1), _line_response(camera, 2)
    counting = float(np.sum(a1 * a2) / np.sum(a1 * a1))
    taps = camera.taps
    noise = (camera.dark_e + camera.read_noise_e**2) * np.sum(taps**2) + step_e**2 / 12.0
    spread = np.sqrt(variance)
    # The law of few photoelectrons reaches far: forty pulses beyond the mean lie beyond any pixel
    # in 1e12.
    mean = photoelectrons * camera.rows_summed * camera.height_moment(1)
    low, high = (
        mean - 14.0 * spread,
        mean + 18.0 * spread + 30.0 * camera.charge_e / camera.detection_probability,
    )
    count = 1 << 14
    step = (high - low) / count
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, step)
    # What lies beyond the lattice of places adds light without noise.
    missing = mean - photoelectrons * camera.height_moment(1) * float(np.sum(response * weight))
    scale = camera.charge_e / camera.detection_probability / camera.pulse_height_shape
    log_law = 1j * omega * missing - 0.5 * omega**2 * noise
    per_event = 1j * omega - 0.5 * omega**2 * counting
    for h, w in zip(response, weight, strict=True):
        log_law += (
            photoelectrons
            * camera.detection_probability
            * w
            * ((1.0 - scale * h * per_event) ** -camera.pulse_height_shape - 1.0)
        )
    density = np.fft.irfft(np.exp(log_law - 1j * omega * (low + step / 2.0)).conj(), count)
    below = np.cumsum(density)
    return float(np.interp(0.999, below, low + step * np.arange(1, count + 1)))


@lru_cache(maxsize=8)
def _levels(camera: EventCamera) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Shares of a pulse that a pixel sees, gathered into levels, and pixels of plane times fields
    that see each.
    """
    space = _line_response(camera, 1).ravel()
    place, area = _gathered(space, np.full(space.size, 1.0 / PHASES**2), 400)
    shares, weight = field_shares(camera)
    time, fields = _gathered(shares.ravel(), np.repeat(weight, shares.shape[1]), 200)
    return _gathered(np.outer(place, time).ravel(), np.outer(area, fields).ravel(), 900)


def _gathered(
    value: NDArray[np.floating], weight: NDArray[np.floating], count: int
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Values of like size put together, each level at its mean, so that the sum of value times
    weight is kept.
    """
    size = np.abs(value)
    level = np.rint(
        np.log(np.maximum(size, 1e-9 * size.max()) / size.max()) * count / np.log(1e9)
    ).astype(int)
    key = np.where(value < 0.0, -1, 1) * (count + 1 + level)
    _, inverse = np.unique(key, return_inverse=True)
    total = np.bincount(inverse, weights=weight)
    mean: Any = np.bincount(inverse, weights=weight * value) / total
    return mean, np.asarray(total, float)
