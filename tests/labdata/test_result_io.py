"""A result written and read is the same result, and its JSON keeps the contract."""

import dataclasses
import json

import numpy as np
import pytest

from labdata import (
    BadInput,
    Curve,
    Posterior,
    Provenance,
    Result,
    make_measurement,
    make_refusal,
    measurement_from_draws,
    result_io,
)


def a_result(seed: int = 1) -> Result:
    draws = np.random.default_rng(seed).normal(0.2, 0.01, (500, 2))
    posterior = Posterior(
        names=("mtf50", "width"),
        units=("cy/px", "px"),
        draws=draws,
        autocorrelation_time=np.array([20.0, 30.0]),
        acceptance=0.4,
        r_hat=np.array([1.0, 1.01]),
        effective_sample_size=np.array([400.0, 300.0]),
        seed=seed,
        flags=("prior-bound",),
    )
    provenance = Provenance(
        version="0.1.0", seed=seed, settings={"window_px": 30}, inputs={"a.tif": "00"}
    )
    shared = {"posterior": posterior, "provenance": provenance, "seconds": 0.4}
    return Result(
        measurements=(
            measurement_from_draws(
                "mtf50",
                "cy/px",
                draws[:, 0],
                method="edge",
                stack="edge-01",
                region=(1, 2, 30, 40),
                **shared,
            ),
            measurement_from_draws(
                "mtf10", "cy/px", 2 * draws[:, 0], method="edge", flags=("lag",), **shared
            ),
            make_measurement(
                "mtf",
                "1",
                0.5,
                (0.4, 0.6),
                (0.3, 0.7),
                method="bars",
                frequency_cy_per_px=0.12,
                notes=("a",),
            ),
            make_refusal("halo_diameter", "px", "no point source was found", method="halo"),
        ),
        curves={
            "mtf": Curve(
                frequency_cy_per_px=np.linspace(0, 0.5, 9),
                value=np.ones(9),
                interval95=np.ones((2, 9)),
            )
        },
        evidence={
            "edge-spread": {"figure": "edge-spread", "x_px": [0.0, 1.5], "truth": {"mtf50": 0.2}}
        },
    )


def same(one, other) -> bool:
    """Whether two results are equal, arrays included."""
    if dataclasses.is_dataclass(one):
        return type(one) is type(other) and all(
            same(getattr(one, item.name), getattr(other, item.name))
            for item in dataclasses.fields(one)
        )
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other


def test_a_kept_result_comes_back_whole(tmp_path):
    result = a_result()
    result_io.save(result, tmp_path)
    assert same(result_io.load(tmp_path), result)


def test_saving_again_replaces_and_leaves_one_file_of_draws(tmp_path):
    result_io.save(a_result(1), tmp_path)
    result_io.save(a_result(2), tmp_path)
    assert same(result_io.load(tmp_path), a_result(2))
    assert len(list(tmp_path.glob("results-*.npz"))) == 1
    assert not list(tmp_path.glob(".*.partial"))


def test_measurements_of_one_posterior_share_its_draws_on_the_disk(tmp_path):
    result_io.save(a_result(), tmp_path)
    (draws,) = tmp_path.glob("results-*.npz")
    with np.load(draws) as packed:
        assert sum(name.endswith(".draws") for name in packed.files) == 1


@pytest.mark.parametrize(
    "damage", [b"", b"{", b'{"format": 1}', b'{"format": 9, "draws": "none.npz"}']
)
def test_a_damaged_result_is_refused_in_a_sentence(tmp_path, damage):
    result_io.save(a_result(), tmp_path)
    (tmp_path / result_io.RESULTS).write_bytes(damage)
    with pytest.raises(BadInput, match="must be whole and readable"):
        result_io.load(tmp_path)


def test_a_number_that_is_not_finite_is_a_gap_and_not_a_crash(tmp_path):
    curve = Curve(frequency_cy_per_px=np.array([0.0, 0.1]), value=np.array([1.0, np.nan]))
    result_io.save(
        Result(curves={"mtf": curve}, evidence={"a": {"x": [np.inf, np.float32(2.0)]}}), tmp_path
    )
    loaded = result_io.load(tmp_path)
    assert loaded is not None
    assert np.isnan(loaded.curves["mtf"].value[1])
    assert loaded.evidence["a"]["x"] == [None, 2.0]


def test_the_json_of_a_verb_keeps_the_contract():
    written = json.loads(
        json.dumps(
            result_io.to_json(a_result(), given="edge.tif", version="0.1.0"), allow_nan=False
        )
    )
    assert written["charact"] == "0.1.0"
    assert written["input"] == "edge.tif"
    first, second, third, last = written["measurements"]
    for one in written["measurements"]:
        assert {
            "quantity",
            "unit",
            "value",
            "interval68",
            "interval95",
            "status",
            "flags",
            "method",
            "seconds",
        } <= (one.keys())
    assert first["status"] == "ok"
    assert first["region"] == [1, 2, 30, 40]
    assert first["stack"] == "edge-01"
    assert (
        first["interval95"][0] <= first["interval68"][0] <= first["value"] <= first["interval68"][1]
    )
    assert second["status"] == "suspect"
    assert second["flags"] == ["lag"]
    assert "region" not in second
    assert third["frequency_cy_per_px"] == 0.12
    assert third["notes"] == ["a"]
    assert last["value"] is None
    assert last["reason"] == "no point source was found"
    curve = written["curves"]["mtf"]
    assert (
        len(curve["frequency_cy_per_px"]) == len(curve["value"]) == len(curve["interval95"][0]) == 9
    )
    assert curve["interval68"] is None
