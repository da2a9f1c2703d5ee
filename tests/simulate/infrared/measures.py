"""What the tests of the infrared imagers measure on frames, without a line of the imagers' own
formulas.
"""

from dataclasses import replace

import numpy as np

from labdata import load_camera
from simulate.camera import ThermalImager
from tests.truth.thermal_targets import half_moon

RANDOM = ("white noise", "1/f noise", "line clamp", "quantisation")
# Resonant scan of 20 degrees in three quarters of a half period at 7867 Hz: amplitude 10.82
# degrees.
MIRROR_HZ, AMPLITUDE_MRAD, FIELD_MRAD = 7867.0, np.deg2rad(10.82) * 1e3, np.deg2rad(20.0) * 1e3


def imager(name, **values):
    """The camera of a shipped description with other values, `scanner__clamp_samples=0` for a
    count.
    """
    described = load_camera(name)
    for path, value in values.items():
        part, key = path.split("__")
        section = getattr(described, part)
        if isinstance(getattr(section, key), bool | int):
            described = replace(described, **{part: replace(section, **{key: value})})
        else:
            described = described.with_values({f"{part}.{key}": value})
    return ThermalImager(described)


def still(camera):
    """The camera without noise, pattern and rounding: those effects that it has."""
    noisy = {
        *RANDOM,
        "row, column and frame noise",
        "fixed pattern",
        "housing drift",
        "photon noise",
        "read noise",
        "correction residual",
        "pixel pattern",
    }
    return camera.without(*(noisy & set(camera.effects)))


def planck_integral(short_um, long_um, kelvin, power=1):
    """Radiance (power 1), W m-2 sr-1, or photon radiance (0) of a black body by a fine midpoint
    rule; CODATA 2018.
    """
    h, c, k = 6.62607015e-34, 299792458.0, 1.380649e-23
    edges = np.linspace(short_um, long_um, 20001) * 1e-6
    metre = 0.5 * (edges[1:] + edges[:-1])
    spectral = 2.0 * h * c**2 / metre**5 / np.expm1(h * c / (metre * k * kelvin))
    return float(np.sum(spectral * (metre / (h * c)) ** (1 - power)) * (edges[1] - edges[0]))


def slope(short_um, long_um, kelvin, power=1):
    """Derivative of `planck_integral` with temperature."""
    high, low = (planck_integral(short_um, long_um, kelvin + step, power) for step in (0.05, -0.05))
    return (high - low) / 0.1


def noise_terms(frames):
    """Standard deviations of seven terms of frames (frame, row, col) by differences of averages, in
    DN.
    """
    x = np.asarray(frames, float)
    x = x - x.mean()
    n_t, n_v, n_h = x.shape
    t, v, h = x.mean((1, 2)), x.mean((0, 2)), x.mean((0, 1))
    tv = x.mean(2) - t[:, None] - v
    th = x.mean(1) - t[:, None] - h
    vh = x.mean(0) - v[:, None] - h
    rest = x - tv[:, :, None] - th[:, None, :] - vh - t[:, None, None] - v[:, None] - h
    tvh = np.sum(rest**2) / ((n_t - 1) * (n_v - 1) * (n_h - 1))
    variance = {
        "tvh": tvh,
        "tv": np.sum(tv**2) / ((n_t - 1) * (n_v - 1)) - tvh / n_h,
        "th": np.sum(th**2) / ((n_t - 1) * (n_h - 1)) - tvh / n_v,
        "vh": np.sum(vh**2) / ((n_v - 1) * (n_h - 1)) - tvh / n_t,
    }
    for name, mean, n, others in (
        ("t", t, n_t, ("tv", "th")),
        ("v", v, n_v, ("tv", "vh")),
        ("h", h, n_h, ("th", "vh")),
    ):
        sizes = {"t": n_t, "v": n_v, "h": n_h}
        own = np.sum(mean**2) / (n - 1)
        for other in others:
            (cross,) = set(other) - {name}
            own -= variance[other] / sizes[cross]
        variance[name] = own - tvh / np.prod([size for axis, size in sizes.items() if axis != name])
    return {name: np.sqrt(max(value, 0.0)) for name, value in variance.items()}


