"""Whatever a session lacks, the answer is a number, a refusal or one sentence: never a
traceback.
"""

import numpy as np
import pytest

from charact.estimators import noise
from charact.method import Context
from labdata import BadInput, Conditions, FrameStack
from tests.truth.counted_pulses import METHODS, QUICK, session_of

LEVELS = (100.0, 300.0, 600.0)
PLAIN = Conditions()


def frames(rng, signal_dn, count=4, shape=(96, 128), highest=65535.0, number=None):
    """A camera of K = 0.5 DN at a signal."""
    data = (
        100.0
        + 0.5 * rng.poisson(signal_dn / 0.5, (count, *shape))
        + 2.0 * rng.standard_normal((count, *shape))
    )
    stamps = {} if number is None else {"frame_number": np.array(number)}
    return FrameStack(
        data=np.clip(np.rint(data), 0, highest).astype(np.uint16), full_scale_dn=highest, **stamps
    )


def still(code, count=4):
    return FrameStack(data=np.full((count, 96, 128), code, np.uint16))


def session(in_memory, darks, flats):
    """Each of darks and flats is (frames, conditions)."""
    return in_memory(
        [(f"dark-{i}", "dark", *entry) for i, entry in enumerate(darks)]
        + [(f"flat-{i}", "flat", *entry) for i, entry in enumerate(flats)]
    )


def plain(rng, levels=LEVELS, **more):
    return [(frames(rng, level, **more), PLAIN) for level in levels]


CASES = {
    "only darks": lambda r: (plain(r, (0.0,)), []),
    "two darks": lambda r: (plain(r, (0.0, 0.0)), []),
    "only flats": lambda r: ([], plain(r)),
    "one flat": lambda r: ([], plain(r, (300.0,))),
    "two flats": lambda r: ([], plain(r, (300.0, 600.0))),
    "flats of one level": lambda r: ([], plain(r, (300.0, 300.0, 300.0))),
    "a dark and one flat": lambda r: (plain(r, (0.0,)), plain(r, (300.0,))),
    "single frames": lambda r: (plain(r, (0.0,), count=1), plain(r, count=1)),
    "single darks": lambda r: (plain(r, (0.0,), count=1), plain(r)),
    "one flat and a single frame": lambda r: ([], plain(r, (300.0,)) + plain(r, (300.0,), count=1)),
    "pairs": lambda r: (plain(r, (0.0,), count=2), plain(r, count=2)),
    "saturated": lambda r: (plain(r, (0.0,), highest=150.0), plain(r, highest=150.0)),
    "flats as dark as darks": lambda r: (plain(r, (0.0,)), plain(r, (0.0, 0.0, 0.0))),
    "flats darker than darks": lambda r: (plain(r, (500.0,)), plain(r, (0.0, 0.0, 0.0))),
    "8 x 8": lambda r: (plain(r, (0.0,), shape=(8, 8)), plain(r, shape=(8, 8))),
    "8 x 8, one flat": lambda r: ([], plain(r, (300.0,), shape=(8, 8))),
    "3 x 3": lambda r: (plain(r, (0.0,), shape=(3, 3)), plain(r, shape=(3, 3))),
    "one pixel": lambda r: (plain(r, (0.0,), shape=(1, 1)), plain(r, shape=(1, 1))),
    "one row": lambda r: (plain(r, (0.0,), shape=(1, 200)), plain(r, shape=(1, 200))),
    "one column": lambda r: (plain(r, (0.0,), shape=(200, 1)), plain(r, shape=(200, 1))),
    "all still": lambda r: ([(still(10), PLAIN)], [(still(50), PLAIN), (still(90), PLAIN)]),
    "black darks": lambda r: ([(still(0), PLAIN)], []),
    "still darks": lambda r: ([(still(100), PLAIN)], plain(r)),
    "still flats": lambda r: (plain(r, (0.0,)), [(still(300), PLAIN), (still(600), PLAIN)]),
    "still flats alone": lambda r: ([], [(still(300), PLAIN), (still(600), PLAIN)]),
    "gaps": lambda r: (plain(r, (0.0,)), plain(r, number=(0, 5, 50, 51))),
    "numbers that fall": lambda r: (plain(r, (0.0,)), plain(r, number=(9, 5, 3, 1))),
    "no light in the books": lambda r: (
        plain(r, (0.0,)),
        [(frames(r, s), Conditions(photons_per_px=0.0, illuminance_lux=0.0)) for s in LEVELS],
    ),
}


