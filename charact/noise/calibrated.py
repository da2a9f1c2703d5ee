"""Gain per photoelectron and excess noise, which flats alone cannot tell: they take a light of known size.

The signal of an exposure is k lam with lam = E S A t / e photoelectrons on a pixel; E is read off a meter and the
luminous sensitivity S is on the tube's sheet within wide bounds, which carry over to every number here.
"""

from typing import Any

import numpy as np

from charact.method import Context
from charact.noise.series import Series
from labdata.measurement import Measurement, Posterior, from_draws, refused
from labdata.parameter import Parameter

ELECTRON_C = 1.602176634e-19


def calibrated_quantities(series: Series, posterior: Posterior, *, context: Context, flags: tuple[str, ...],
                          covariance_flags: tuple[str, ...], **fields: Any) -> list[Measurement]:  # fmt: skip
    """Return k and F^2, refused where the light or the sensor is unknown.

    F^2 comes from the covariance gain and is suspect for whatever that is suspect for.
    """
    names = (("photoelectron_gain", "DN/pe"), ("excess_noise_factor", "1"))
    chosen = np.flatnonzero(series.fitted)
    known = [series.flats[i].conditions for i in chosen]
    given = [(c.illuminance_lux or 0.0) * (c.gate_ns or 0.0) * 1e-9 for c in known]
    if context.sensor is None or not all(given):
        reason = (
            "k and F2 cannot be told apart from flats: known illuminance, gate and sensor are needed; "
            "see covariance_gain"
        )
        return [refused(name, unit, reason, **fields) for name, unit in names]
    rng = np.random.default_rng([context.seed, 3])
    count = len(posterior.draws)
    exposure = np.array(given)
    slope = float(exposure @ series.signal_dn[chosen] / (exposure @ exposure))
    meter = 1.0 + (known[0].illuminance_relative_sd or 0.0) * rng.standard_normal(count)
    per_lux_s = photoelectrons_per_lux_s(context, rng, count)
    gain = slope / (per_lux_s * np.maximum(meter, 0.05))
    per_electron = drawn(context.sensor.video.conversion_gain_dn_per_e, rng, count)
    excess = (posterior["covariance_gain"] - per_electron) / gain
    note = ("the interval is that of the luminous sensitivity and of the light meter, which flats cannot narrow",)
    return [
        from_draws(name, unit, draws, flags=own, notes=note, **fields)
        for (name, unit), draws, own in zip(names, (gain, excess), (flags, covariance_flags), strict=True)
    ]


def photoelectrons_per_lux_s(context: Context, rng: np.random.Generator, count: int):
    """Return draws of the photoelectrons on a pixel per lux and second of gate, shape (count,)."""
    sensor = context.sensor
    assert sensor is not None
    demagnification = drawn(sensor.taper.demagnification, rng, count)
    rows = 2.0 if context.interlaced else 1.0
    width_um = float(sensor.ccd.pitch_x_um) * demagnification
    height_um = float(sensor.ccd.pitch_y_um) * demagnification * rows
    sensitivity = drawn(sensor.photocathode.luminous_sensitivity_ua_per_lm, rng, count)
    return sensitivity * 1e-6 / ELECTRON_C * width_um * height_um * 1e-12


def drawn(parameter: Parameter, rng: np.random.Generator, count: int):
    """Return draws of a parameter: normal in its logarithm, with its 95 % bounds; exact where it has none."""
    if parameter.low is None or parameter.high is None or parameter.low <= 0:
        return np.full(count, float(parameter))
    side = rng.standard_normal(count)
    up, down = np.log(parameter.high / parameter.value) / 1.96, np.log(parameter.value / parameter.low) / 1.96
    return parameter.value * np.exp(np.where(side > 0, side * up, side * down))
