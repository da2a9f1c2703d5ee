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


# Suspicions that widen a number rather than bend it; any other keeps a measurement out of the fit.
MILD = {"defects", "drift", "flicker", "gradient", "low-signal", "not-converged", "prior-bound", "too-few-frames"}


def is_admissible(m: Measurement) -> bool:
    """Whether a measurement is sound, or suspected of nothing that would bend it."""
    return m.status != "refused" and m.interval68 is not None and set(m.flags) <= MILD


def admissible_measurements(result: Result, quantity: str, unit: str | None = None) -> list[Measurement]:
    """Return the sound measurements of a quantity, or the mildly suspect ones where there is no sound one."""
    found = [m for m in result.find(quantity) if is_admissible(m) and unit in (None, m.unit)]
    return [m for m in found if m.status == "ok"] or found


def sd_of(m: Measurement) -> float:
    """Return half the 68 % interval: the standard deviation of a Gaussian one."""
    low, high = m.interval68 or (float("nan"), float("nan"))
    return (high - low) / (2.0 * 0.994458)
