"""True quantities of a sensor description, in closed form.

Formulas and numerical integrals of formulas, no simulated frame. Frequencies are in cycles per
column pitch, in both directions; lengths in column pitches.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata import BadInput, Camera, Conditions
from simulate.camera import tube_photometry
from simulate.camera.camera import CameraModel
from simulate.camera.chain import Slot
from simulate.camera.moments import PulseMoments
from simulate.camera.transfer import PixelAperture, StageBlur, product
from simulate.camera.video import NoFilter, VideoFilter

# Or degrees from the row direction.
Direction = Literal["horizontal", "vertical"] | float
DEGREES = {"horizontal": 0.0, "vertical": 90.0}


def true_mtf(
    sensor: Camera, frequency_cy_per_px: ArrayLike, direction: Direction = "horizontal"
) -> NDArray[np.float64]:
    """Return the MTF of the camera without veiling glare, 1 at zero frequency, of the frequencies'
    shape.

    Parameters
    ----------
    sensor
        The camera.
    frequency_cy_per_px
        Frequencies, cycles per column pitch in either direction.
    direction
        "horizontal": frequency along rows (a vertical edge). "vertical": along columns. Or the
        frequency's direction in degrees from the rows, as along the normal of a tilted edge.

    Notes
    -----
    Lens x [(1 - q) + q H_halo] x tube x taper x pixel, and along rows the video filter on the
    pixels' lattice. In the vertical direction the pixel is the row pair of field integration.
    """
    camera = CameraModel(sensor)
    return _transfer(
        camera, (*_before_gain(camera), *_after_gain(camera)), frequency_cy_per_px, direction
    )


def post_gain_mtf(
    sensor: Camera, frequency_cy_per_px: ArrayLike, direction: Direction = "horizontal"
) -> NDArray[np.float64]:
    """Return the MTF of the stages after the gain, which shape the noise; arguments as for
    `true_mtf`.
    """
    camera = CameraModel(sensor)
    return _transfer(camera, _after_gain(camera), frequency_cy_per_px, direction)


def _transfer(
    camera: CameraModel,
    blurs: tuple[StageBlur, ...],
    frequency_cy_per_px: ArrayLike,
    direction: Direction,
) -> NDArray[np.float64]:
    """Return the modulus of blurs and video filter along a direction, cycles per column pitch."""
    if isinstance(direction, str) and direction not in DEGREES:
        raise BadInput(f"a direction must be horizontal, vertical or degrees, got {direction!r}")
    angle = np.radians(DEGREES[direction] if isinstance(direction, str) else direction)
    frequency = np.asarray(frequency_cy_per_px, float)
    fx, fy = frequency * np.cos(angle), frequency * np.sin(angle)
    pitch_mm = camera.cells.pitch_x_mm
    return np.abs(
        product(blurs, fx / pitch_mm, fy / pitch_mm)
        * camera.stage(Slot.VIDEO).low_pass.transfer(fx)
    )


def true_crossing_frequency(
    sensor: Camera, level: float, direction: Direction = "horizontal"
) -> float:
    """Return the lowest frequency where the MTF falls to a level, cycles per column pitch."""
    from scipy.optimize import brentq

    fine = np.linspace(0.0, 1.0, 2001)
    crossings = np.flatnonzero(true_mtf(sensor, fine, direction) < level)
    if crossings.size == 0 or crossings[0] == 0:
        raise BadInput(
            f"the MTF must fall to the level within one cycle per pixel, got the level {level:g}"
        )
    low, high = fine[crossings[0] - 1], fine[crossings[0]]
    root: Any = brentq(lambda f: float(true_mtf(sensor, f, direction)) - level, low, high)
    return float(root)


def true_quantities(sensor: Camera, conditions: Conditions | None = None) -> dict[str, float]:
    """Return the true quantities with which measurements of a session can be compared.

    Parameters
    ----------
    sensor
        The camera.
    conditions
        Voltage, gate and temperature; the sensor's reference voltage and an open gate where None.

    Returns
    -------
    dict
        `mtf50`, `mtf10`, `mtf50_vertical`, `mtf10_vertical` (cycles per column pitch);
        `photoelectron_gain` k and `detected_photoelectron_gain` k/p (DN); `system_gain` K (DN per
        CCD electron); `excess_noise_factor` F^2; `covariance_gain` K + k F^2 (DN), that of a
        pulse's whole light: summed over the fields through which the phosphor decays as well as
        over pixels; `field_covariance_gain` (DN), summed over the pixels of one field alone;
        `decay_factor`, the sum over fields of their squared fractions of a pulse;
        `field_correlation`, that of one field with the next; `blur_factor` of variances over
        covariance sums within a field; `correlation_horizontal` and `correlation_vertical` at one
        pixel of a field; `halo_diameter` (column pitches); `ebi` (photoelectrons per s and field
        pixel) and `ebi_per_field`; `photoelectrons_per_lux` of a field pixel and exposure;
        `read_noise` (DN); `black_level` (DN).
    """
    conditions = Conditions() if conditions is None else conditions
    camera = CameraModel(sensor)
    noise, area_cm2 = _noise(camera, conditions), camera.field_pixel_area_cm2
    ebi = tube_photometry.ebi_per_s_cm2(sensor, conditions.temperature_c) * area_cm2
    per_lux = tube_photometry.photoelectrons_per_lumen_s(sensor) * 1e-4 * area_cm2
    open_s = camera.stage(Slot.PHOTOCATHODE, conditions).open_s
    return {
        "mtf50": true_crossing_frequency(sensor, 0.5),
        "mtf10": true_crossing_frequency(sensor, 0.1),
        "mtf50_vertical": true_crossing_frequency(sensor, 0.5, "vertical"),
        "mtf10_vertical": true_crossing_frequency(sensor, 0.1, "vertical"),
        **noise,
        "halo_diameter": 4.0 * float(sensor.photocathode.gap_mm) / camera.cells.pitch_x_mm,
        "ebi": ebi,
        "ebi_per_field": ebi * open_s,
        "photoelectrons_per_lux": per_lux * open_s,
        "black_level": float(sensor.video.black_level_dn),
    }


def pulse_correlation(
    blurs: tuple[StageBlur, ...],
    low_pass: VideoFilter | NoFilter | None,
    pitch_x_mm: float,
    pitch_y_mm: float,
) -> tuple[float, float, float]:
    """Return the blur factor of pulses behind a blur, and their correlations one pixel away.

    Parameters
    ----------
    blurs
        Blurs after the gain, the pixel's aperture among them.
    low_pass
        Filter along the lines; None for none.
    pitch_x_mm, pitch_y_mm
        Sides of a pixel as read, at the photocathode, mm.

    Returns
    -------
    tuple
        Variance over covariance sum; correlation with the next pixel of the row, and with the next
        row of the field.

    Notes
    -----
    Pulses fall evenly, so that the covariance of pixels a vector D apart is the integral over the
    plane of
    A |H(f)|^2 |V(fx)|^2 cos(2 pi f.D), A the pixel's area: folding onto the lattice of pixels is
    implied, as V has the lattice's period along rows.
    """
    # Midpoints of equal steps up to 4 cycles per pixel, beyond which transfer is negligible.
    x, y = ((np.arange(n) + 0.5) * (4.0 / n) for n in (1600, 1200))
    fx, fy = np.broadcast_arrays(x[None, :] / pitch_x_mm, y[:, None] / pitch_y_mm)
    power = product(blurs, fx, fy) ** 2
    if low_pass is not None:
        power = power * np.abs(low_pass.transfer(x)) ** 2
    total = power.sum()
    next_column = (power * np.cos(2.0 * np.pi * x)[None, :]).sum() / total
    next_row = (power * np.cos(2.0 * np.pi * y)[:, None]).sum() / total
    # One quadrant stands for four.
    return float(4.0 * total * (x[1] - x[0]) * (y[1] - y[0])), float(next_column), float(next_row)


def _noise(camera: CameraModel, conditions: Conditions) -> dict[str, float]:
    chain, low_pass = camera.chain(conditions), camera.stage(Slot.VIDEO).low_pass
    mcp, moments = chain[Slot.MCP], PulseMoments(chain)
    system_gain = float(camera.description.video.conversion_gain_dn_per_e)
    gain, decay = moments.gain_e * system_gain, moments.decay[0]
    pulses = gain * mcp.excess_noise_factor
    pitch_y_mm = camera.cells.pitch_y_mm * camera.fields_per_frame
    blur, next_column, next_row = pulse_correlation(
        _after_gain(camera), low_pass, camera.cells.pitch_x_mm, pitch_y_mm
    )
    field = system_gain + pulses * decay
    return {
        "photoelectron_gain": gain,
        "detected_photoelectron_gain": gain / mcp.detection_probability,
        "system_gain": system_gain,
        "excess_noise_factor": mcp.excess_noise_factor,
        "covariance_gain": system_gain + pulses,
        "field_covariance_gain": field,
        "decay_factor": decay,
        "field_correlation": moments.next_field / decay,
        "blur_factor": (system_gain * moments.white + pulses * decay * blur) / field,
        "correlation_horizontal": next_column,
        "correlation_vertical": next_row,
        "read_noise": float(camera.description.ccd.read_noise_e)
        * system_gain
        * float(np.sqrt(moments.white)),
    }


def _before_gain(camera: CameraModel) -> tuple[StageBlur, ...]:
    return camera.stage(Slot.OPTICS).blur, *camera.stage(Slot.GAP).blurs


def _after_gain(camera: CameraModel) -> tuple[StageBlur, ...]:
    aperture = PixelAperture.of(camera.cells, camera.fields_per_frame)
    return camera.stage(Slot.PHOSPHOR).spread, camera.stage(Slot.TAPER).blur, aperture
