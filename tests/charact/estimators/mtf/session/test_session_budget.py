"""A session's own curves give its stage budget: closed-form cameras, both pitches, and sessions
that have none.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import REPORTED, add_mtf_budget, curve_of
from charact.method import Context
from labdata import Curve, Result, load_sensor, measurement_from_sd
from tests.charact.estimators.mtf.session.test_mtf_budget import cascade

SENSOR = load_sensor("pulnix-ag5745ef3")
CONTEXT = Context(seed=1, quick=True, camera=SENSOR, interlaced=True)
# 13 um rows beside 11 um columns: as many row pitches make a column pitch.
ROW_OVER_COLUMN = 13.0 / 11.0
TRUTH = {"cut_off": 28.0, "exponent": 1.15, "halo_share": 0.18}
DRAWS = 400


def drawn(
    direction, wobble, *, bump: float = 0.0, after_gain: bool = False, per_row: bool = False
) -> Curve:
    """A curve in cycles per column pitch whose errors are those of the tube's cut-off and exponent,
    and of the halo.
    """
    frequency = np.maximum(REPORTED, 1e-6)
    own = frequency * ROW_OVER_COLUMN if direction == "vertical" and not per_row else frequency
    draws = [
        cascade(
            direction,
            own,
            cut_off=TRUTH["cut_off"] + cut,
            exponent=TRUTH["exponent"] + n,
            after_gain=after_gain,
            halo_share=TRUTH["halo_share"] + q,
            share=0.6,
        )
        for cut, n, q in wobble
    ]
    return curve_of(REPORTED, np.array(draws) * (1.0 + bump * np.sin(40.0 * frequency)))


def session(rng, *, joint: bool = True, bump: float = 0.0, after: str | None = None) -> Result:
    """Curves along rows and columns, drawn together about an estimate off by its own error."""
    sd = np.array([0.3, 0.02, 0.008])
    centre = sd * rng.standard_normal(3)
    wobble = centre + sd * rng.standard_normal((DRAWS, 3))
    across, down = (drawn(direction, wobble, bump=bump) for direction in ("horizontal", "vertical"))
    stack, names = (
        (None, ("mtf_joint", "mtf_joint_vertical")) if joint else ("p", ("mtf:p", "mtf_vertical:p"))
    )
    levels = tuple(
        measurement_from_sd(
            "mtf50",
            "cy/px",
            0.2,
            0.004,
            method="joint" if joint else "point-forward",
            stack=stack,
            orientation_deg=angle,
        )
        for angle in (0.0, 90.0)
    )
    found = Result(
        measurements=levels,
        curves=dict(zip(names, (across, down), strict=True)),
        evidence={"joint MTF": {"counts_halo": True}} if joint else {},
    )
    return found if after is None else found + flats(rng, after)


def flats(rng, status: str) -> Result:
    """The transfer after the gain, vertically in cycles per row pitch, as the noise of flats tells
    it.
    """
    wobble = rng.standard_normal((DRAWS, 3)) * [0.2, 0.005, 0.0]
    curves = {
        name: drawn(direction, wobble, after_gain=True, per_row=True)
        for name, direction in (
            ("mtf_post_gain", "horizontal"),
            ("mtf_post_gain_vertical", "vertical"),
        )
    }
    flags = () if status == "ok" else ("lag",)
    level = measurement_from_sd(
        "post_gain_mtf50", "cy/px", 0.3, 0.01, method="noise-spectrum", flags=flags
    )
    return Result(measurements=(level,), curves=curves)


def evidence(
    result: Result, kinds: dict[str, str] | None = None, context: Context = CONTEXT
) -> dict:
    return add_mtf_budget(result, kinds or {}, context=context).evidence["stage budget"]


@pytest.mark.parametrize("joint", [True, False])
def test_the_product_of_the_stages_is_the_camera_along_rows_and_along_columns(
    joint: bool, seed: int
) -> None:
    """Within 0.015 of the closed form at every frequency shown above 0.03, and the halo within 4.5
    standard errors.
    """
    found = evidence(session(np.random.default_rng(seed), joint=joint), {"p": "point"})
    assert found["status"] == "ok", found["chance"]
    for direction, per_pitch in (("horizontal", 1.0), ("vertical", ROW_OVER_COLUMN)):
        panel = found[direction]
        frequency = np.array(panel["frequency_cy_per_column"])
        truth = cascade(direction, frequency * per_pitch, share=0.6, **TRUTH)
        shown = frequency > 0.03
        assert np.array(panel["product"]["value"])[shown] == pytest.approx(truth[shown], abs=0.015)
        assert np.array(panel["measured"]["value"])[shown] == pytest.approx(truth[shown], abs=0.02)
    assert panel["cathode_lp_per_mm"][-1] == pytest.approx(0.5 / 0.018)
    value, low, high = found["parameters"]["photocathode.halo_fraction"]
    assert abs(value - TRUTH["halo_share"]) < 4.5 * (high - low) / 3.92


def test_taken_as_single_rows_the_curves_of_summed_ones_are_described_by_no_stages(
    seed: int,
) -> None:
    result = session(np.random.default_rng(seed))
    found = add_mtf_budget(result, {}, context=replace(CONTEXT, interlaced=False))
    assert found.evidence["stage budget"]["flags"] == ["model-misfit"]
    assert found.evidence["stage budget"]["status"] == "suspect"
    assert any("do not describe the curves" in note for note in found.find("mtf50")[0].notes)
    # What was measured is no worse for a description that does not hold.
    assert all(m.status == "ok" for m in found.find("mtf50"))


def test_what_the_budget_says_stands_once_at_the_mtf50_along_rows(seed: int) -> None:
    found = add_mtf_budget(session(np.random.default_rng(seed)), {}, context=CONTEXT)
    across, down = found.find("mtf50")
    assert [note for note in across.notes if note.startswith("Stages: along")] != []
    assert any("taken as known: pixel" in note for note in across.notes)
    assert down.notes == ()


def test_sound_flats_part_the_tube_and_doubted_ones_take_no_part(seed: int) -> None:
    """The share after the gain is 0.6 in truth: 4.5 standard errors, and at most half as wide as
    without flats.
    """
    plain, sound, doubted = (
        evidence(session(np.random.default_rng(seed), after=after))
        for after in (None, "ok", "suspect")
    )
    name = "tube.post_gain_share"
    value, low, high = sound["parameters"][name]
    assert abs(value - 0.6) < 4.5 * (high - low) / 3.92
    assert high - low < 0.5 * np.ptp(plain["parameters"][name][1:])
    assert doubted["parameters"] == plain["parameters"]
    assert "measured_after_gain" in sound["vertical"]
    assert "measured_after_gain" not in doubted["vertical"]
    assert {"tube before the gain", "tube after the gain"} <= set(sound["identified"])


@pytest.mark.parametrize("lacking", ["sensor", "columns", "draws", "sound mtf50"])
def test_a_session_without_what_it_takes_is_as_it_was(lacking: str, seed: int) -> None:
    result = session(np.random.default_rng(seed))
    context = replace(CONTEXT, camera=None) if lacking == "sensor" else CONTEXT
    curves = dict(result.curves)
    if lacking == "columns":
        del curves["mtf_joint_vertical"]
    if lacking == "draws":
        curves = {name: replace(one, draws=None) for name, one in curves.items()}
    result = replace(result, curves=curves)
    if lacking == "sound mtf50":
        result = session(np.random.default_rng(seed), joint=False)
        result = replace(
            result, measurements=tuple(m.with_(flags=("clipped",)) for m in result.measurements)
        )
    assert add_mtf_budget(result, {"p": "point"}, context=context) is result
