"""A sweep of the gain tells the law, the knee and the saturation that a camera was made with, or
says why not.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.gain_sweeps import SweepScene, covered
from charact.estimators import noise
from charact.estimators.noise import KNOBS, Sweep, measure_sweep
from charact.method import Context
from labdata import Conditions
from tests.truth.counted_pulses import QUICK, Pulses, errors, gaussian, one, session_of

VOLTS, LIGHTS = (600.0, 675.0, 750.0, 850.0), (3.0, 10.0, 30.0)
GAIN_DN, EXPONENT, READ_DN, ELECTRON_DN, DARK_PE = 20.0, 10.0, 2.0, 0.05, 0.02
SATURATION_DN = 8000.0


def swept(
    pulses,
    in_memory,
    seed,
    *,
    volts=VOLTS,
    lights=LIGHTS,
    saturation_dn=np.inf,
    exponent=EXPONENT,
    recorded=lambda v: {"mcp_v": v},
    dark_volts=None,
    seen=lambda light: light,
    dark_pe=DARK_PE,
    **camera,
):
    """Frames of a tube at several voltages: counted pulses of exponential heights, tired by their
    own current.
    """
    rng = np.random.default_rng(seed)

    def frames(volts, light, count):
        gain = GAIN_DN * (volts / 800.0) ** exponent
        made = pulses(
            gain_dn=gain / (1.0 + gain * light / saturation_dn),
            transfer=gaussian(0.7),
            shape=(112, 144),
            electron_gain_dn=ELECTRON_DN,
            **{"read_noise_dn": READ_DN, **camera},
        )
        return made.frames(rng, light, count)

    stacks = []
    for v in volts:
        if dark_volts is None or v in dark_volts:
            stacks.append((f"dark-{v}", "dark", frames(v, dark_pe, 12), Conditions(**recorded(v))))
        for light in lights:
            conditions = Conditions(illuminance_lux=light, **recorded(v))
            stacks.append(
                (f"flat-{v}-{light}", "flat", frames(v, seen(light) + dark_pe, 6), conditions)
            )
    return in_memory(stacks)


def measured(session) -> Any:
    return noise.measure(session, method="covariance-sum", context=QUICK)


def told_by(sweep: Sweep, context: Context = QUICK) -> Any:
    return measure_sweep(sweep, context=context)


def true_knee_dn() -> float:
    """Pulses' gain P where (K + S P)(K + P) = r^2 + 1/12, S what the blur leaves of the
    variance.
    """
    f = np.fft.fftfreq(512)
    left = float(np.mean(np.exp(-4.0 * (np.pi * f * 0.7) ** 2)) ** 2)
    roots = np.roots([left, (1 + left) * ELECTRON_DN, ELECTRON_DN**2 - READ_DN**2 - 1 / 12])
    return float(roots.max())


def test_law_knee_saturation_and_excess_noise_are_those_of_the_camera(seed):
    result = measured(swept(Pulses, session_of, seed, saturation_dn=SATURATION_DN))
    exponent, saturation = one(result, "gain_exponent"), one(result, "mcp_saturation")
    knee = true_knee_dn()
    for found, truth in (
        (exponent, EXPONENT),
        (saturation, SATURATION_DN),
        (one(result, "gain_knee", "V"), 800.0 * (knee / 2.0 / GAIN_DN) ** (1.0 / EXPONENT)),
        (one(result, "gain_knee", "DN"), knee + ELECTRON_DN),
    ):
        assert found.status == "ok", found
        assert abs(errors(found, truth)) < 4.5, found
    assert (exponent.interval95[1] - exponent.interval95[0]) < 0.06 * EXPONENT
    excess = result.find("relative_excess_noise_factor")
    assert len(excess) == len(VOLTS) - 1
    assert all(m.status == "ok" and abs(errors(m, 1.0)) < 4.5 for m in excess)
    for m in result.find("covariance_gain", method="gain-sweep"):
        volts = float(m.stack.split("-")[1])
        assert abs(errors(m, ELECTRON_DN + 2.0 * GAIN_DN * (volts / 800.0) ** EXPONENT)) < 4.5
    for m in result.find("responsivity"):
        volts = float(m.stack.split("-")[1])
        assert m.unit == "DN/lx" and m.value == pytest.approx(
            GAIN_DN * (volts / 800.0) ** EXPONENT, rel=0.03
        )


def test_of_40_sweeps_the_intervals_hold_as_often_as_they_say(seed):
    """95 % intervals of 40 sweeps miss at most 6 times, 3 standard errors; those of several numbers
    a sweep, 19 %.
    """
    told: dict[str, list[bool]] = {}
    for name, off, status in covered(40, seed):
        if status == "ok":
            told.setdefault(name, []).append(off <= 1.0)
    assert len(told["gain_exponent 1"]) > 34 and told["gain_exponent 1"].count(False) <= 6
    for name in (
        "gain_knee V",
        "mcp_saturation DN",
        "relative_excess_noise_factor 1",
        "covariance_gain DN",
    ):
        assert len(told[name]) > 6
        assert np.mean(told[name]) > 0.95 - 3.5 * np.sqrt(0.05 * 0.95 / min(len(told[name]), 40)), (
            name
        )


def test_chain_and_quick_estimate_agree():
    sweep, _, _ = SweepScene().drawn(np.random.default_rng(3))
    quick = told_by(sweep)
    slow = told_by(sweep, Context(seed=1))
    for quantity in ("gain_exponent", "mcp_saturation"):
        a, b = one(quick, quantity), one(slow, quantity)
        width = a.interval95[1] - a.interval95[0]
        assert b.posterior.sampler == "emcee" and abs(a.value - b.value) < 0.1 * width
        assert b.interval95[1] - b.interval95[0] == pytest.approx(width, rel=0.2)


def knobbed(name, values, log_gain, *, white=False, seed=1, **scene):
    """A sweep of another knob: settings of the given logarithms of the gain."""
    rng = np.random.default_rng(seed)
    made, _, _ = SweepScene(volts=(800.0,) * len(values), lights=(10.0,), **scene).drawn(
        rng, lit=False
    )
    settings = tuple(
        replace(
            s,
            value=float(v),
            labels=(f"flat-{v}",),
            gain_dn=np.exp(g + 0.02 * rng.standard_normal(1000)),
            log_variance=float(np.log(0.2) + g),
            blur_factor=0.2 + 0.004 * rng.standard_normal(1000),
            white=white,
        )
        for s, v, g in zip(made.settings, values, log_gain, strict=True)
    )
    return Sweep(
        knob=next(k for k in KNOBS if k.name == name), settings=settings, main=float(values[-1])
    )


def test_control_word_of_a_published_tube_doubles_its_gain_every_53_counts():
    """Luminous gain at words 0 to 255 of an intensified camera (physics reference, 8.18): 1.95
    times every 51.
    """
    words, gains = 51.0 * np.arange(6), np.log([2512.0, 5012.0, 9772.0, 19055.0, 36728.0, 70795.0])
    doubling = one(told_by(knobbed("gain_control", words, gains - 6.0)), "gain_doubling")
    assert doubling.status == "ok" and doubling.unit == "count"
    assert doubling.interval95[0] < 51.0 * np.log(2.0) / np.log(1.95) < doubling.interval95[1]
    assert doubling.value == pytest.approx(52.9, abs=0.6)


@pytest.mark.parametrize("true_slope", [1.0, 0.9])
def test_decibels_are_held_against_what_the_camera_does(true_slope):
    stated = np.array([0.0, 6.0, 12.0, 18.0, 24.0])
    sweep = knobbed(
        "camera_gain_db", stated, true_slope * stated * np.log(10) / 20 - 1.0, white=True
    )
    result = told_by(sweep)
    slope = one(result, "gain_slope")
    assert slope.unit == "dB/dB" and abs(errors(slope, true_slope)) < 4.5
    assert slope.interval95[1] - slope.interval95[0] < 0.1
    assert not result.find("mcp_saturation")


def test_a_law_that_bends_is_flagged_and_says_so(seed):
    bent = [
        SweepScene(volts=(v,), exponent=14.0 - 8.0 * (v - 620) / 230, departure=0.0)
        for v in SweepScene().volts
    ]
    settings = tuple(
        scene.drawn(np.random.default_rng([seed, i]))[0].settings[0] for i, scene in enumerate(bent)
    )
    exponent = one(told_by(Sweep(knob=KNOBS[0], settings=settings, main=800.0)), "gain_exponent")
    assert "nonlinear" in exponent.flags and any("is curved by" in note for note in exponent.notes)


def test_a_knee_or_a_saturation_beyond_the_sweep_is_refused_with_its_limit(seed):
    scene = SweepScene(volts=(760.0, 800.0, 830.0), saturation_dn=1e6)
    result = told_by(scene.drawn(np.random.default_rng(seed))[0])
    assert all(
        m.status == "refused" and "below the sweep" in m.reason for m in result.find("gain_knee")
    )
    saturation = one(result, "mcp_saturation")
    assert saturation.status == "refused" and "not reached in the sweep" in saturation.reason


def test_a_camera_that_bends_behind_the_plate_is_not_taken_for_a_plate_that_tires(seed):
    """Response S0/(1 + S0/S_c) of the camera itself: its slope squared falls on the variance, its
    cube on the gain.
    """
    sweep, _, _ = SweepScene(saturation_dn=2500.0, scatter=0.002).drawn(np.random.default_rng(seed))
    settings = tuple(
        replace(s, levels_dn=s.levels_dn * (1.0 - s.signal_dn / 2500.0) ** 2)
        for s in sweep.settings
    )
    plate = one(told_by(sweep), "mcp_saturation")
    camera = one(told_by(replace(sweep, settings=settings)), "mcp_saturation")
    assert plate.status == "ok" and abs(errors(plate, 2500.0)) < 4.5
    assert "nonlinear" in camera.flags


@pytest.mark.parametrize("recorded", [lambda v: {}, lambda v: {"mcp_v": 800.0 + 1e-3 * v}])
def test_where_no_gain_was_turned_or_none_was_recorded_nothing_is_said_of_its_law(seed, recorded):
    session = swept(
        Pulses, session_of, seed, volts=(800.0, 801.0), lights=(5.0, 20.0), recorded=recorded
    )
    assert not any(m.method == "gain-sweep" for m in measured(session).measurements)


def test_a_setting_at_full_scale_is_left_out_and_named(seed):
    session = swept(Pulses, session_of, seed, lights=(10.0, 30.0), full_scale_dn=450.0)
    exponent = one(measured(session), "gain_exponent")
    assert any("at 850 V: every flat is saturated" in note for note in exponent.notes)
    assert abs(errors(exponent, EXPONENT)) < 4.5


def test_darks_of_other_settings_are_told(seed):
    result = measured(
        swept(
            Pulses,
            session_of,
            seed,
            volts=(600.0, 700.0, 850.0),
            lights=(10.0, 30.0),
            dark_volts=(600.0,),
        )
    )
    assert "unlike-conditions" in one(result, "gain_exponent").flags
    assert all(m.status != "ok" for m in result.find("gain_knee"))


def test_a_gain_that_something_else_holds_is_flagged():
    """An automatic gain holds the mean at every light and voltage; in this draw brighter flats have
    less covariance.
    """
    result = measured(swept(Pulses, session_of, 434601851, exponent=0.0, seen=lambda light: 10.0))
    assert one(result, "gain_exponent").status != "ok"
    assert all(
        m.status != "ok"
        for m in result.find("covariance_gain")
        if m.value is None or m.value <= 0.0
    )


def test_steps_of_the_digitiser_larger_than_the_noise_widen_the_gain_and_flag_it(seed):
    """Read noise of 0.15 DN under steps of 1 DN: variance at the lowest gain is off by what the
    steps add.
    """
    session = swept(Pulses, session_of, seed, read_noise_dn=0.15, lights=(3.0, 10.0))
    result = measured(session)
    (lowest,) = [m for m in result.find("responsivity") if m.stack.startswith("flat-600")]
    assert "quantised" in lowest.flags
    exponent = one(result, "gain_exponent")
    assert exponent.status == "ok" and abs(errors(exponent, EXPONENT)) < 4.5
    for m in result.find("relative_excess_noise_factor"):
        assert "quantised" in m.flags or abs(errors(m, 1.0)) < 4.5


def test_without_recorded_light_excess_noise_stays_in_the_gain(seed):
    result = told_by(SweepScene().drawn(np.random.default_rng(seed), lit=False)[0])
    (excess,) = result.find("relative_excess_noise_factor")
    assert excess.status == "refused" and "photons_per_px" in excess.reason
