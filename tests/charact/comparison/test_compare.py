"""Differences of two specimens: coverage, sign, and the distribution of each side."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from charact import session, stack
from charact.comparison import Comparison, compare, condition_pairs, draws_of
from labdata import (
    BadInput,
    Measurement,
    Result,
    Session,
    load_sensor,
    make_measurement,
    make_refusal,
    measurement_from_sd,
    open_session,
)

PAIRS = 200


def mtf50(value: float, sd: float = 0.01, **fields) -> Measurement:
    return measurement_from_sd("mtf50", "cy/px", value, sd, method="edge-forward", **fields)


def result(*measurements: Measurement) -> Result:
    return Result(measurements=measurements)


def compared(a: Result, b: Result, **settings) -> Comparison:
    return compare(a, b, rng=np.random.default_rng(5), **settings)


def of(**conditions: float | bool | None) -> Session:
    """A session with one flat in memory."""
    return session([stack(np.zeros((2, 8, 8)), "flat", label="flat-1", **conditions)])


def test_differences_of_one_specimen_cover_zero_as_often_as_promised(seed: int) -> None:
    rng, sds = np.random.default_rng(seed), (0.002, 0.004)
    covered, probabilities = 0, []
    for _ in range(PAIRS):
        a, b = (result(mtf50(0.2 + sd * rng.standard_normal(), sd)) for sd in sds)
        found = compare(a, b, rng=rng).differences[0]
        covered += not found.excludes_zero
        probabilities.append(found.probability_greater)
    standard_error = (0.95 * 0.05 / PAIRS) ** 0.5
    assert abs(covered / PAIRS - 0.95) < 3.0 * standard_error
    # Of one specimen every probability is as likely as another.
    assert abs(np.mean(probabilities) - 0.5) < 3.0 / (12.0 * PAIRS) ** 0.5


def test_specimens_five_percent_apart_are_ordered_rightly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(PAIRS):
        a, b = (
            result(mtf50(v * (1 + 0.01 * rng.standard_normal()), 0.01 * v)) for v in (0.200, 0.210)
        )
        found.append(compare(a, b, rng=rng).differences[0])
    assert np.mean([one.difference > 0 for one in found]) >= 0.95
    assert np.mean([(one.probability_better or 0.0) > 0.5 for one in found]) >= 0.95


@pytest.mark.parametrize(
    ("interval68", "interval95"),
    [((2.9, 3.4), (2.3, 5.2)), (None, (2.3, 5.2)), ((2.9, 3.4), None), ((3.1, 3.1), (3.1, 4.0))],
)
def test_draws_reproduce_the_intervals(interval68, interval95) -> None:
    m = make_measurement(
        "photoelectron_gain", "DN/pe", 3.1, interval68, interval95, method="covariance-sum"
    )
    draws = draws_of(m, count=400_000, rng=np.random.default_rng(2))
    assert draws is not None
    assert np.median(draws) == pytest.approx(3.1, abs=0.01)
    for interval, levels in ((interval68, (0.16, 0.84)), (interval95, (0.025, 0.975))):
        if interval is not None:
            assert np.quantile(draws, levels) == pytest.approx(interval, abs=0.02)


def test_draws_of_a_gaussian_measurement_are_gaussian() -> None:
    draws = draws_of(mtf50(0.2, 0.01), count=100_000, rng=np.random.default_rng(3))
    assert draws is not None
    scores = (draws - 0.2) / 0.01
    moments = [np.mean(scores), np.mean(scores**2), np.mean(scores**3), np.mean(scores**4)]
    # Standard errors of the moments of 100 000 normal draws: 0.003, 0.0045, 0.012, 0.031.
    assert np.abs(np.subtract(moments, [0, 1, 0, 3])) == pytest.approx(np.zeros(4), abs=0.12)
    assert abs(moments[1] - 1) < 0.0135


def test_the_difference_of_asymmetric_sides_is_as_asymmetric_as_they_are() -> None:
    a = make_measurement("halo_diameter", "px", 40.0, None, (39.0, 44.0), method="series-forward")
    b = make_measurement("halo_diameter", "px", 50.0, None, (50.0, 50.0), method="series-forward")
    found = compared(result(a), result(b)).differences[0]
    assert found.difference == 10.0
    assert found.interval95 == pytest.approx((6.0, 11.0), abs=0.1)


@pytest.mark.parametrize(
    ("quantity", "unit", "better"),
    [
        ("mtf50", "cy/px", True),
        ("tube_snr", "1", True),
        ("read_noise", "e-", False),
        ("ebi", "pe/s/px", False),
        ("halo_diameter", "px", False),
        ("system_gain", "DN/e-", None),
    ],
)
def test_better_is_higher_lower_or_neither(quantity: str, unit: str, better: bool | None) -> None:
    a, b = (
        result(measurement_from_sd(quantity, unit, value, 0.1, method="x"))
        for value in (10.0, 11.0)
    )
    found = compared(a, b).differences[0]
    assert found.probability_greater == pytest.approx(1.0, abs=0.001)
    expected = None if better is None else pytest.approx(float(better), abs=0.001)
    assert found.probability_better == expected


def test_a_suspect_side_makes_the_difference_suspect() -> None:
    a, b = mtf50(0.2), mtf50(0.21).with_(flags=("low-signal",))
    found = compared(result(a), result(b)).differences[0]
    assert (found.status, found.flags) == ("suspect", ("low-signal",))


def test_a_side_without_interval_has_a_difference_and_no_probability() -> None:
    bare = make_measurement("mtf50", "cy/px", 0.2, None, None, method="edge-slanted")
    found = compared(result(bare), result(mtf50(0.25))).differences[0]
    assert found.difference == pytest.approx(0.05)
    assert (found.interval95, found.probability_greater, found.excludes_zero) == (None, None, False)


def test_equal_seeds_give_equal_differences() -> None:
    a, b = result(mtf50(0.2)), result(mtf50(0.21))
    assert compared(a, b) == compared(a, b)


def test_measurements_meet_their_like() -> None:
    def mtf(
        frequency: float, direction: float, method: str = "edge-forward", **fields
    ) -> Measurement:
        return measurement_from_sd(
            "mtf",
            "1",
            0.5,
            0.01,
            method=method,
            frequency_cy_per_px=frequency,
            orientation_deg=direction,
            **fields,
        )

    a = result(
        mtf(0.1, 0.0), mtf(0.2, 0.0), mtf(0.2, 90.0), mtf(0.3, 0.0, stack="edge-1"), mtf(0.4, 0.0)
    )
    b = result(
        mtf(0.2, 89.0),
        mtf(0.1002, 179.0),
        mtf(0.3, 0.0, stack="edge-2"),
        mtf(0.2, 2.0),
        mtf(0.41, 0.0),
    )
    pairs = [
        (one.a.frequency_cy_per_px, one.b.frequency_cy_per_px, one.b.orientation_deg)
        for one in compared(a, b).differences
    ]
    assert pairs == [(0.1, 0.1002, 179.0), (0.2, 0.2, 2.0), (0.2, 0.2, 89.0)]
    assert compared(a, b).unmatched == (2, 2)


def test_of_several_methods_the_same_is_compared() -> None:
    one, other = mtf50(0.20), replace(mtf50(0.21), method="joint")
    found = compared(result(one, other), result(other, one)).differences
    assert [(d.a.method, d.b.method) for d in found] == [
        ("edge-forward", "edge-forward"),
        ("joint", "joint"),
    ]


def test_regions_that_do_not_overlap_are_different_targets() -> None:
    left, right = mtf50(0.20, region=(0, 0, 40, 40)), mtf50(0.25, region=(0, 100, 40, 40))
    moved = [
        replace(m, region=(m.region[0] + 3, m.region[1] - 2, 40, 40))
        for m in (right, left)
        if m.region
    ]
    found = compared(result(left, right), result(*moved)).differences
    assert [one.difference for one in found] == [0.0, 0.0]


def test_nothing_in_common_is_refused() -> None:
    refused = make_refusal("mtf50", "cy/px", "no edge", method="edge-forward")
    with pytest.raises(BadInput, match="a value in both"):
        compared(result(mtf50(0.2)), result(refused))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"mcp_v": 780.0}, {"mcp_v": 790.0}),
        ({"gate_ns": 100.0}, {"gate_ns": 120.0}),
        ({"exposure_s": 0.01}, {"exposure_s": 0.02}),
        ({"illuminance_lux": 1e-4}, {"illuminance_lux": 2e-4}),
        ({"photons_per_px": 100.0}, {"photons_per_px": 105.0}),
        ({"camera_gain_db": 0.0}, {"camera_gain_db": 6.0}),
        ({"automatic_gain": False}, {"automatic_gain": True}),
        ({"wavelength_nm": 530.0}, {"wavelength_nm": 850.0}),
    ],
)
def test_unlike_conditions_are_refused_and_allowed_with_a_flag(one: dict, other: dict) -> None:
    a, b = result(mtf50(0.2)), result(mtf50(0.21))
    sessions = (of(**one), of(**other))
    with pytest.raises(BadInput, match=f"got {next(iter(one))} .* of stack 'flat-1'; `anyway` "):
        compared(a, b, sessions=sessions)
    found = compared(a, b, sessions=sessions, anyway=True)
    assert found.differences[0].flags == ("unlike-conditions",)
    assert found.stacks == 1


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"mcp_v": 780.0}, {"mcp_v": 780.3}),
        ({"illuminance_lux": 1e-4, "illuminance_relative_sd": 0.03}, {"illuminance_lux": 1.05e-4}),
        ({"illuminance_lux": 1e-4, "lamp_a": 1.0}, {"illuminance_lux": 1e-4, "lamp_a": 2.0}),
        ({"temperature_c": 20.0}, {"temperature_c": 25.0}),
        ({"mcp_v": 780.0}, {}),
    ],
)
def test_like_conditions_are_compared(one: dict, other: dict) -> None:
    found = compared(result(mtf50(0.2)), result(mtf50(0.21)), sessions=(of(**one), of(**other)))
    assert found.differences[0].flags == ()


def test_a_condition_of_one_stack_is_no_flag_on_another() -> None:
    frames = np.zeros((2, 8, 8))
    a, b = (
        session(
            [
                stack(frames, "edge", label="edge", mcp_v=780.0),
                stack(frames, "flat", label="flat", mcp_v=v),
            ]
        )
        for v in (780.0, 800.0)
    )
    measured = result(
        mtf50(0.2, stack="edge"),
        measurement_from_sd("snr", "1", 5.0, 0.1, method="x", stack="flat"),
    )
    found = compared(measured, measured, sessions=(a, b), anyway=True)
    assert [one.status for one in found.differences] == ["ok", "suspect"]


def test_another_camera_kind_or_plane_is_unlike() -> None:
    frames = np.zeros((2, 8, 8))
    known = session([stack(frames, "flat")], sensor=load_sensor("pulnix-ag5745ef3"))
    bare = session([stack(frames, "flat")])
    red = replace(bare, stacks=(replace(bare.stacks[0], plane="r"),))
    edge = session([stack(frames, "edge", label="flat")])
    for other, name in ((known, "sensor"), (red, "plane"), (edge, "kind")):
        assert [pair.name for pair in condition_pairs(bare, other) if pair.unlike] == [name]
    assert condition_pairs(known, known) == ()


def test_cameras_without_intensifier_are_distinguished_by_the_manifest(tmp_path: Path) -> None:
    def on_disk(name: str, sensor: str) -> Session:
        folder = tmp_path / name
        folder.mkdir()
        np.save(folder / "flat.npy", np.zeros((2, 8, 8)))
        stacks = '[[stack]]\nlabel = "flat"\nkind = "flat"\nframes = "flat.npy"\n'
        (folder / "session.toml").write_text(f'name = "{name}"\n{sensor}\n{stacks}')
        return open_session(folder)

    bare, known, same = (
        on_disk("a", ""),
        on_disk("b", 'sensor = "emccd-512"'),
        on_disk("c", 'sensor = "emccd-512"'),
    )
    assert [(pair.name, pair.a, pair.unlike) for pair in condition_pairs(bare, known)] == [
        ("sensor", None, True)
    ]
    assert condition_pairs(known, same) == ()


def test_sessions_without_a_common_stack_are_refused() -> None:
    a, b = of(), session([stack(np.zeros((2, 8, 8)), "edge")])
    with pytest.raises(BadInput, match="label of a stack in common, got none"):
        compared(result(mtf50(0.2)), result(mtf50(0.21)), sessions=(a, b))


# Two series of one camera with other steps have the camera in common.


def series(*exposures_s: float, first: int = 1, **conditions: float) -> Session:
    """Flats and darks at exposures, numbered from `first`."""
    frames = np.zeros((2, 8, 8))
    return session(
        [
            stack(frames, kind, label=f"{kind}-{first + n}", exposure_s=exposure_s, **conditions)
            for n, exposure_s in enumerate(exposures_s)
            for kind in ("flat", "dark")
        ]
    )


def of_series(measured: Session) -> Result:
    """Gain and dark signal of a series, and the SNR of each flat: 1000 times its exposure."""
    return result(
        measurement_from_sd("system_gain", "DN/e-", 0.5, 0.01, method="m"),
        measurement_from_sd("dark_signal", "DN", 50.0, 0.1, method="m"),
        *(
            measurement_from_sd(
                "snr", "1", 1e3 * s.conditions.exposure_s, 0.1, method="m", stack=s.label
            )
            for s in measured.of_kind("flat")
        ),
    )


def test_series_with_other_steps_are_compared_by_what_they_have_in_common() -> None:
    a, b = series(0.01, 0.02, 0.04), series(0.01, 0.03, 0.04, 0.08, first=2)
    found = compared(of_series(a), of_series(b), sessions=(a, b))
    assert {d.a.quantity for d in found.differences} == {"system_gain", "dark_signal", "snr"}
    assert found.stacks == 4 and all(not d.flags for d in found.differences)
    # Levels are matched by their exposure, whatever their labels.
    assert [(d.a.stack, d.b.stack) for d in found.find("snr")] == [
        ("flat-1", "flat-2"),
        ("flat-3", "flat-4"),
    ]
    assert all(d.difference == pytest.approx(0.0, abs=1e-9) for d in found.find("snr"))


def test_series_without_a_common_step_have_their_gain_compared_and_no_dark_signal() -> None:
    a, b = series(0.01, 0.02, 0.04), series(0.015, 0.03, 0.06)
    found = compared(of_series(a), of_series(b), sessions=(a, b))
    assert [d.a.quantity for d in found.differences] == ["system_gain"] and found.stacks == 0


def test_series_at_another_gain_are_refused_whatever_their_steps() -> None:
    a, b = series(0.01, 0.02, 0.04, mcp_v=780.0), series(0.01, 0.03, 0.05, mcp_v=800.0)
    with pytest.raises(BadInput, match="got mcp_v 780 and 800"):
        compared(of_series(a), of_series(b), sessions=(a, b))
    with pytest.raises(BadInput, match=r"got exposure_s 0\.01 and 0\.015"):
        short = [series(0.01, 0.02), series(0.015, 0.03)]
        compared(of_series(short[0]), of_series(short[1]), sessions=tuple(short))


def test_stacks_of_one_level_have_no_partner_by_their_level() -> None:
    """Repeats of one exposure under light that is not known are no matter of order."""
    a, b = series(0.01, 0.01, 0.01), series(0.01, 0.01, 0.01, first=4)
    found = compared(of_series(a), of_series(b), sessions=(a, b))
    assert found.find("snr") == () and found.stacks == 0
