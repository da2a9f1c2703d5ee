"""The core types refuse what they cannot mean, in one sentence, and never change once made."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdata import (
    FLAGS,
    QUANTITIES,
    BadInput,
    Conditions,
    FrameStack,
    Limits,
    Measurement,
    Plan,
    Posterior,
    Result,
    Step,
    Target,
    convert_frequency,
    make_measurement,
    make_refusal,
    measurement_from_draws,
    measurement_from_sd,
    order_flags,
)
from labdata.camera import Parameter


def test_frames_cannot_be_written_to_through_the_stack():
    own = np.zeros((2, 3, 4))
    stack = FrameStack(data=own, time_s=np.arange(2.0))
    with pytest.raises(ValueError, match="read-only"):
        stack.data[0, 0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        stack.time_s[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        stack.unit = "e-"  # type: ignore[misc]
    own[0, 0, 0] = 5  # the caller's array stays the caller's


@pytest.mark.parametrize(
    ("fields", "rule"),
    [
        ({"data": np.zeros((3, 4))}, r"axes \(frame, row, col\), got shape \(3, 4\)"),
        ({"data": np.zeros((0, 3, 4))}, "at least one pixel"),
        (
            {"data": np.full((1, 2, 2), np.nan)},
            "must be finite, got 4 that are NaN or infinite of 4",
        ),
        ({"data": np.zeros((1, 2, 2), bool)}, "whole or real numbers, got the type bool"),
        (
            {"data": np.zeros((2, 2, 2)), "time_s": np.zeros(3)},
            "time_s must be empty or one for each of 2 frames",
        ),
        (
            {"data": np.zeros((2, 2, 2)), "frame_number": np.zeros(1)},
            "frame_number must be empty or one for each",
        ),
    ],
)
def test_what_is_no_stack_is_refused(fields, rule):
    with pytest.raises(BadInput, match=rule):
        FrameStack(**fields)


@given(*[st.integers(-3, 12)] * 4)
@settings(deadline=None)
def test_a_region_is_cut_as_it_is_named_or_refused(row, col, height, width):
    stack = FrameStack(data=np.arange(2 * 8 * 9).reshape(2, 8, 9), time_s=np.arange(2.0))
    inside = (
        row >= 0
        and col >= 0
        and height > 0
        and width > 0
        and row + height <= 8
        and col + width <= 9
    )
    if not inside:
        with pytest.raises(
            BadInput, match=f"8 rows and 9 columns, got {row},{col},{height},{width}"
        ):
            stack.region(row, col, height, width)
        return
    cut = stack.region(row, col, height, width)
    assert cut.shape == (2, height, width)
    assert cut.data[1, 0, 0] == 72 + 9 * row + col
    assert np.array_equal(cut.time_s, stack.time_s)


def test_only_gain_in_db_and_temperature_may_be_negative():
    Conditions(camera_gain_db=-6.0, temperature_c=-40.0)
    for name in ("mcp_v", "gate_ns", "illuminance_lux", "exposure_s", "photons_per_px"):
        with pytest.raises(BadInput, match=f"{name} must not be negative, got -1"):
            Conditions(**{name: -1.0})


@pytest.mark.parametrize(
    ("fields", "rule"),
    [
        ({"bars": 1}, "at least 2 bars, got 1"),
        ({"frequency_cy_per_px": 0.0}, "must be positive, got 0"),
        ({"frequency_cy_per_px": float("inf")}, "must be a finite number, got inf"),
        ({"pinhole_px": -1.0}, "must not be negative, got -1"),
        ({"contrast": 1.5}, r"must lie in \(0, 1\], got 1\.5"),
    ],
)
def test_a_target_that_cannot_be_is_refused(fields, rule):
    with pytest.raises(BadInput, match=rule):
        Target(**fields)


def test_a_parameter_lies_between_its_bounds_and_is_a_number():
    assert float(Parameter(value=2.0, low=1.0, high=3.0)) == 2.0
    with pytest.raises(BadInput, match=r"got 4 for 1\.\.3"):
        Parameter(value=4.0, low=1.0, high=3.0)
    with pytest.raises(BadInput, match="given together, got 1"):
        Parameter(value=4.0, low=1.0)


def step(label: str = "a", **conditions: float) -> Step:
    return Step(label=label, kind="flat", frames=1, conditions=Conditions(**conditions))


def test_a_plan_is_checked_whole_when_it_is_made():
    for name, over in (("mcp_v", 901.0), ("illuminance_lux", 0.02), ("gate_ns", 3e7)):
        with pytest.raises(BadInput, match=f"{name} of step 'a' must not exceed the limit"):
            Plan(name="p", steps=(step(**{name: over}),))
        Plan(name="p", steps=(step(**{name: over}),), limits=Limits(**{name: over}))
    with pytest.raises(BadInput, match=r"every step's label must be its own, got \['a', 'a'\]"):
        Plan(name="p", steps=(step(), step()))
    with pytest.raises(BadInput, match="at least one frame, got 0"):
        Step(label="a", kind="flat", frames=0, conditions=Conditions())


def test_a_number_without_flags_is_ok_and_with_flags_suspect():
    assert make_measurement("mtf50", "cy/px", 0.2, None, None, method="m").status == "ok"
    suspect = make_measurement(
        "mtf50", "cy/px", 0.2, None, None, method="m", flags=("lag", "agc", "lag")
    )
    assert (suspect.status, suspect.flags) == ("suspect", ("lag", "agc"))
    assert (
        make_measurement("mtf50", "cy/px", 0.2, None, None, method="m")
        .with_(flags=("drift",))
        .status
        == "suspect"
    )


def test_a_refusal_has_a_reason_and_no_number():
    refusal = make_refusal("mtf50", "cy/px", "no edge was found", method="m")
    assert (refusal.value, refusal.interval95, refusal.status) == (None, None, "refused")
    assert refusal.with_(flags=("no-target",)).status == "refused"
    with pytest.raises(ValueError, match="carries a reason and no value"):
        dataclasses.replace(refusal, value=0.2)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_measurement_is_a_finite_number(value):
    with pytest.raises(ValueError, match="must be a finite number"):
        make_measurement("mtf50", "cy/px", value, None, None, method="m")


def test_a_quantity_outside_the_contract_cannot_be_measured():
    with pytest.raises(ValueError, match="no quantity 'mtf51'"):
        make_measurement("mtf51", "cy/px", 0.2, None, None, method="m")
    with pytest.raises(ValueError, match="with the unit 'lp/mm'"):
        make_measurement("mtf50", "lp/mm", 0.2, None, None, method="m")
    with pytest.raises(ValueError, match="'halo'"):
        order_flags(("halo",))
    assert all(sentence.endswith(".") for sentence in FLAGS.values())
    assert all(quantity.units for quantity in QUANTITIES.values())


def test_intervals_of_draws_and_of_a_standard_deviation_agree(seed):
    draws = np.random.default_rng(seed).normal(5.0, 0.1, 40_000)
    drawn = measurement_from_draws("blur_factor", "1", draws, method="m")
    exact = measurement_from_sd("blur_factor", "1", 5.0, 0.1, method="m")
    # Standard error of the 2.5 % quantile of n normal draws: sqrt(p (1 - p) / n) / density, here
    # 2.7 sd / sqrt(n).
    standard_error = 2.7 * 0.1 / 200
    assert np.array(drawn.interval95) == pytest.approx(
        np.array(exact.interval95), abs=4.5 * standard_error
    )
    assert np.array(drawn.interval68) == pytest.approx(
        np.array(exact.interval68), abs=4.5 * standard_error
    )


def test_a_posterior_names_each_column_of_its_draws():
    posterior = Posterior(names=("a", "b"), units=("1", "px"), draws=np.arange(6.0).reshape(3, 2))
    assert posterior["b"].tolist() == [1.0, 3.0, 5.0]
    with pytest.raises(ValueError, match="draws must be"):
        Posterior(names=("a",), units=("1",), draws=np.zeros((3, 2)))


def test_results_add_up_and_are_searched_by_what_they_say():
    def of(label: str) -> Measurement:
        return make_measurement("bloom_diameter", "px", 9.0, None, None, method="m", stack=label)

    both = Result(measurements=(of("a"),), evidence={"a": {}}) + Result(
        measurements=(of("b"),), evidence={"b": {}}
    )
    assert both.find("bloom_diameter", stack="b") == (of("b"),)
    assert both.evidence.keys() == {"a", "b"}
    assert both.find("mtf50") == ()


def test_570_television_lines_are_27_lp_per_mm_at_the_cathode():
    """Regression truth 8: 768 columns are 576 lines, and 570 lines over 493 rows of 13 um are 27.2
    lp/mm at 18/11.
    """
    assert convert_frequency(0.5, "tvl/ph", picture_height_px=768 * 3 / 4) == 576
    height_px = 493 * 13.0 / 11.0
    at_570 = 570 / convert_frequency(1.0, "tvl/ph", picture_height_px=height_px)
    assert convert_frequency(at_570, "lp/mm", pitch_um=11.0) / (18 / 11) == pytest.approx(
        27.2, abs=0.05
    )
    assert convert_frequency(0.1, "cy/mrad", pitch_um=11.0, focal_length_mm=22.0) == pytest.approx(
        0.2
    )


@pytest.mark.parametrize(
    ("unit", "rule"),
    [
        ("lp/mm", "needs a positive pitch_um"),
        ("tvl/ph", "positive picture_height_px"),
        ("Hz", "must be one of"),
    ],
)
def test_a_frequency_is_converted_only_with_the_length_it_needs(unit, rule):
    with pytest.raises(BadInput, match=rule):
        convert_frequency(0.1, unit)
