"""The bench gives the same frames for the same seed, in any order, and refuses what it cannot
do.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, Conditions, Target, load_camera
from simulate import LabBench
from simulate.virtual_bench import true_sensor

LUX = Conditions(illuminance_lux=1e-4)


@pytest.fixture(scope="module")
def bench(plain) -> LabBench:
    return LabBench(plain(40, 60))


def test_same_seed_gives_same_bytes(bench):
    first, again = (bench.expose("edge", Target(), LUX, frames=2, seed=5).data for _ in range(2))
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != bench.expose("edge", Target(), LUX, frames=2, seed=6).data.tobytes()


def test_a_frame_follows_from_its_own_number(bench):
    run = bench.expose("flat", Target(), LUX, frames=5, seed=5)
    alone = bench.expose("flat", Target(), LUX, frames=1, seed=5, first_frame=3)
    assert run.data[3].tobytes() == alone.data[0].tobytes()
    assert alone.frame_number.tolist() == [3]
    assert alone.time_s[0] == pytest.approx(3 * 2 / 59.94)


@pytest.mark.parametrize(
    ("kind", "target"),
    [("bars", Target(frequency_cy_per_px=0.1)), ("point", Target(pinhole_px=2.0))],
    ids=["bars", "point"],
)
def test_frames_average_to_the_mean_image(bench, kind, target, seed):
    frames = bench.expose(kind, target, LUX, frames=48, seed=seed).data.astype(float)
    mean = bench.mean(kind, target, LUX)
    # Blocks of frames: the screen's glow ties neighbours together.
    blocks = (frames - mean).reshape(6, 8, *mean.shape).mean(axis=1)
    level = blocks.mean(axis=(1, 2))
    assert abs(level.mean()) < 4.5 * level.std(ddof=1) / np.sqrt(6) * 1.4 + 0.02
    spread = frames.std(axis=0, ddof=1)
    worst = np.abs(frames.mean(axis=0) - mean) / (spread / np.sqrt(48) * 1.6 + 0.3)
    assert np.quantile(worst, 0.99) < 4.5


def test_target_stands_where_its_region_says(bench):
    target = Target(pinhole_px=2.0, region=(10, 30, 8, 12))
    image = bench.mean("point", target, Conditions(illuminance_lux=1e-3)) - bench.mean(
        "dark", target, LUX
    )
    row, col = np.indices(image.shape)
    near = image * ((np.abs(row - 13.5) < 5) & (np.abs(col - 35.5) < 6))
    assert (near * (row + 0.5)).sum() / near.sum() == pytest.approx(14.0, abs=0.03)
    # The causal video filter moves it by a fifth of a pixel.
    assert (near * (col + 0.5)).sum() / near.sum() == pytest.approx(36.2, abs=0.15)


def test_light_and_gate_and_voltage_act_as_they_should(bench):
    dark = bench.mean("dark", Target(), Conditions()).mean()
    base = bench.mean("flat", Target(), LUX).mean() - dark
    twice = bench.mean("flat", Target(), Conditions(illuminance_lux=2e-4)).mean() - dark
    assert twice == pytest.approx(2.0 * base, rel=1e-4)
    half_gate = Conditions(illuminance_lux=2e-4, gate_ns=0.5e9 / 59.94)
    closed = bench.mean("dark", Target(), half_gate).mean()
    assert bench.mean("flat", Target(), half_gate).mean() - closed == pytest.approx(base, rel=1e-4)
    lower = Conditions(illuminance_lux=1e-4, mcp_v=720.0)
    assert bench.mean("flat", Target(), lower).mean() - 400.0 == pytest.approx(
        (base + dark - 400.0) * 0.9**10, rel=1e-3
    )


def test_contrast_is_that_of_the_target(plain):
    sensor = plain(80, 160, photocathode__halo_fraction=0.0, photocathode__ebi_lm_per_cm2=0.0)
    image = LabBench(sensor).mean("edge", Target(contrast=0.4, angle_deg=0.0), LUX) - 400.0
    bright, dark = image[:, 150].mean(), image[:, 10].mean()
    assert (bright - dark) / (bright + dark) == pytest.approx(0.4, abs=0.005)


@pytest.mark.parametrize(
    "call",
    [
        {"kind": "flat", "conditions": Conditions()},
        {"kind": "scene", "conditions": LUX},
        {"kind": "bars", "conditions": LUX},
        {"kind": "flat", "conditions": LUX, "frames": 0},
    ],
    ids=["no light", "no such target", "no frequency", "no frames"],
)
def test_impossible_exposures_are_refused(bench, call):
    with pytest.raises(BadInput):
        bench.expose(
            call["kind"], Target(), call["conditions"], frames=call.get("frames", 1), seed=1
        )


def test_frames_of_the_sheets_camera_are_bytes_with_a_black_border_of_nothing(sheet):

    small = replace(sheet, ccd=replace(sheet.ccd, rows=33, columns=48))
    stack = LabBench(small).expose("flat", Target(), LUX, frames=2, seed=1)
    assert stack.data.dtype == np.uint8 and stack.shape == (2, 33, 48)
    assert stack.full_scale_dn == 255.0


def test_progressive_camera_has_one_exposure_a_frame(plain):

    sensor = plain(40, 60)
    progressive = replace(sensor, video=replace(sensor.video, interlaced=False))
    stack = LabBench(progressive).expose("flat", Target(), LUX, frames=3, seed=1)
    interlaced = LabBench(sensor).mean("flat", Target(), LUX).mean() - 400.0
    assert stack.time_s[1] == pytest.approx(1 / 59.94)
    assert LabBench(progressive).mean("flat", Target(), LUX).mean() - 400.0 == pytest.approx(
        interlaced / 2, rel=1e-4
    )


def test_specimens_lie_within_the_sheets_ranges_and_follow_their_seed(sheet, seed):
    known = sheet.parameters()
    drawn = [true_sensor.draw_true_sensor(sheet, seed + n) for n in range(200)]
    assert true_sensor.draw_true_sensor(sheet, seed) == drawn[0]
    assert any(str(seed) in note for note in drawn[0].notes)
    for path in true_sensor.VARIED:
        values = np.array([float(s.parameters()[path]) for s in drawn])
        low, high = known[path].low, known[path].high
        assert low is not None and high is not None
        assert low <= values.min() and values.max() <= high
        assert values.std() > 0.1 * (high - low)


def test_photons_on_the_chip_of_a_camera_without_a_tube_become_their_signal():
    """Level = QE g K photons and its variance F^2 g K level + read noise, by the description's
    numbers alone.
    """
    camera = load_camera("emccd-512")
    camera = replace(camera, ccd=replace(camera.ccd, rows=96, columns=96)).with_values(
        {"ccd.prnu": 0.0, "ccd.smear_fraction": 0.0, "optics.veiling_glare_fraction": 0.0}
    )
    bench, photons, gain = LabBench(camera), 2000.0, 40.0
    conditions = Conditions(exposure_s=0.02, temperature_c=-70.0, em_gain=gain)
    lit = replace(conditions, photons_per_px=photons, wavelength_nm=550.0)
    dark, flat = (
        bench.expose(kind, Target(), given, frames=12, seed=5).data.astype(float)
        for kind, given in (("dark", conditions), ("flat", lit))
    )
    electrons, per_e = photons * 0.92, 0.0817
    signal, expected = flat.mean() - dark.mean(), electrons * gain * per_e
    assert (
        abs(signal - expected)
        < 4.0 * np.sqrt(2.0 * expected * gain * per_e / flat.size) + 1e-3 * expected
    )
    power = (flat.var(axis=0, ddof=1) - dark.var(axis=0, ddof=1)).mean() / signal
    excess = 2.0 * (gain - 1.0) * gain ** -(537.0 / 536.0) + 1.0 / gain
    assert abs(power / (excess * gain * per_e) - 1.0) < 4.0 * np.sqrt(2.0 / (11 * 96**2)) + 0.005
    with pytest.raises(BadInput, match="photons_per_px and wavelength_nm"):
        bench.expose("flat", Target(), conditions, frames=1, seed=1)
