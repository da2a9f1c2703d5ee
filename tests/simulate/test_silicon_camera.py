"""A camera without a tube: Poisson charge, a register that doubles the variance, dark patterns,
clocked charge.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, Conditions, load_camera
from simulate.camera import (
    CameraModel,
    Ccd,
    Register,
    StageImage,
    mcp_input_from_photoelectrons,
    pattern,
)

COLD = Conditions(temperature_c=-70.0)


@pytest.fixture
def description():
    shipped = load_camera("emccd-512")
    return replace(shipped, ccd=replace(shipped.ccd, rows=120, columns=160)).with_values(
        {"ccd.prnu": 0.0, "ccd.smear_fraction": 0.0}
    )


def _frames(
    camera: CameraModel, level: float, conditions: Conditions, seed: int, count: int = 20
) -> np.ndarray:
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, level), conditions)
    stream = camera.frames(light, conditions, seed=seed)
    return np.stack([next(stream) for _ in range(count)]).astype(float)


def _moments(gain: float, stages: int, inputs: int, seed: int, shape: float = 1.0) -> np.ndarray:
    register = Register(gain=gain, stages=stages, pulse_height_shape=shape)
    light = StageImage(values=np.full((400, 500), inputs, np.float32))
    return register.draw(light, np.random.default_rng(seed)).values.astype(float)


@pytest.mark.parametrize(
    ("gain", "stages"), [(1.0, 500), (1.3, 50), (4.0, 200), (300.0, 536), (1000.0, 536)]
)
@pytest.mark.parametrize("inputs", [1, 7])
def test_register_has_its_gain_and_the_excess_noise_of_its_stages(gain, stages, inputs, seed):
    """Robbins and Hadwen's F^2; each electron's output has the variance G^2 (F^2 - 1)."""
    out = _moments(gain, stages, inputs, seed)
    factor = Register(gain=gain, stages=stages).excess_noise_factor
    spread = np.sqrt(inputs * gain**2 * (factor - 1.0))
    assert (
        abs(out.mean() - gain * inputs) <= 4.5 * spread / np.sqrt(out.size) + 1e-6 * gain * inputs
    )
    squares = (out - gain * inputs) ** 2
    assert (
        abs(squares.mean() - spread**2)
        <= 4.5 * squares.std() / np.sqrt(out.size) + 1e-6 * spread**2
    )


def test_register_is_that_of_electrons_multiplied_stage_by_stage(seed):
    """Event by event: in each of 100 stages every electron frees another with the same small
    probability.
    """
    stages, gain, events = 100, 12.0, 60_000
    chance = gain ** (1.0 / stages) - 1.0
    rng = np.random.default_rng(seed)
    electrons = np.full(events, 3)
    for _ in range(stages):
        electrons = electrons + rng.binomial(electrons, chance)
    ours = _moments(gain, stages, 3, seed).ravel()
    relative = (electrons - 3 * gain) ** 2
    variance = 3 * gain**2 * (Register(gain=gain, stages=stages).excess_noise_factor - 1.0)
    assert abs(relative.mean() - variance) < 4.5 * relative.std() / np.sqrt(events)
    for level in (0.05, 0.5, 0.95, 0.99):
        assert np.quantile(ours, level) == pytest.approx(
            np.quantile(electrons, level), rel=0.04, abs=1.0
        )


def test_clamp_takes_the_mean_of_dark_and_clocked_charge_and_leaves_their_noise(seed):
    register = Register(gain=50.0, stages=536, clock_induced_e=2.0, dark_e=3.0)
    wells = StageImage(
        values=np.random.default_rng(seed).poisson(3.0, (500, 500)).astype(np.float32)
    )
    out = register.draw(wells, np.random.default_rng(seed + 1)).values.astype(float)
    expected = 50.0**2 * register.excess_noise_factor * 5.0
    assert abs(out.mean()) < 4.5 * np.sqrt(expected / out.size)
    squares = out**2
    assert abs(squares.mean() - expected) < 4.5 * squares.std() / np.sqrt(out.size)


def test_excess_noise_grows_from_one_to_two():
    factors = [Register(gain=gain).excess_noise_factor for gain in (1.0, 2.0, 10.0, 1000.0)]
    assert factors == sorted(factors)
    assert factors[0] == pytest.approx(1.0, abs=1e-12)
    assert factors[-1] == pytest.approx(2.0, abs=0.04)


@pytest.mark.parametrize("em_gain", [1.0, 300.0])
@pytest.mark.parametrize("level", [0.5, 20.0])
def test_photon_transfer_of_an_emccd(description, em_gain, level, seed):
    """Variance K^2 (G^2 F^2 (n + dark + clocked) + r^2) + 1/12, with F^2 = 1 where nothing
    multiplies.
    """
    camera = CameraModel(description)
    conditions = replace(COLD, em_gain=em_gain)
    frames = _frames(camera, level, conditions, seed)
    dn_per_e = float(description.video.conversion_gain_dn_per_e)
    register = camera.chain(conditions).stages[4]
    assert isinstance(register, Register)
    electrons = level + register.dark_e + register.clock_induced_e
    expected = dn_per_e**2 * (
        em_gain**2 * register.excess_noise_factor * electrons
        + float(description.ccd.read_noise_e) ** 2
    )
    black = float(description.video.black_level_dn)
    signal = frames.mean() - black
    assert (
        abs(signal - dn_per_e * em_gain * level)
        < 4.5 * np.sqrt(expected / frames.size) + 1e-4 * signal
    )
    squares = (frames - frames.mean()) ** 2
    assert (
        abs(squares.mean() - expected - 1 / 12)
        < 4.5 * squares.std() / np.sqrt(squares.size) + 1e-3 * expected
    )


def test_frames_follow_from_their_number_alone(description):
    camera = CameraModel(description)
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 2.0), COLD)
    run = camera.frames(light, COLD, seed=3)
    third = [next(run) for _ in range(4)][3]
    alone = next(camera.frames(light, COLD, seed=3, first_frame=3))
    assert third.tobytes() == alone.tobytes()
    assert alone.dtype == np.uint16


def test_dark_signal_is_fixed_positive_and_of_its_spread():
    dark = pattern.dark_signal_map((400, 500), 16.0, 5.0, 9)
    assert dark.mean(dtype=float) == pytest.approx(16.0, rel=0.01)
    assert dark.std(dtype=float) == pytest.approx(5.0, rel=0.02)
    assert dark.min() > 0.0
    assert np.array_equal(dark, pattern.dark_signal_map((400, 500), 16.0, 5.0, 9))


def test_dark_pattern_stays_from_frame_to_frame_and_is_in_the_mean(seed):
    ccd = Ccd(quantum_efficiency=0.5, full_well_e=1e5, dark_e=40.0, dsnu_e=5.0, pattern_seed=2)
    nothing = StageImage(values=np.zeros((60, 80), np.float32))
    rng = np.random.default_rng(seed)
    average = np.mean([ccd.draw(nothing, rng).values for _ in range(400)], axis=0)
    mean = ccd.mean(nothing).values
    assert mean.std(dtype=float) == pytest.approx(5.0, rel=0.05)
    assert (average - mean).std() == pytest.approx(np.sqrt(40.0 / 400), rel=0.05)


def test_dark_pattern_doubles_with_the_dark_current(description):
    doubling = float(description.ccd.dark_current_doubling_k)
    camera = CameraModel(description)
    cold, warm = (camera.chain(Conditions(temperature_c=t)).stages[3] for t in (0.0, doubling))
    assert isinstance(cold, Ccd) and isinstance(warm, Ccd)
    assert warm.dsnu_e == pytest.approx(2.0 * cold.dsnu_e) and warm.dark_e == pytest.approx(
        2.0 * cold.dark_e
    )


def test_exposure_and_gain_out_of_reach_are_refused(description):
    camera = CameraModel(description)
    for conditions in (
        Conditions(em_gain=2000.0),
        Conditions(exposure_s=0.0),
        Conditions(exposure_s=1.0),
        Conditions(automatic_gain=True),
        Conditions(mcp_v=800.0),
        Conditions(gain_control=100.0),
    ):
        with pytest.raises(BadInput):
            camera.chain(conditions)


@pytest.mark.parametrize(
    "change", [{"gain": 0.5}, {"gain": np.inf}, {"stages": 0}, {"clock_induced_e": -1.0}]
)
def test_impossible_registers_are_refused(change):
    with pytest.raises(BadInput):
        Register(**change)


def test_a_pattern_beyond_the_dark_charge_is_of_offsets_without_hot_pixels():
    ccd = Ccd(quantum_efficiency=0.5, full_well_e=1e5, dark_e=0.6, dsnu_e=1.2, pattern_seed=2)
    level = ccd.mean(StageImage(values=np.zeros((300, 400), np.float32))).values.astype(float)
    assert level.std() == pytest.approx(1.2, rel=0.02)
    # Exponential charge of 0.6 e- has an excess kurtosis of 6, offsets none: 6 (0.6 / 1.2)^4
    # together.
    assert np.mean((level - level.mean()) ** 4) / level.var() ** 2 - 3.0 == pytest.approx(
        6.0 / 16.0, abs=0.15
    )
