"""One MTF through all targets of a session holds the truth, and a target that tells of another is
found and named.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

from charact.estimators.mtf import (
    FINE,
    REPORTED,
    crossing_frequency,
    curve_of,
    fit_joint_mtf,
    mtf_consistency,
    mtf_uniformity,
    session_curves,
)
from charact.fitting import observations_of, stacks_of
from charact.method import Context
from labdata import (
    Camera,
    Conditions,
    Curve,
    Result,
    StackEntry,
    load_sensor,
    measurement_from_draws,
    measurement_from_sd,
)
from tests.truth.sessions import session_in_memory

QUICK = Context(seed=1, quick=True)
KINDS = {"e": "edge", "b1": "bars", "b2": "bars", "b3": "bars", "p": "point"}
BARS = {"b1": 0.08, "b2": 0.15, "b3": 0.25}


def mtf(frequency, half=0.22, exponent=1.4, height=1.0):
    """exp(-ln 2 (f/f2)^n) times the pixel."""
    return np.exp(-np.log(2) * (np.asarray(frequency) / half) ** exponent) * np.sinc(
        np.asarray(frequency) * height
    )


def target(
    rng, label, *, half=0.22, exponent=1.4, half_sd=0.003, exponent_sd=0.04, name="mtf", angle=0.0
) -> Result:
    """Curve and MTF50 of one target: draws about an estimate that missed the truth by its own
    error.
    """
    centre = np.array([half, exponent]) + rng.standard_normal(2) * [half_sd, exponent_sd]
    drawn = centre + rng.standard_normal((400, 2)) * [half_sd, exponent_sd]
    curve = curve_of(REPORTED, mtf(REPORTED, drawn[:, :1], drawn[:, 1:]))
    level = measurement_from_draws(
        "mtf50",
        "cy/px",
        crossing_frequency(FINE, mtf(FINE, drawn[:, :1], drawn[:, 1:]), 0.5),
        method="fake",
        stack=label,
        orientation_deg=angle,
    )
    return Result(measurements=(level,), curves={f"{name}:{label}": curve})


def bars(rng, *, half=0.22, sd=0.008) -> Result:
    return Result(
        measurements=tuple(
            measurement_from_sd(
                "mtf",
                "1",
                float(mtf(f, half)) + sd * rng.standard_normal(),
                sd,
                method="fake",
                stack=label,
                frequency_cy_per_px=f,
                orientation_deg=3.0,
            )
            for label, f in BARS.items()
        )
    )


def session(rng, **edge) -> Result:
    return target(rng, "e", **edge) + bars(rng) + target(rng, "p")


def evidence(result: Result, kinds=KINDS, context: Context = QUICK) -> dict:
    return fit_joint_mtf(result, kinds, context=context).evidence["joint MTF"]


def test_probabilities_of_one_camera_are_uniform_and_its_interval_holds_the_truth(
    seed: int,
) -> None:
    """Kolmogorov-Smirnov of 12 chances once in ten thousand; 95 % intervals hold within 4 standard
    errors.
    """
    rng = np.random.default_rng(seed)
    chances, held = [], 0
    frequency = np.linspace(0.01, 0.6, 20000)
    truth = float(frequency[np.argmax(mtf(frequency) < 0.5)])
    for _ in range(12):
        found = fit_joint_mtf(session(rng), KINDS, context=QUICK)
        chances.append(found.evidence["joint MTF"]["probability"])
        low, high = found.find("mtf50")[0].interval95
        held += low <= truth <= high
    assert kstest(chances, "uniform").pvalue > 1e-4
    assert held >= 12 * 0.95 - 4 * np.sqrt(12 * 0.95 * 0.05)


def test_an_edge_out_of_focus_is_found_and_named_and_the_joint_number_is_suspect(seed: int) -> None:
    found = fit_joint_mtf(session(np.random.default_rng(seed), half=0.19), KINDS, context=QUICK)
    test = found.evidence["joint MTF"]
    assert not test["inside_joint_95_percent_region"]
    assert test["differs_most"] == "e"
    assert json.loads(json.dumps(test))
    assert all("model-misfit" in m.flags for m in found.measurements)
    assert any("e differs most" in note for note in found.measurements[0].notes)


def test_what_a_target_does_not_vouch_for_takes_no_part(seed: int) -> None:
    rng = np.random.default_rng(seed)
    result = session(rng, half=0.3)
    doubted = Result(
        measurements=tuple(
            m.with_(flags=("gamma",)) if m.stack == "e" else m for m in result.measurements
        ),
        curves=result.curves,
    )
    assert "e" not in evidence(doubted)["target"]
    assert fit_joint_mtf(target(rng, "e"), KINDS, context=QUICK) == Result()


def test_rows_and_columns_have_cores_of_their_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    result = session(rng) + target(rng, "v", half=0.15, angle=88.0)
    found = fit_joint_mtf(result, {**KINDS, "v": "edge"}, context=QUICK)
    across, down = (found.find("mtf50", orientation_deg=angle)[0] for angle in (0.0, 90.0))
    assert found.evidence["joint MTF"]["probability"] > 1e-3
    assert down.value < 0.8 * across.value
    assert set(found.curves) == {"mtf_joint", "mtf_joint_vertical"}


def filtered(frequency, bandwidth_mhz, clock_mhz=14.318):
    """|V| of a third-order Butterworth on stairs one clock wide, read once a clock: its replicas
    summed.
    """
    at = np.asarray(frequency, float)[..., None] + np.arange(-200, 201)
    s = 1j * at * clock_mhz / bandwidth_mhz
    return np.abs(
        np.sum(np.sinc(at) * np.exp(-1j * np.pi * at) / ((1.0 + s) * (1.0 + s + s**2)), axis=-1)
    )


def test_a_video_s_bandwidth_that_is_not_the_described_one_is_found(seed: int) -> None:
    """Two sure edges in windows narrower than the halo: a described filter taken as exact misses
    MTF10.
    """
    sensor, rng, bandwidth_mhz = load_sensor("pulnix-ag5745ef3"), np.random.default_rng(seed), 7.0
    form, sd = np.array([0.35, 1.3]), np.array([1e-3, 8e-3])

    def seen(label: str) -> Result:
        drawn = form + rng.standard_normal(2) * sd + rng.standard_normal((400, 2)) * sd
        curve, fine = (
            mtf(at, drawn[:, :1], drawn[:, 1:]) * filtered(at, bandwidth_mhz)
            for at in (REPORTED, FINE)
        )
        level = measurement_from_draws(
            "mtf50",
            "cy/px",
            crossing_frequency(FINE, fine, 0.5),
            method="fake",
            stack=label,
            orientation_deg=0.0,
        )
        narrow = level.with_(region=(0, 0, 60, 40))
        return Result(measurements=(narrow,), curves={f"mtf:{label}": curve_of(REPORTED, curve)})

    told_of = seen("e1") + seen("e2")
    truth = crossing_frequency(FINE, (mtf(FINE, *form) * filtered(FINE, bandwidth_mhz))[None], 0.1)[
        0
    ]

    def standard_errors_off(of: Camera) -> float:
        context = Context(seed=1, quick=True, camera=of)
        found = fit_joint_mtf(told_of, {"e1": "edge", "e2": "edge"}, context=context).find("mtf10")[
            0
        ]
        low, high = found.interval68
        return abs(found.value - truth) / (0.5 * (high - low))

    exact = sensor.with_values({"video.bandwidth_mhz": float(sensor.video.bandwidth_mhz)})
    assert standard_errors_off(sensor) < 4.0 < standard_errors_off(exact)


def test_the_noise_of_flats_bounds_the_whole_mtf_from_above(seed: int) -> None:
    """A transfer behind the gain above the whole MTF says nothing; one below it cannot be."""
    rng = np.random.default_rng(seed)
    plain = session(rng)

    def with_flats(half: float) -> Result:
        value = mtf(REPORTED, half, 2.0)
        band = np.stack([value - 0.004, value + 0.004])
        return plain + Result(
            curves={
                "mtf_post_gain": Curve(frequency_cy_per_px=REPORTED, value=value, interval68=band)
            }
        )

    high, low = evidence(with_flats(0.4)), evidence(with_flats(0.18))
    assert high["chi_squared"] == pytest.approx(evidence(plain)["chi_squared"], rel=0.01)
    assert low["differs_most"] == "flats"
    assert not low["inside_joint_95_percent_region"]


def edges(rng, slope: float) -> tuple[Result, dict[str, str], dict[str, Conditions]]:
    """Six edges over the columns of a frame; half frequency changes by a slope per pixel."""
    result, columns = Result(), (50, 150, 250, 350, 450, 550)
    for col in columns:
        one = target(rng, f"e{col}", half=0.22 + slope * (col - 300), half_sd=0.004)
        result += Result(
            measurements=tuple(m.with_(region=(100, col - 30, 80, 60)) for m in one.measurements),
            curves=one.curves,
        )
    labels = [f"e{col}" for col in columns]
    return result, dict.fromkeys(labels, "edge"), dict.fromkeys(labels, Conditions(mcp_v=800.0))


def test_an_mtf_that_changes_over_the_field_is_told_from_one_that_does_not(seed: int) -> None:
    """Constant: 30 sessions stay so in 95 %, within 4 standard errors; a slope of 1e-4 is found
    with its size.
    """
    rng = np.random.default_rng(seed)
    name = "MTF50 over the field and settings"

    def table(slope: float) -> dict:
        return mtf_uniformity(*edges(rng, slope), context=QUICK).evidence[name]

    kept = sum(table(0.0)["constant_at_5_percent"] for _ in range(30))
    assert abs(kept - 28.5) < 4 * np.sqrt(30 * 0.95 * 0.05)
    tilted = table(1e-4)
    slope, sd = tilted["slopes"]["col_px"]
    assert not tilted["constant_at_5_percent"]
    assert 0.6e-4 < slope < 1.2e-4
    assert slope > 5 * sd
    assert set(tilted["slopes"]) == {"col_px"}


def test_the_curve_through_the_bars_is_taken_for_no_further_target(seed: int) -> None:
    """Joint fit, agreement, constancy and the sensor's fit say the same with it as without."""
    rng = np.random.default_rng(seed)
    plain = target(rng, "e") + bars(rng) + target(rng, "p")
    read = Result(
        measurements=tuple(
            replace(m, method="bars-forward" if m.stack in BARS else m.method)
            for m in plain.measurements
        ),
        curves=plain.curves,
    )
    own = session_curves(read, KINDS, context=QUICK)
    assert [m.method for m in own.measurements] == ["bars-joint"]
    assert set(own.curves) == {"mtf_bars"}
    assert own.find("mtf50")[0].stack is None
    conditions = {
        label: Conditions(mcp_v=700.0 + 10.0 * place) for place, label in enumerate(KINDS)
    }
    entries = tuple(
        StackEntry(label=label, kind=kind, frames="", folder=Path())
        for label, kind in KINDS.items()
    )
    held = session_in_memory(entries)
    sensor = load_sensor("pulnix-ag5745ef3")

    def said(result: Result) -> str:
        told_of = (
            fit_joint_mtf(result, KINDS, context=QUICK).evidence,
            mtf_consistency(result, KINDS).evidence,
            mtf_uniformity(result, KINDS, conditions, context=QUICK).evidence,
            [
                (one.name, one.value.tolist())
                for one in observations_of(stacks_of(held, sensor, result, ()))
            ],
        )
        return json.dumps(told_of)

    with_it = read + own + fit_joint_mtf(read, KINDS, context=QUICK)
    assert said(with_it) == said(read + fit_joint_mtf(read, KINDS, context=QUICK))
    assert len(json.loads(said(read))[3]) == 5
