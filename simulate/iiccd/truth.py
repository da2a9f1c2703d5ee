"""Closed-form truths of an intensified camera: what a perfect measurement of its frames would find."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.conditions import Conditions
from labdata.sensor import Sensor
from simulate.iiccd import photons
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.transfer import Blur, PixelAperture

# Post-gain blur has died out here: the integral of |H|^2 is cut at this many sampling frequencies.
CUT_SAMPLINGS = 4.0
STEPS_PER_SAMPLING = 256
HORIZONTAL_DEG, VERTICAL_DEG = 0.0, 90.0


def mtf(sensor: Sensor, frequency_cy_per_px: ArrayLike, direction: float | str = HORIZONTAL_DEG) -> NDArray[np.float64]:
    """Return the MTF of the whole camera, normalised to the light that entered; uniform glare does not count.

    Parameters
    ----------
    sensor
        The camera.
    frequency_cy_per_px
        Frequencies, cycles per column pitch.
    direction
        Direction of the frequency from the row direction, degrees; or "horizontal", "vertical".

    Returns
    -------
    NDArray
        MTF, dimensionless, shape of the frequencies.

    Notes
    -----
    The product of lens, tube (both shares), halo, taper, the aperture of a field pixel and the video filter.
    """
    angle = np.radians({"horizontal": HORIZONTAL_DEG, "vertical": VERTICAL_DEG}.get(str(direction), direction))
    frequency = np.asarray(frequency_cy_per_px, float)
    fx_px, fy_px = frequency * np.cos(angle), frequency * np.sin(angle)
    camera = IntensifiedCamera(sensor)
    pitch_mm = camera.cells.pitch_x_mm
    before, after = _blurs(camera)
    blurred = _product((*before, *after), fx_px / pitch_mm, fy_px / pitch_mm)
    return np.abs(blurred) * np.abs(_video(camera).transfer(fx_px))


def mtf_frequency(sensor: Sensor, level: float, direction: float | str = HORIZONTAL_DEG) -> float:
    """Return the frequency where the MTF falls to a level, cycles per column pitch."""
    from scipy.optimize import brentq

    return float(brentq(lambda f: float(mtf(sensor, f, direction)) - level, 1e-4, 1.0))


def photoelectron_gain_dn(sensor: Sensor, conditions: Conditions) -> float:
    """Return k, DN per photoelectron (the undetected counted), at low current."""
    at_screen = photons.photons_per_photoelectron(sensor) * photons.voltage_factor(sensor, conditions.mcp_v)
    in_chip = at_screen * float(sensor.taper.transmission) * float(sensor.ccd.quantum_efficiency)
    return in_chip * float(sensor.video.conversion_gain_dn_per_e)


def excess_noise_factor(sensor: Sensor) -> float:
    """Return F^2 = (1 + relative variance of pulse heights)/p."""
    plate = sensor.microchannel_plate
    return (1.0 + 1.0 / float(plate.pulse_height_shape)) / float(plate.detection_probability)


def covariance_gain_dn(sensor: Sensor, conditions: Conditions) -> float:
    """Return K + k F^2, DN: covariance sum over mean, whatever the blur."""
    scintillation = photoelectron_gain_dn(sensor, conditions) * excess_noise_factor(sensor)
    return float(sensor.video.conversion_gain_dn_per_e) + scintillation


def blur_factor(sensor: Sensor, conditions: Conditions) -> float:
    """Return variance over covariance sum of a flat, both without their dark parts.

    Notes
    -----
    Scintillations arrive anywhere, so their variance is A times the integral of |H|^2 over all frequencies, A the area
    of a field pixel and H all blur after the gain, aliases included. Charge of the chip is white before the video
    filter and keeps the sum of its squared impulse response.
    """
    white = float(np.sum(_video(IntensifiedCamera(sensor)).impulse_response() ** 2))
    conversion = float(sensor.video.conversion_gain_dn_per_e)
    scintillation = photoelectron_gain_dn(sensor, conditions) * excess_noise_factor(sensor)
    return (conversion * white + scintillation * scintillation_blur_factor(sensor)) / (conversion + scintillation)


@lru_cache(maxsize=16)
def scintillation_blur_factor(sensor: Sensor) -> float:
    """Return A times the integral of |H|^2, H all blur after the gain; see `blur_factor`."""
    camera = IntensifiedCamera(sensor)
    _, after = _blurs(camera)
    aperture = after[-1]
    assert isinstance(aperture, PixelAperture)
    width, height = aperture.width_mm, aperture.height_mm
    # Midpoints; the transfer is even in both frequencies.
    steps = (np.arange(int(CUT_SAMPLINGS * STEPS_PER_SAMPLING)) + 0.5) / STEPS_PER_SAMPLING
    fx, fy = np.meshgrid(steps / width, steps / height)
    power = np.abs(_product(after, fx, fy)) ** 2 * np.abs(_video(camera).transfer(steps)) ** 2
    return float(4.0 * power.sum() / STEPS_PER_SAMPLING**2)


def halo_diameter_px(sensor: Sensor) -> float:
    """Return the outer diameter of the halo, four gaps, in column pitches."""
    pitch_mm = IntensifiedCamera(sensor).cells.pitch_x_mm
    return 4.0 * float(sensor.photocathode.gap_mm) / pitch_mm


def ebi_pe_per_s_px(sensor: Sensor) -> float:
    """Return dark photoelectrons per s and field pixel."""
    camera = IntensifiedCamera(sensor)
    rows = 2 if camera.interlaced else 1
    area_cm2 = camera.cells.pitch_x_mm * camera.cells.pitch_y_mm * rows * 1e-2
    return photons.ebi_per_s_cm2(sensor) * area_cm2


def quantities(sensor: Sensor, conditions: Conditions) -> dict[str, float]:
    """Return the truth of every quantity that has a closed form, by the contract's name and in its unit."""
    return {
        "mtf50": mtf_frequency(sensor, 0.5),
        "mtf10": mtf_frequency(sensor, 0.1),
        "photoelectron_gain": photoelectron_gain_dn(sensor, conditions),
        "excess_noise_factor": excess_noise_factor(sensor),
        "covariance_gain": covariance_gain_dn(sensor, conditions),
        "blur_factor": blur_factor(sensor, conditions),
        "halo_diameter": halo_diameter_px(sensor),
        "ebi": ebi_pe_per_s_px(sensor),
    }


def _blurs(camera: IntensifiedCamera) -> tuple[tuple[Blur, ...], tuple[Blur, ...]]:
    """Blurs before the gain, and after it with the aperture of a field pixel last."""
    chain = {stage.name: stage for stage in camera.chain(Conditions()).stages}
    cells = camera.cells
    height_mm = cells.pitch_y_mm * (2 if camera.interlaced else 1)
    aperture = PixelAperture(width_mm=cells.pitch_x_mm, height_mm=height_mm)
    gap = chain["gap"]
    return (chain["optics"].blur, gap.spread, gap.halo), (chain["phosphor"].spread, chain["taper"].blur, aperture)


def _video(camera: IntensifiedCamera):
    return camera.chain(Conditions()).stages[-1].low_pass


def _product(blurs: tuple[Blur, ...], fx_per_mm: NDArray, fy_per_mm: NDArray) -> NDArray:
    total = np.ones(np.broadcast(fx_per_mm, fy_per_mm).shape)
    for blur in blurs:
        total = total * blur.transfer(fx_per_mm, fy_per_mm)
    return total
