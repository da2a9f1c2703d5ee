"""Dark current and its doubling are those of thermal electrons counted here; what cannot be told is
refused.
"""

import numpy as np
import pytest

from charact.estimators import noise
from labdata import Conditions, FrameStack
from tests.truth.counted_pulses import QUICK, errors, session_of

GAIN_DN = 0.5
CURRENT_E_PER_S = 40.0
DOUBLING_K = 7.0
REFERENCE_C = 25.0
EXPOSURES_S = (0.1, 0.3, 0.6, 1.0, 1.5, 2.0)


def dark(rng, exposure_s, temperature_c=REFERENCE_C, *, drift_dn=0.0, shape=(96, 128), count=4):
    """Thermal electrons of unequal pixels above an offset, read with noise."""
    current = CURRENT_E_PER_S * 2.0 ** ((temperature_c - REFERENCE_C) / DOUBLING_K)
    unequal = np.random.default_rng(3).gamma(4.0, 0.25, shape)
    electrons = rng.poisson(current * exposure_s * unequal / unequal.mean(), (count, *shape))
    moved = drift_dn * np.linspace(-0.5, 0.5, count)[:, None, None]
    read = 100.0 + GAIN_DN * electrons + 2.0 * rng.standard_normal((count, *shape)) + moved
    return FrameStack(data=np.rint(read).astype(np.uint16))


def flat(rng, electrons, shape=(96, 128)):
    read = (
        100.0
        + GAIN_DN * rng.poisson(electrons, (4, *shape))
        + 2.0 * rng.standard_normal((4, *shape))
    )
    return FrameStack(data=np.rint(read).astype(np.uint16))


def measured(
    in_memory, rng, exposures_s=EXPOSURES_S, temperatures_c=(REFERENCE_C,), flats=True, **more
):
    stacks = [
        (
            f"dark-{t}-{c}",
            "dark",
            dark(rng, t, c, **more),
            Conditions(exposure_s=t, temperature_c=c),
        )
        for c in temperatures_c
        for t in exposures_s
    ]
    if flats:
        stacks += [
            (
                f"flat-{e}",
                "flat",
                flat(rng, e),
                Conditions(exposure_s=0.1, temperature_c=REFERENCE_C),
            )
            for e in (500.0, 1500.0, 3000.0, 5000.0)
        ]
    return noise.measure(in_memory(stacks), method="variance", context=QUICK)


def test_dark_current_is_the_rise_of_the_level_with_the_exposure(seed):
    result = measured(session_of, np.random.default_rng(seed))
    (in_dn,), (in_e,) = (result.find("dark_current", unit=unit) for unit in ("DN/s", "e-/s"))
    assert (in_dn.status, in_e.status) == ("ok", "ok")
    assert abs(errors(in_dn, GAIN_DN * CURRENT_E_PER_S)) < 4.5
    assert abs(errors(in_e, CURRENT_E_PER_S)) < 4.5
    # Known to some permille: 12,288 pixels of four frames at the longest exposure.
    assert in_dn.interval95[1] - in_dn.interval95[0] < 0.05 * in_dn.value
    assert "25.0 degrees" in in_dn.notes[0]


def test_it_doubles_at_the_temperature_step_that_was_put_in(seed):
    result = measured(
        session_of,
        np.random.default_rng(seed),
        temperatures_c=(15.0, 20.0, 25.0, 30.0),
        flats=False,
    )
    (doubling,) = result.find("dark_doubling_temperature")
    assert doubling.status == "ok"
    assert abs(errors(doubling, DOUBLING_K)) < 4.5
    assert doubling.interval95[1] - doubling.interval95[0] < 0.1 * DOUBLING_K


@pytest.mark.parametrize(
    ("more", "quantity", "word"),
    [
        ({"exposures_s": (1.0,)}, "dark_current", "two exposures"),
        ({}, "dark_doubling_temperature", "two temperatures"),
        (
            {"exposures_s": (1e-4, 2e-4), "temperatures_c": (15.0, 25.0)},
            "dark_doubling_temperature",
            "longer expos",
        ),
    ],
)
def test_what_the_darks_do_not_tell_is_refused_in_a_sentence(seed, more, quantity, word):
    found = measured(session_of, np.random.default_rng(seed), flats=False, **more).find(quantity)
    assert [m.status for m in found] == ["refused"]
    assert word in found[0].reason


def test_electrons_need_a_gain(seed):
    (found,) = measured(session_of, np.random.default_rng(seed), flats=False).find(
        "dark_current", unit="e-/s"
    )
    assert found.status == "refused" and "system gain" in found.reason


def test_a_camera_that_warms_up_while_it_is_read_is_told(seed):
    (found,) = measured(session_of, np.random.default_rng(seed), flats=False, drift_dn=8.0).find(
        "dark_current", unit="DN/s"
    )
    low, high = found.interval95
    assert low < GAIN_DN * CURRENT_E_PER_S < high
    assert any(note.startswith("drift: ") and "widened" in note for note in found.notes)


def test_an_interval_of_95_percent_holds_the_truth_as_often(seed):
    """Levels move by more than their noise from stack to stack, as they do: Student's law allows
    for it.
    """
    rng = np.random.default_rng(seed)
    held, repeats = 0, 30
    for _ in range(repeats):
        stacks = []
        for exposure_s in EXPOSURES_S:
            frames = dark(rng, exposure_s, shape=(24, 32)).data.astype(np.float32) + rng.normal(
                0.0, 0.5
            )
            stacks.append(
                (
                    f"dark-{exposure_s}",
                    "dark",
                    FrameStack(data=frames),
                    Conditions(exposure_s=exposure_s),
                )
            )
        (found,) = noise.measure(session_of(stacks), method="variance", context=QUICK).find(
            "dark_current", unit="DN/s"
        )
        low, high = found.interval95
        held += low <= GAIN_DN * CURRENT_E_PER_S <= high
    assert held >= 0.95 * repeats - 4.5 * np.sqrt(0.95 * 0.05 * repeats)


def test_rounding_of_quiet_darks_is_in_the_interval(seed):
    """Noise of 0.2 DN about levels that rise by 0.4 DN; rounding moves each by half a step."""
    rng = np.random.default_rng(seed)
    stacks = [
        (
            f"dark-{t}",
            "dark",
            FrameStack(
                data=np.rint(100.3 + 0.2 * t + 0.2 * rng.standard_normal((8, 48, 64))).astype(
                    np.uint16
                )
            ),
            Conditions(exposure_s=t),
        )
        for t in (0.1, 1.0, 2.0)
    ]
    result = noise.measure(session_of(stacks), method="variance", context=QUICK)
    (current,) = result.find("dark_current", unit="DN/s")
    assert any(note.startswith("quantised: ") for note in current.notes)
    assert current.interval95[0] < 0.2 < current.interval95[1]
