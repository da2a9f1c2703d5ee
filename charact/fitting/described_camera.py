"""Noise law and point spread function of a frame by a sensor description."""

import numpy as np

from charact.estimators.bloom.posterior_psf import PosteriorPsf
from charact.fitting import predicted_quantities as predicted
from charact.fitting.prior import values_of_description
from charact.frames.noise_law import NoiseLaw
from charact.fusion.noise_law import blur_px_of
from labdata.camera.description import Camera


def describe_camera(sensor: Camera, mcp_v: float) -> tuple[NoiseLaw, PosteriorPsf]:
    """Return the noise law of a frame at an MCP voltage, V, and the point spread function: best
    values, one draw.

    Examples
    --------
    >>> from labdata.sensors import load_sensor
    >>> law, _ = describe_camera(load_sensor("pulnix-ag5745ef3"), 800.0)
    >>> law.gain_dn > 1.0
    True
    """
    values = values_of_description(sensor)
    gain = predicted.photoelectron_gain(values, mcp_v)
    blur = 1.0 if sensor.video.digital else float(predicted.blur_factor(values, gain)[0])
    read_dn = float(sensor.ccd.read_noise_e) * float(sensor.video.conversion_gain_dn_per_e)
    law = NoiseLaw(
        gain_dn=float(predicted.covariance_gain(values, gain)[0]),
        read_dn=(read_dn**2 + 1.0 / 12.0) ** 0.5,
        blur_px=blur_px_of(blur),
    )
    pitch_mm = float(sensor.ccd.pitch_x_um) * 1e-3 * float(sensor.taper.demagnification)
    aberration_px = float(sensor.optics.aberration_blur_um) * 1e-3 / pitch_mm
    return law, PosteriorPsf(
        halo_diameter_px=predicted.halo_diameter_px(values),
        elastic_share=np.array([float(sensor.photocathode.halo_elastic_share)]),
        halo_fraction=np.array([float(sensor.photocathode.halo_fraction)]),
        core_frequency_cy_per_px=values["tube.mtf_frequency_lp_per_mm"] * pitch_mm,
        core_exponent=values["tube.mtf_exponent"],
        core_spread_px2=np.array([aberration_px**2 + 1.0 / 12.0]),
    )
