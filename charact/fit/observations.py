"""All of a session's measurements that the fit uses, each tied to the formula that predicts it."""

import numpy as np
from numpy.typing import NDArray

from charact.fit import predicted_quantities
from charact.fit.admissible_measurements import LEVEL, admissible_measurements, sd_of
from charact.fit.levels import StackMean
from charact.fit.mtf_observations import mtf_observations
from charact.fit.noise_observations import LEAST_NOISE_DN, noise_observations
from charact.fit.observed import Observation, one
from charact.fit.predicted_quantities import Values
from labdata.measurement import Measurement, Result
from labdata.sensor import Sensor
from labdata.session import Session

Array = NDArray[np.float64]

# What the formula leaves out of a level, relative (uneven tube) and in DN.
LEVEL_MODEL_SD = 0.003
LEVEL_MODEL_SD_DN = 0.03
# The halo's edge is found on pixels.
HALO_MODEL_SD_PX = 0.1
# Where the noise is small against a DN, the mean leans towards whole numbers.
LEANING_SD_DN = 0.1


def observations(
    session: Session, sensor: Sensor, result: Result, levels: tuple[StackMean, ...]
) -> tuple[Observation, ...]:
    """Return what the fit compares its model with, in the order transfer, noise, halo, levels.

    A mildly suspect measurement is used only where no sound one of its kind is there; one that is refused, or suspected
    of more, never.
    """
    reference_v = float(sensor.microchannel_plate.reference_v)
    found = mtf_observations(session, sensor, result) + noise_observations(session, sensor, result, levels)
    found += [_halo(m) for m in admissible_measurements(result, "halo_diameter")]
    found += [_halo_share(m) for m in admissible_measurements(result, "halo_fraction")]
    found += [_levels(levels, reference_v)] if levels else []
    return tuple(found)


def _halo(m: Measurement) -> Observation:
    sd = float(np.hypot(sd_of(m), HALO_MODEL_SD_PX))
    speaks_of = ("photocathode.gap_mm", "taper.demagnification")
    return one("halo diameter", m.value or 0.0, sd, predicted_quantities.halo_diameter_px, speaks_of)


def _halo_share(m: Measurement) -> Observation:
    speaks_of = ("photocathode.halo_fraction",)
    return one("halo fraction", m.value or 0.0, sd_of(m), lambda values: values[speaks_of[0]], speaks_of)


def _levels(levels: tuple[StackMean, ...], reference_v: float) -> Observation:
    """Tie mean levels to black level and gain times photoelectrons; the clamp takes dark charge away."""
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

    leaning = np.array([LEANING_SD_DN if level.noise_dn < LEAST_NOISE_DN else 0.0 for level in levels])
    variance = own**2 + LEVEL_MODEL_SD_DN**2 + (LEVEL_MODEL_SD * mean) ** 2 + leaning**2
    extra = ("microchannel_plate.gain_exponent",) if len(set(mcp_v.tolist())) > 1 else ()
    return Observation(
        name="levels", value=mean, covariance=np.diag(variance), predict=predict, speaks_of=(*LEVEL, *extra)
    )
