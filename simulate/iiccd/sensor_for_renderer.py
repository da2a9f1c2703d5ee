"""A camera as a renderer needs it: photoelectrons of a pixel for radiance by wavelength, and the noise beside them."""

import numpy as np

from labdata.conditions import Conditions
from simulate.iiccd import true_quantities, tube_photometry
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.chip import SCENE_MARGIN_PX
from simulate.iiccd.effect_bounds.noise_budget import NoiseBudget
from simulate.iiccd.solid_state import SiliconCamera
from simulate.radiance.integrator.render_sensor import RenderSensor

STEP_NM = 5.0


def render_sensor_of(camera: IntensifiedCamera | SiliconCamera, conditions: Conditions) -> RenderSensor:
    """Return what a pixel on the axis makes of radiance, in photoelectrons an exposure.

    Notes
    -----
    Variance F^2 (signal + dark) + read noise, all referred to the photocathode (or to the silicon of a camera without a
    tube): what each photoelectron adds, detected or not, F^2 = (1 + 1/shape)/p.
    """
    lens = camera.lens()
    table = np.asarray(lens.detector_nm, float)
    fine = np.union1d(table, np.arange(table[0], table[-1], STEP_NM))
    relative = np.interp(fine, table, lens.detector_efficiency) / max(lens.detector_efficiency)
    peak, area_m2, open_s, dark, factor, read, averaging = _numbers(camera, conditions)
    per_watt = peak * relative * fine * 1e-9 / tube_photometry.JOULE_METRE
    response = per_watt * lens.gathering_sr * area_m2 * open_s
    return RenderSensor(
        response_nm=tuple(fine),
        response=tuple(response),
        dark_variance=factor * dark + read,
        variance_per_signal=factor,
        noise_averaging_factor=averaging,
        name=camera.sensor.name if isinstance(camera, IntensifiedCamera) else camera.description.name,
    )


def _numbers(
    camera: IntensifiedCamera | SiliconCamera, conditions: Conditions
) -> tuple[float, float, float, float, float, float, float]:
    """Return peak efficiency, pixel area, m2, time open, s, dark photoelectrons, F^2, read pe^2 and noise averaging.

    The light of a photoelectron's pulse falls on several pixels, and its afterglow in several fields.
    """
    if isinstance(camera, SiliconCamera):
        silicon, register = camera.silicon(conditions), camera.register(conditions)
        area_m2 = camera.cells.pitch_x_mm * camera.cells.pitch_y_mm * 1e-6
        dark = register.dark_e + register.clock_induced_e
        read = (register.read_noise_e / register.gain) ** 2
        return silicon.quantum_efficiency, area_m2, silicon.exposure_s, dark, register.excess_noise_factor, read, 1.0
    wide = tuple(side + 2 * SCENE_MARGIN_PX for side in camera.shape)
    picture = NoiseBudget(camera, np.zeros(wide, np.float32), conditions)
    cathode = camera.photocathode(conditions)
    area_m2 = true_quantities.field_pixel_area_cm2(camera) * 1e-4
    read = (float(camera.sensor.ccd.read_noise_e) / picture.gain_at_rest_e) ** 2
    factor = picture.plate.excess_noise_factor
    per_pe = (picture.pulses[0] + picture.white) / picture.charge_e
    averaging = min(1.0, float(np.sqrt(per_pe / factor)))
    return cathode.quantum_efficiency, area_m2, cathode.open_s, picture.dark_pe, factor, read, averaging
