"""Noise of the flats of a tube as the fit observes it: level by level, with the joint errors of
gain and blur.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.fitting import (
    Observation,
    model_of,
    observations_of,
    predicted_quantities,
    tube_light,
    values_of_description,
)
from charact.observables import Values
from labdata import Camera, Posterior, Result, load_camera, measurement_from_draws

SIGNAL_DN = np.array([5.0, 30.0, 120.0])
POWER_SD, VARIANCE_SD = 0.01, 0.002


def flats_of(sheet: Camera, told, *, tested: bool = True, seed: int = 1) -> Result:
    """Return measurements of the flats of a tube at the values of its description, with drawn
    errors.
    """
    values, gate_s = values_of_description(sheet), told.stacks.levels[1].gate_s
    gain = predicted_quantities.photoelectron_gain(values, 800.0)
    left = tube_light.field_products(values, gate_s, 1)[:, 0]
    blur = predicted_quantities.noise_shape(values, gain)[0]
    loaded = gain * (1.0 - predicted_quantities.gain_loss(values, SIGNAL_DN))
    slope = blur * predicted_quantities.covariance_gain(values, left * loaded)
    rng = np.random.default_rng(seed)
    power = float((slope / blur).mean()) * (1.0 + POWER_SD * rng.standard_normal(2000))
    lag = np.full(2000, 1.0 / float(left[0])) * (1.0 + 0.01 * rng.standard_normal(2000) * tested)
    draws = np.stack([power * lag, slope.mean() / power, lag, power], axis=1)
    posterior = Posterior(
        names=("covariance_gain", "blur_factor", "lag_factor", "power"),
        units=("DN", "1", "1", "DN"),
        draws=draws,
        sampler="laplace",
    )
    measured = tuple(
        measurement_from_draws(name, unit, posterior[name], posterior=posterior, method="told")
        for name, unit in (("covariance_gain", "DN"), ("blur_factor", "1"))
    )
    transfer = {
        "label": ["a", "b", "c"],
        "signal_dn": SIGNAL_DN.tolist(),
        "fitted": [True] * 3,
        "variance_dn2": (slope * SIGNAL_DN + 1.0).tolist(),
        "dark_variance_dn2": [1.0] * 3,
        "variance_sd_dn2": (VARIANCE_SD * slope * SIGNAL_DN).tolist(),
    }
    lags = {"lag_exposures": [1, 2] if tested else []}
    return Result(
        measurements=measured, evidence={"photon-transfer": transfer, "autocorrelation": lags}
    )


def noise_of(told, result: Result) -> tuple[Observation, ...]:
    """Return what is observed of the noise of the flats."""
    observed = observations_of(replace(told.stacks, result=result))
    return tuple(part for part in observed if part.name == "noise")


def test_the_loss_of_gain_is_that_of_the_load_at_the_light_of_the_signal(sheet: Camera) -> None:
    values, lux, gate_s = values_of_description(sheet), 3e-4, 0.016
    load = predicted_quantities.mcp_load(values, lux, gate_s, 800.0)
    gain = predicted_quantities.photoelectron_gain(values, 800.0)
    signal = gain * predicted_quantities.photoelectrons(values, lux, gate_s) / (1.0 + load)
    assert 0.005 < load[0] < 0.5
    assert predicted_quantities.gain_loss(values, signal) == pytest.approx(
        load / (1.0 + load), rel=1e-12
    )


def test_variance_over_signal_is_known_better_than_gain_and_blur(
    sheet: Camera, told_of, seed: int
) -> None:
    told = told_of(seed)
    (observed,) = noise_of(told, flats_of(sheet, told))
    sd = np.sqrt(np.diag(observed.covariance)) / observed.value
    assert observed.value.size == 2 + SIGNAL_DN.size
    # Power has its measured error and that of the blur models; the brightest flat has its own and
    # no other's.
    assert sd[0] > POWER_SD
    assert sd[-1] < 2.0 * VARIANCE_SD
    # The description itself agrees.
    assert observed.chi_squared(values_of_description(sheet))[0] < 5.0


def test_the_ridge_is_a_plane(sheet: Camera, told_of, seed: int) -> None:
    """Points of equal straightened sensitivity have equal variance over signal, whatever the other
    parameters.
    """
    told = told_of(seed)
    observed = noise_of(told, flats_of(sheet, told))
    model = model_of(sheet, observed)
    rng = np.random.default_rng(seed)
    drawn = model.prior.draw(rng, 50)
    points = np.where(model.is_scored, rng.standard_normal(drawn.shape), drawn)
    points[:, model.is_carrier] = model.prior.centre[model.is_carrier]
    coordinates, _ = model.bend(points)
    unsheared = np.where(model.is_carrier, points, coordinates)
    ridge = observed[0].ridge
    assert ridge is not None
    free, bent = (np.exp(ridge.number(model.values(one))) for one in (unsheared, coordinates))
    assert free.std() / free.mean() > 0.1
    # A trace of electrons per photoelectron, K, is not inversely proportional to the sensitivity.
    assert bent.std() / bent.mean() < 2e-3


def test_without_a_test_of_image_lag_gain_and_blur_stand_alone(
    sheet: Camera, told_of, seed: int
) -> None:
    told = told_of(seed)
    result = flats_of(sheet, told, tested=False)
    observed = noise_of(told, result)
    assert [part.value.item() for part in observed] == pytest.approx(
        [m.value for m in result.measurements]
    )
    assert all(part.ridge is None for part in observed)


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "gen3-digital-iccd"])
def test_what_is_kept_of_the_last_values_follows_every_parameter(name: str) -> None:
    """A change of one is seen as after a change of all."""
    values, moving = values_of_description(load_camera(name)), 0
    others = {path: 1.1 * value for path, value in values.items()}

    def covariances(*cameras: Values) -> list[float]:
        """Return the covariances of cameras, asked one after the other."""
        return [predicted_quantities.pulse_covariance(v, ((0, 0),)).item() for v in cameras]

    for path, value in values.items():
        changed = {**values, path: 1.01 * value}
        _, before, after = covariances(others, values, changed)
        assert after == covariances(others, changed)[1], path
        moving += after != before
    assert moving >= 7