def measured_netd_k(camera, seed, centre_k=295.0):
    """Temporal noise of single pixels over the slope of the mean between black bodies 1 K below and
    above, K.
    """
    low, high = (
        camera.view_target(centre_k - 273.15 + side, seed=seed + number, count=6).astype(float)
        for number, side in enumerate((-1.0, 1.0))
    )
    pairs = [frames[:, lines] for frames in (low, high) for lines in lines_by_direction(camera)]
    sigma = np.sqrt(np.mean([noise_terms(frames)["tvh"] ** 2 for frames in pairs]))
    return float(sigma * 2.0 / (high.mean() - low.mean()))


def lines_by_direction(camera):
    """Rows of both fields and directions of a scanner, or all rows."""
    rows = np.arange(camera.shape[0])
    return [rows[rows % 4 == k] for k in range(4)] if camera.description.interlaced else [rows]


def row_streaks(camera, seed, count):
    """Temporal noise of rows over that of pixels, mean over both fields and directions."""
    frames = camera.view_target(22.0, seed=seed, count=count)
    terms = [noise_terms(frames[:, lines]) for lines in lines_by_direction(camera)]
    return float(
        np.sqrt(
            np.mean([each["tv"] ** 2 for each in terms])
            / np.mean([each["tvh"] ** 2 for each in terms])
        )
    )


def comb_ifov(camera, at_mrad):
    """Distance between the edges of lines scanned to the right and to the left, in IFOV of 1.8
    mrad.

    The mean displacement, the area between the two edges over their height: blur of one side moves
    it not.
    """
    camera = still(camera).without("AC coupling")
    edge = half_moon(camera, tilt_deg=0.0, right_of_mrad=at_mrad)
    (frame,) = camera.view_target(26.0, 20.0, edge, seed=0, count=1).astype(float)
    right, left = frame[0], frame[2]
    pitch_mrad = FIELD_MRAD / right.size
    # A sample that comes late shows what lies further along its sweep: lines to the right show the
    # edge too early.
    return np.sum(right - left) / (right.max() - right.min()) * pitch_mrad / 1.8


def droop(camera):
    """What a black body before the reference of the turn has lost at the end of a line scanned to
    the right.
    """
    camera = still(camera.with_span(40.0, 100.0))
    hot, reference = (
        camera.view_target(celsius, seed=0, count=1)[0].astype(float) for celsius in (60.0, 25.0)
    )
    signal = hot[0] - reference[0]
    return 1.0 - signal[-1] / signal[0]


def grating(camera, frequency_cy_per_mrad, oversample=4, phase=0.0):
    """Signal of a grating of upright bars across the frame, averaged over cells, with the amplitude
    of one kelvin.
    """
    pitch = camera.pitch_mrad[1] / oversample
    right = (
        np.arange(camera.shape[1] * oversample) + 0.5 - 0.5 * camera.shape[1] * oversample
    ) * pitch
    wave = np.cos(2.0 * np.pi * frequency_cy_per_mrad * right + phase) * np.sinc(
        frequency_cy_per_mrad * pitch
    )
    mean = float(camera.signal_of(295.0))
    rows = camera.shape[0] * oversample
    return mean + np.broadcast_to(camera.signal_slope(295.0) * wave, (rows, wave.size))


def contrast(camera, frequency_cy_per_mrad, at_mrad=0.0, width_px=24):
    """Amplitude of a grating in a window of a row over that of the scene, from waves in
    quadrature.
    """
    camera, level = still(camera), float(camera.signal_of(295.0))

    def row(signal):
        return next(camera.frames_of_signal(signal, seed=0)).astype(float)[0]

    flat = row(np.full(camera.shape, level))
    per_k = np.mean(row(np.full(camera.shape, level + camera.signal_slope(295.0))) - flat)
    even, odd = (
        row(grating(camera, frequency_cy_per_mrad, phase=phase)) - flat
        for phase in (0.0, -0.5 * np.pi)
    )
    first = round(at_mrad / camera.pitch_mrad[1] + 0.5 * (camera.shape[1] - width_px))
    return float(np.hypot(even, odd)[first : first + width_px].mean() / per_k)