# The methods differ in what the size and number of frames allow, and fields halve the rows; all
# else they share.
OF_EVERY_METHOD = (
    "single frames",
    "pairs",
    "saturated",
    "3 x 3",
    "one pixel",
    "one row",
    "one column",
    "all still",
)
ODD = [(case, "covariance-sum", False) for case in CASES]
ODD += [
    (case, *way)
    for case in OF_EVERY_METHOD
    for way in (("covariance-sum", True), ("variance", False))
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("case", "method", "interlaced"), ODD)
def test_a_session_that_lacks_something_is_answered(seed, case, method, interlaced):
    given = session(session_of, *CASES[case](np.random.default_rng(seed)))
    context = Context(seed=1, quick=True, interlaced=interlaced)
    if interlaced and case in ("one pixel", "one row"):
        with pytest.raises(BadInput, match="two rows"):
            noise.measure(given, method=method, context=context)
        return
    result = noise.measure(given, method=method, context=context)
    gain = next(m for m in result.measurements if m.quantity in ("covariance_gain", "system_gain"))
    if not given.of_kind("dark") or not given.of_kind("flat"):
        assert gain.status != "ok"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("dark", "flat"),
    [
        ({"mcp_v": 700.0}, {"mcp_v": 800.0}),
        ({"camera_gain_db": 0.0}, {"camera_gain_db": 6.0}),
        ({"temperature_c": -20.0}, {"temperature_c": 20.0}),
    ],
)
def test_darks_of_other_conditions_are_unlike(seed, method, dark, flat):
    rng = np.random.default_rng(seed)
    given = session(
        session_of,
        [(frames(rng, 0.0), Conditions(**dark))],
        [(frames(rng, s), Conditions(**flat)) for s in LEVELS],
    )
    result = noise.measure(given, method=method, context=QUICK)
    (gain,) = result.find("system_gain")
    assert "unlike-conditions" in gain.flags


@pytest.mark.parametrize("method", METHODS)
def test_biases_under_timed_flats_leave_the_gain_alone_and_the_efficiency_not(seed, method):
    """Dark current arrives at random as light does: it is on the line of variance over signal."""
    rng = np.random.default_rng(seed)
    lit = [
        (frames(rng, s), Conditions(exposure_s=t, photons_per_px=4.0 * s))
        for t, s in enumerate(LEVELS, start=1)
    ]
    given = session(session_of, [(frames(rng, 0.0), Conditions(exposure_s=0.0))], lit)
    result = noise.measure(given, method=method, context=QUICK)
    (gain,), (efficiency,) = result.find("system_gain"), result.find("quantum_efficiency")
    assert gain.status == "ok"
    assert efficiency.flags == ("unlike-conditions",)
    assert any("exposure_s" in note for note in efficiency.notes)


@pytest.mark.parametrize("method", METHODS)
def test_a_flat_below_its_dark_is_no_read_noise(seed, method):
    rng = np.random.default_rng(seed)
    given = session(session_of, [(frames(rng, 900.0), PLAIN)], [(frames(rng, 0.0), PLAIN)])
    (noise_dn,) = noise.measure(given, method=method, context=QUICK).find("read_noise", unit="DN")
    assert noise_dn.flags == ("dark-mismatch",)
    assert any("exchanged" in note for note in noise_dn.notes)


