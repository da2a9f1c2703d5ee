"""MTF of a session: targets agree on one curve, and its budget says which stage costs how much."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import (
    REPORTED,
    Direction,
    MeasuredCurve,
    MeasuredCurves,
    add_mtf_budget,
    curve_of,
    fit_mtf_budget,
    mtf_consistency,
)
from charact.method import Context
from labdata import Curve, Result, load_sensor, measurement_from_sd

# A session's own curves give its stage budget: closed-form cameras, both pitches, and sessions
# that have none.


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


# The stage budget against closed-form curves: the cascade of the physics reference, section 1.12.


def low_pass(frequency):
    """Third-order Butterworth of 6.5 MHz at 14.318 MHz a pixel, complex."""
    s = 1j * np.asarray(frequency) * 14.318 / 6.5
    return 1.0 / ((s + 1.0) * (s**2 + s + 1.0))


def video(frequency):
    """Stairs one clock wide through the low pass, read once a clock: their aliases added up."""
    at = np.asarray(frequency)[..., None] + np.arange(-60, 61)
    return np.abs(np.sum(np.sinc(at) * np.exp(-1j * np.pi * at) * low_pass(at), axis=-1))


def cascade(
    direction: Direction,
    frequency,
    *,
    after_gain=False,
    cut_off=26.25,
    exponent=1.184,
    share=0.8,
    halo_share=0.0,
):
    """Product of section 1.12 by formula: 4 um lens, Johnson's tube, 6 um fibres and interfaces,
    pixel, 6.5 MHz.

    The halo is four gaps of 0.21 mm wide, 30 % of its electrons elastic.
    """
    from scipy.special import j1, sici

    along = direction == "horizontal"
    detector = frequency / (0.011 if along else 0.013)
    cathode = detector * 11.0 / 18.0
    x = np.pi * 0.006 * detector
    pupil = 1.0 - 4.0 / np.pi * cathode * 0.7e-3 * 1.4
    lens = pupil * np.exp(-2.0 * (np.pi * cathode * 0.004) ** 2)
    tube = np.exp(-((cathode / cut_off) ** exponent))
    rest = (
        2.0
        * j1(x)
        / x
        * np.exp(-((detector / 120.0) ** 2))
        * np.abs(np.sinc(frequency * (1.0 if along else 2.0)))
    )
    if along:
        rest = rest * video(frequency)
    u = np.pi * cathode * 0.84
    halo = 1.0 - halo_share + halo_share * (0.3 * np.sin(u) / u + 0.7 * sici(u)[0] / u)
    return tube**share * rest if after_gain else lens * halo * tube * rest


def curve(direction: Direction, sd: float, rng=None, bump=0.0, **more) -> MeasuredCurves:
    frequency = np.linspace(0.02, 0.45 if direction == "horizontal" else 0.3, 15)
    value = cascade(direction, frequency, **more) + bump * np.sin(20.0 * frequency)
    noise = 0.0 if rng is None else sd * rng.standard_normal(frequency.size)
    one = MeasuredCurve(
        direction=direction,
        after_gain=more.get("after_gain", False),
        frequency_cy_per_px=frequency,
        value=value + noise,
    )
    return MeasuredCurves(curves=(one,), covariance=sd**2 * np.eye(frequency.size))


BOTH: tuple[Direction, ...] = ("horizontal", "vertical")


def budget(curves, **more):
    return fit_mtf_budget(tuple(curves), SENSOR, interlaced=True, seed=1, quick=True, **more)


def test_without_the_curve_after_the_gain_the_tube_is_a_product(seed):
    rng = np.random.default_rng(seed)
    found = budget([curve(d, 0.002, rng) for d in BOTH])
    assert (
        "tube before the gain" not in found.identified
        and "tube after the gain" not in found.identified
    )
    assert any(
        {"tube before the gain", "tube after the gain"} <= set(group) for group in found.products
    )
    assert any("only the product of" in sentence for sentence in found.statement)
    assert "pixel" in found.known


def test_a_halo_lowers_the_whole_and_is_found_where_it_is_looked_for(seed):
    """A quarter of the light, 2.1 prior standard deviations above the description, within 4.5
    standard errors.
    """
    rng = np.random.default_rng(seed)
    curves = [curve(d, 0.002, rng, halo_share=0.25) for d in BOTH]
    found = budget(curves, halo=True)
    share = found.posterior["photocathode.halo_fraction"]
    assert abs(np.mean(share) - 0.25) < 4.5 * np.std(share)
    assert "halo" in found.identified
    assert found.chance > 1e-3
    without = budget(curves)
    assert without.chance < 1e-6
    assert "halo" not in (*without.camera.stages, *without.known)
    assert not any("halo" in sentence for sentence in without.statement)


def test_a_curve_told_twice_with_the_same_errors_tells_no_more_than_once(seed):
    one = curve("horizontal", 0.01, np.random.default_rng(seed))
    twice = MeasuredCurves(
        curves=one.curves * 2, covariance=np.kron(np.ones((2, 2)), one.covariance)
    )
    once, same, independent = (budget(curves) for curves in ([one], [twice], [one, one]))
    sd, doubled, halved = (
        np.std(found.product(found.camera.stages, np.array([0.2]), "horizontal"))
        for found in (once, same, independent)
    )
    # Two standard deviations of n draws each differ by 1/sqrt(n) of themselves; 4.5 standard errors
    # are allowed.
    assert doubled == pytest.approx(sd, rel=4.5 / np.sqrt(len(once.posterior.draws)))
    assert halved < 0.85 * sd


def test_a_camera_that_no_stages_describe_is_said(seed):
    assert any(
        "do not describe" in sentence
        for sentence in budget([curve("horizontal", 0.002, bump=0.05)]).statement
    )


# Targets of one camera agree as often as promised; one that reads another MTF is found out.


FREQUENCIES = (0.08, 0.15, 0.25)
KINDS = {"a": "edge", "b1": "bars", "b2": "bars", "b3": "bars", "p": "point"}


def _result(
    rng: np.random.Generator, *, edge_offset: float = 0.0, edge_angle_deg: float = 5.0
) -> Result:
    frequency = np.linspace(0.0, 0.5, 26)
    truth = np.exp(-((frequency / 0.3) ** 1.3))

    def curve(stack: str, offset: float, sd: float) -> Curve:
        value = truth + offset + sd * rng.standard_normal()
        return Curve(
            frequency_cy_per_px=frequency,
            value=value,
            interval68=np.stack([value - sd, value + sd]),
            stack=stack,
        )

    bars = [
        measurement_from_sd(
            "mtf",
            "1",
            float(np.exp(-((f / 0.3) ** 1.3)) + 0.01 * rng.standard_normal()),
            0.01,
            method="fake",
            stack=f"b{n}",
            frequency_cy_per_px=f,
            orientation_deg=4.0,
        )
        for n, f in enumerate(FREQUENCIES, 1)
    ]
    tilt = measurement_from_sd(
        "mtf50", "cy/px", 0.2, 0.01, method="fake", stack="a", orientation_deg=edge_angle_deg
    )
    curves = {"mtf:a": curve("a", edge_offset, 0.005), "mtf:p": curve("p", 0.0, 0.02)}
    return Result(measurements=(*bars, tilt), curves=curves)


def _found(result: Result) -> dict:
    return mtf_consistency(result, KINDS).evidence["agreement of targets"]


def test_one_camera_agrees_with_itself_in_95_of_100_sessions_or_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 400
    inside = sum(_found(_result(rng))["inside_joint_95_percent_region"] for _ in range(count))
    assert inside / count > 0.95 - 3.5 * np.sqrt(0.95 * 0.05 / count)


@pytest.mark.parametrize("offset", [0.08, -0.08])
def test_an_edge_that_reads_another_mtf_is_found_out(offset: float, seed: int) -> None:
    found = _found(_result(np.random.default_rng(seed), edge_offset=offset))
    assert not found["inside_joint_95_percent_region"]
    assert found["largest_z"] > found["joint_95_percent_limit_z"]


def test_a_curve_along_another_direction_is_not_compared(seed: int) -> None:
    found = _found(_result(np.random.default_rng(seed), edge_angle_deg=85.0, edge_offset=0.3))
    assert set(found["pair"]) == {"bars - point"}


def test_a_target_alone_agrees_with_nothing() -> None:
    assert mtf_consistency(Result(), KINDS).evidence == {}
