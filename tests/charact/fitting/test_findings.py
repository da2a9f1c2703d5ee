"""The fit says what flags of measurements, a misfit and coarse grey values speak of."""

import numpy as np
import pytest

from charact.estimators.noise import step_finding
from charact.fitting import findings_of, misfit_finding, observation
from charact.frames import FEWEST_DIFFERENCES, rounding_step
from charact.session_measurement import measure_noise, method_context
from labdata import FLAGS, FrameStack, Measurement, Result, Session, measurement_from_sd
from tests.truth.sessions import session_in_memory, stack_in_memory


def measured(
    quantity: str, *flags: str, stack: str | None = None, notes: tuple[str, ...] = ()
) -> Measurement:
    return measurement_from_sd(
        quantity, "DN", 1.0, 0.1, method="m", flags=flags, notes=notes, stack=stack
    )


def test_a_flag_of_the_flats_is_a_finding_and_that_of_an_edge_counts_only_without() -> None:
    flat = measured(
        "covariance_gain",
        "nonlinear",
        notes=("of a pixel", "nonlinear: it bends by 9 %; what settles it: x"),
    )
    edge = measured("noise_t", "gamma", stack="edge")
    found = findings_of(Result(measurements=(flat, edge)))
    assert [one.flag for one in found] == ["nonlinear"]
    assert found[0].effect.endswith(": it bends by 9 %")
    assert [one.flag for one in findings_of(Result(measurements=(edge,)))] == ["gamma"]
    # What frames and targets lack says nothing of the camera.
    few = measured("read_noise", "too-few-frames", "quantised", "model-misfit")
    assert findings_of(Result(measurements=(few,))) == ()
    assert set(observation.CAUSES) <= set(FLAGS)


def test_a_misfit_names_its_observation_and_what_that_speaks_of() -> None:
    found = misfit_finding({"levels": 3.0, "image lag": 90.0}, 12, 2.8)
    assert found.flag == "model-misfit"
    assert "chi-squared 93 for 12 numbers, 90 of it from image lag" in found.effect
    assert observation.CAUSES_OF_MISFIT["image lag"].stage in found.effect
    assert "may come from" not in misfit_finding({"halo diameter": 90.0}, 12, 2.8).effect


def session_of_codes(codes: np.ndarray) -> Session:
    entry = stack_in_memory("dark", FrameStack(data=codes), bit_depth=12)
    return session_in_memory((entry,), bit_depth=12)


@pytest.mark.parametrize(
    ("step", "sd", "found"), [(1, 20.0, False), (16, 20.0, True), (16, 400.0, False)]
)
def test_grey_values_that_are_multiples_are_found_where_their_rounding_adds_noise(
    step: int, sd: float, found: bool, seed: int
) -> None:
    values = 2000.0 + sd * np.random.default_rng(seed).standard_normal((2, 64, 80))
    codes = (step * np.floor(values / step)).astype(np.uint16)
    assert rounding_step([codes[0]], FEWEST_DIFFERENCES) == step
    finding = step_finding(session_of_codes(codes))
    assert (finding is not None) == found
    if finding is not None:
        # (16^2 - 1) / 12 DN^2.
        assert "multiples of 16 DN: rounding adds 21.2 DN2" in finding.effect


def test_few_grey_values_show_no_step() -> None:
    frame = np.array([[16, 32], [48, 64]], np.uint16)
    assert rounding_step([frame, frame], FEWEST_DIFFERENCES) is None
    assert step_finding(session_of_codes(np.stack([frame, frame]))) is None
    # Six more from other stacks are enough.
    assert rounding_step([frame, frame, frame], FEWEST_DIFFERENCES) == 16
    assert rounding_step([np.arange(0.0, 64.0, 4.0)]) == 4
    assert rounding_step([]) is None
    # Differences of 2 and 3 have no divisor in common.
    assert rounding_step([np.cumsum([2, 3] * 6)]) == 1


def test_coarse_grey_values_add_their_rounding_to_the_read_noise_and_are_named(seed: int) -> None:
    """Of a noise beyond half a step s the variance is larger by s^2 / 12."""
    values = 2000.0 + 20.0 * np.random.default_rng(seed).standard_normal((16, 64, 80))
    plain, found = (
        next(
            m
            for m in measure_noise(one, context=method_context(one, quick=True, seed=seed)).find(
                "read_noise"
            )
            if m.unit == "DN"
        )
        for one in (
            session_of_codes((step * np.floor(values / step)).astype(np.uint16)) for step in (1, 16)
        )
    )
    assert plain.flags == ()
    assert found.flags == ("quantised",)
    assert plain.value is not None
    assert found.value is not None
    error = 4.5 * np.sqrt(2.0 / (15 * 64 * 80))
    assert plain.value**2 == pytest.approx(400.0 + 1.0 / 12.0, rel=error)
    assert found.value**2 == pytest.approx(400.0 + 16.0**2 / 12.0, rel=error)