@pytest.mark.parametrize("method", METHODS)
def test_one_light_that_gives_several_levels_is_contradicted(seed, method):
    """Variance over signal stays: the gain is right, and no number per photon is."""
    rng = np.random.default_rng(seed)
    state = {"exposure_s": 0.01, "photons_per_px": 5000.0}
    lit = [(frames(rng, s), Conditions(**state)) for s in (100.0, 400.0, 900.0, 1600.0)]
    given = session(session_of, [(frames(rng, 0.0), Conditions(exposure_s=0.01))], lit)
    result = noise.measure(given, method=method, context=QUICK)
    (gain,), (efficiency,) = result.find("system_gain"), result.find("quantum_efficiency")
    assert gain.status == "ok"
    assert "agc" in efficiency.flags
    assert any("16" in note and "photons_per_px" in note for note in efficiency.notes)


@pytest.mark.parametrize("method", METHODS)
def test_frames_that_do_not_belong_together_are_bad_input(seed, method):
    rng = np.random.default_rng(seed)
    cut = session(session_of, plain(rng, (0.0,)), plain(rng, shape=(64, 80)))
    with pytest.raises(BadInput, match="one size"):
        noise.measure(cut, method=method, context=QUICK)
    same = session(session_of, plain(rng, (0.0,)), plain(rng, number=(3, 3, 3, 3)))
    with pytest.raises(BadInput, match="must be unique"):
        noise.measure(same, method=method, context=QUICK)
    huge = FrameStack(data=8e15 * rng.random((4, 96, 128)))
    with pytest.raises(BadInput, match="must lie below"):
        noise.measure(session(session_of, [(huge, PLAIN)], []), method=method, context=QUICK)


def test_flats_that_cannot_be_used_leave_no_blur_factor_to_the_darks(seed):
    rng = np.random.default_rng(seed)
    given = session(
        session_of, plain(rng, (0.0,), highest=150.0), plain(rng, (500.0,), highest=150.0)
    )
    assert not noise.measure(given, method="covariance-sum", context=QUICK).find("blur_factor")


@pytest.mark.parametrize("method", METHODS)
def test_darks_alone_that_are_cut_at_zero_have_what_is_lost_in_the_interval(seed, method):
    cut = FrameStack(
        data=np.clip(np.rint(np.random.default_rng(seed).normal(1.0, 3.0, (4, 96, 128))), 0, None)
    )
    result = noise.measure(session(session_of, [(cut, PLAIN)], []), method=method, context=QUICK)
    for name, truth in (("read_noise", 3.0), ("dark_signal", 1.0)):
        (found,) = result.find(name, unit="DN")
        low, high = found.interval95
        assert low < truth < high and any(note.startswith("clipped: ") for note in found.notes)


def test_of_gains_with_as_many_flats_the_brightest_unclipped_one_is_taken_and_named(seed):
    """Three flats at each of three voltages: the first are dim, the last are cut by the highest
    code.
    """
    rng = np.random.default_rng(seed)
    flats = [
        (frames(rng, share * level, highest=1000.0), Conditions(mcp_v=volts))
        for volts, share in ((600.0, 0.1), (700.0, 1.0), (800.0, 10.0))
        for level in LEVELS
    ]
    found = noise.measure(
        session(session_of, plain(rng, (0.0,)), flats), method="variance", context=QUICK
    )
    (gain,) = found.find("system_gain")
    assert any("mcp_v 700" in note for note in gain.notes)
    assert gain.value == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("levels", [(300.0,), LEVELS])
def test_a_dark_of_a_single_frame_is_told_apart_from_no_dark(seed, method, levels):
    rng = np.random.default_rng(seed)
    given = session(session_of, plain(rng, (0.0,), count=1), plain(rng, levels))
    found = noise.measure(given, method=method, context=QUICK).measurements
    told = [sentence for m in found for sentence in (m.reason or "", *m.notes)]
    assert any("excluded (single frame, no noise): dark-0" in sentence for sentence in told)
    assert not any("no dark frames" in sentence for sentence in told)
