"""The fit finds a known truth as often as it promises, and claims nothing that the data do not
know.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from charact.fitting import (
    description_from_posterior,
    fit_sensor,
    inflate_errors,
    model_of,
    observations_of,
    posterior_of,
    predicted_quantities,
    prior_of,
    values_of_description,
)
from labdata import BadInput, Camera, Result, measurement_from_sd
from tests.truth.sessions import session_in_memory

SPECIMENS = 3


@pytest.fixture(scope="module")
def fits(told_of: Callable, seed: int):
    out = []
    for number in range(SPECIMENS):
        told = told_of(seed + number)
        posterior = posterior_of(told.model, seed=seed + number)
        out.append(
            (
                told,
                posterior,
                description_from_posterior(
                    told.model, posterior, illuminance_relative_sd=0.0, seed=seed
                ),
            )
        )
    return out


def test_truth_is_inside_the_ranges_as_often_as_promised(fits) -> None:
    inside, away = [], []
    for told, posterior, _ in fits:
        # In the coordinates of the prior, logarithms of factors, where widths are alike on both
        # sides.
        truth = told.model.prior.coordinates(
            np.array([[told.truth[name] for name in posterior.names]])
        )[0]
        low, middle, high = np.quantile(posterior.draws, (0.025, 0.5, 0.975), axis=0)
        inside += list((low <= truth) & (truth <= high))
        away += list((truth - middle) / posterior.draws.std(axis=0))
    # Some 80 intervals, correlated within each specimen: 95 % with a standard error of about 5 %.
    assert np.mean(inside) > 0.8
    assert np.max(np.abs(away)) < 5.5


def test_light_and_noise_narrow_what_they_speak_of(fits) -> None:
    for _, _, sensor in fits:
        standing = {path: parameter.standing for path, parameter in sensor.parameters().items()}
        assert standing["photocathode.gap_mm"] == "fitted"
        assert standing["tube.post_gain_share"] == "fitted"
        assert standing["video.black_level_dn"] == "fitted"


def test_a_combination_is_known_better_than_its_factors_and_said_so(fits) -> None:
    factors = (
        "tube.luminous_gain",
        "taper.transmission",
        "ccd.quantum_efficiency",
        "video.conversion_gain_dn_per_e",
    )
    for told, _, sensor in fits:
        table = dict(zip(sensor.draws.names, np.array(sensor.draws.values).T, strict=True))
        product = np.prod([table[path] for path in factors], axis=0)
        assert (
            product.std() / product.mean()
            < 0.5 * table[factors[0]].std() / table[factors[0]].mean()
        )
        true = np.prod([told.truth[path] for path in factors])
        assert abs(product.mean() - true) < 4.5 * product.std()
        assert any("only together with taper.transmission" in note for note in sensor.notes)


def test_every_value_lies_inside_its_interval_without_an_effort(fits) -> None:
    """Well inside: a value at the edge of its own interval would be tied to numbers that nobody
    fitted.
    """
    for _, _, sensor in fits:
        table = np.array(sensor.draws.values)
        for name, column in zip(sensor.draws.names, table.T, strict=True):
            place = np.mean(column < float(sensor.parameters()[name]))
            assert 0.02 < place < 0.98, name


def test_what_is_not_identified_keeps_the_range_of_its_prior(fits, sheet: Camera) -> None:
    before = sheet.parameters()
    for _, _, sensor in fits:
        after = sensor.parameters()
        for path, parameter in after.items():
            if path not in sensor.draws.names:
                assert parameter == before[path]
            elif parameter.standing == "prior":
                assert parameter.low <= before[path].low and parameter.high >= before[path].high
                assert "not identified" in parameter.source
        assert after["taper.transmission"].standing == "prior"


def test_noise_of_the_chip_that_no_frame_shows_is_drawn_from_its_prior(
    fits, sheet: Camera, seed: int
) -> None:
    path = "ccd.read_noise_e"
    for told, _, sensor in fits:
        assert path not in told.model.prior.names
        drawn = np.array(sensor.draws.values)[:, sensor.draws.names.index(path)]
        known = sheet.parameters()[path]
        assert known.low is not None and known.high is not None
        inside = (drawn >= known.low) & (drawn <= known.high)
        error = np.sqrt(0.05 * 0.95 / drawn.size)
        assert abs(inside.mean() - 0.95) < 4.0 * error
        # Its value and range are the description's: the data say nothing of it.
        assert sensor.parameters()[path] == known


def test_every_joint_draw_gives_back_what_was_measured(fits) -> None:
    told, _, sensor = fits[0]
    rng = np.random.default_rng(0)
    gains = []
    for _ in range(100):
        values = values_of_description(sensor.draw(rng))
        gains.append(
            predicted_quantities.covariance_gain(
                values, predicted_quantities.photoelectron_gain(values, 800.0)
            )[0]
        )
    measured = told.stacks.result.find("covariance_gain")[0]
    assert np.std(gains) < 0.03 * measured.value
    assert np.mean(gains) == pytest.approx(measured.value, rel=0.03)


def test_the_chain_finds_the_gap_behind_a_halo(told_of: Callable, seed: int) -> None:
    """A halo alone speaks of the gap and the taper, and leaves everything else as it stood."""
    told = told_of(seed)
    halo = Result(measurements=told.stacks.result.find("halo_diameter"))
    stacks = replace(told.stacks, result=halo, levels=(), flats=())
    model = model_of(stacks.camera, observations_of(stacks))
    posterior = posterior_of(model, seed=seed)
    assert posterior.sampler == "slice" and not posterior.flags
    sensor = description_from_posterior(model, posterior, illuminance_relative_sd=0.03, seed=seed)
    assert sensor.photocathode.gap_mm.standing == "fitted"
    assert {
        p
        for p, parameter in sensor.parameters().items()
        if parameter.standing in ("fitted", "prior")
    } == {
        "photocathode.gap_mm",
        "taper.demagnification",
    }
    truth = told.truth["photocathode.gap_mm"]
    draws = posterior.draws[:, posterior.names.index("photocathode.gap_mm")]
    assert abs(truth - draws.mean()) < 5.0 * draws.std()


def test_measurements_that_contradict_each_other_widen_the_ranges_and_are_named(
    told_of: Callable, seed: int
) -> None:
    told = told_of(seed)
    blur = told.stacks.result.find("blur_factor")[0]
    wrong = measurement_from_sd("blur_factor", "1", 2.5 * blur.value, 0.003, method="told")
    others = tuple(m for m in told.stacks.result.measurements if m.quantity != "blur_factor")
    result = replace(told.stacks.result, measurements=(*others, wrong))
    model = model_of(told.stacks.camera, observations_of(replace(told.stacks, result=result)))
    wider, said = inflate_errors(model)
    assert said is not None and said.flag == "model-misfit"
    assert np.all(wider.observed[0].covariance > 1.5 * model.observed[0].covariance - 1e-12)
    assert inflate_errors(told.model)[1] is None


def test_a_bent_measurement_stays_outside(told_of: Callable, seed: int) -> None:
    told = told_of(seed)
    bent = tuple(m.with_(flags=("model-misfit",)) for m in told.stacks.result.measurements)
    result = replace(told.stacks.result, measurements=bent)
    observed = observations_of(replace(told.stacks, result=result))
    assert [observation.name for observation in observed] == ["levels"]


def test_prior_draws_fill_the_ranges_of_the_description(sheet: Camera, seed: int) -> None:
    prior = prior_of(
        sheet, ("tube.luminous_gain", "photocathode.halo_fraction", "ccd.quantum_efficiency")
    )
    drawn = prior.parameters(prior.draw(np.random.default_rng(seed), 20000))
    for name, column in zip(prior.names, drawn.T, strict=True):
        known = sheet.parameters()[name]
        share = np.mean((column >= known.low) & (column <= known.high))
        # 95 % of 20,000 draws, 4.5 standard errors; the cut at zero takes a little of the halo's
        # lower tail.
        assert share == pytest.approx(0.95, abs=0.017)


def test_a_session_without_a_sensor_or_without_numbers_is_refused(sheet: Camera) -> None:
    bare = session_in_memory(())
    with pytest.raises(BadInput, match="needs a sensor"):
        fit_sensor(bare, Result())
    with pytest.raises(BadInput, match="at least one measurement"):
        fit_sensor(replace(bare, camera=sheet), Result())
