"""Which measurements the fit may use, and which sensor parameters each kind of them speaks of."""

from labdata.measurement import Measurement, Result

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


def trusted(result: Result, quantity: str, unit: str | None = None) -> list[Measurement]:
    """Return the sound measurements of a quantity, or the suspect ones where there is no sound one."""
    carrying = [m for m in result.find(quantity) if m.status != "refused" and m.interval68 and unit in (None, m.unit)]
    sound = [m for m in carrying if m.status == "ok"]
    return sound or carrying


def sd_of(m: Measurement) -> float:
    """Return half the 68 % interval: the standard deviation of a Gaussian one."""
    low, high = m.interval68 or (float("nan"), float("nan"))
    return (high - low) / (2.0 * 0.994458)
