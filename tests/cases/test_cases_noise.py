"""Noise sessions of other tools' users, and siblings drawn here: pixels, registers, scales."""

import numpy as np
import pytest

from charact.estimators import noise
from charact.session_measurement import method_context
from labdata import open_session
from labdata.camera import excess_noise_factor
from tests.truth.counted_pulses import one

TUBES = ("tube", "pulse", "photocathode", "photoelectron", "plate", "intensif")


def measured(folder):
    session = open_session(folder)
    return noise.measure(session, context=method_context(session, quick=True, seed=0))


def holds(measurement, truth, within):
    """Whether a number is ok, near the truth, and its interval holds it."""
    low, high = measurement.interval95
    assert measurement.status == "ok", measurement.flags
    assert low <= truth <= high
    assert measurement.value == pytest.approx(truth, rel=within)


def test_two_stuck_pixels_saturate_no_flat(case):
    result = case("b1-two-stuck-pixels")
    holds(one(result, "system_gain"), 0.40, 0.05)
    assert [m.value for m in result.find("defect_pixels")] == [2.0, 2.0]
    assert any("2 defective pixels" in note for note in one(result, "system_gain").notes)


def test_one_stuck_pixel_is_no_lag(case):
    gain = one(case("b2-one-stuck-lag"), "system_gain")
    assert gain.status == "ok" and gain.value == pytest.approx(0.40, rel=0.02)
    assert np.ptp(gain.interval95) < 0.02


def test_cosmic_rays_are_no_read_noise(case):
    result = case("c1-cosmic-rays-read-noise")
    # 2.0 DN and the digitiser's steps.
    holds(one(result, "read_noise", "DN"), np.hypot(2.0, 12.0**-0.5), 0.01)
    holds(one(result, "read_noise", "e-"), 5.0, 0.02)


def test_the_excess_noise_of_a_register_is_divided_out(case):
    result = case("d1-emccd-gain-60")
    holds(one(result, "system_gain"), 3.0, 0.03)
    holds(one(result, "read_noise", "e-"), 0.667, 0.03)
    assert any("Robbins" in note for note in one(result, "system_gain").notes)


@pytest.mark.filterwarnings("error")
def test_frames_from_0_to_1_have_a_gain(case):
    result = case("e1-float-0-to-1")
    holds(one(result, "system_gain"), 9.8e-5, 0.03)
    holds(one(result, "read_noise", "e-"), 5.0, 0.03)
    holds(one(result, "blur_factor"), 1.0, 0.1)
    assert one(result, "read_noise", "DN").status == "ok"


@pytest.mark.parametrize("name", ["i1-column-noise", "m1-bias-and-timed-flats"])
def test_line_noise_and_biases_under_timed_flats_cancel_in_the_slope(case, name):
    holds(one(case(name), "system_gain"), 0.40, 0.02)


def test_neighbours_that_share_two_percent_give_both_gains_and_no_word_of_tubes(case):
    result = case("q1-8-bit-cmos-crosstalk")
    plain, right = one(result, "system_gain"), one(result, "covariance_gain")
    assert plain.flags == ("correlated-noise",)
    assert plain.value == pytest.approx(0.0178, rel=0.02)
    assert right.interval95[0] < 0.0210 < right.interval95[1]
    quantum = one(result, "quantum_efficiency")
    low, high = quantum.interval95
    assert low < 50.0 < high
    # The standard's beside it: 50 % times the ratio of both gains, .0210 over the slope.
    (note,) = [note for note in quantum.notes if "EMVA 1288" in note]
    assert float(note.split(": ")[1].split()[0]) == pytest.approx(58.8, rel=0.02)
    assert np.ptp(plain.interval95) < 0.03 * plain.value
    read = one(result, "read_noise", "DN")
    assert read.status == "ok" and read.value == pytest.approx(0.25, rel=0.02)
    assert any(note.startswith("quantised: ") for note in read.notes)
    said = " ".join(f"{m.reason or ''} {' '.join(m.notes)}" for m in result.measurements).lower()
    assert not [word for word in TUBES if word in said]


def written(
    folder,
    rng,
    *,
    gain=0.4,
    read_e=5.0,
    black=100.0,
    scale=1.0,
    dtype=np.uint16,
    size=(128, 160),
    frames=2,
    levels=(500.0, 1500.0, 3000.0, 5000.0, 8000.0),
    wrong=lambda data: data,
    state="",
    em=1.0,
):
    """A session of a plain camera: electrons, a register, read noise, whole codes, then a scale."""
    lines = ['name = "sibling"']
    for index, level in enumerate((0.0, *levels)):
        charge = rng.poisson(level / em, (frames, *size)).astype(float)
        if em > 1.0:
            charge = np.where(charge > 0, rng.gamma(np.maximum(charge, 1e-9)), 0.0) * em
        codes = np.rint(black + gain * (charge + read_e * rng.standard_normal(charge.shape)))
        data = wrong(np.clip(codes, -1e9 if dtype != np.uint16 else 0, 65535.0)) * scale
        np.save(folder / f"{index}.npy", data.astype(dtype))
        kind = "flat" if index else "dark"
        lines += [
            "[[stack]]",
            f'label = "s{index}"',
            f'kind = "{kind}"',
            f'frames = "{index}.npy"',
            state,
        ]
    (folder / "session.toml").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.parametrize("frames", [2, 5])
@pytest.mark.parametrize("top", [255.0, 60000.0])
def test_half_a_percent_of_stuck_and_blinking_pixels_moves_nothing(tmp_path, seed, frames, top):
    rng = np.random.default_rng(seed)
    places = rng.choice(128 * 160, 100, replace=False)
    gain = 0.4 if top > 255 else 0.02

    def wrong(data):
        flat = data.reshape(len(data), -1)
        flat[:, places[:50]] = top
        flat[:, places[50:]] += 60.0 * gain / 0.4 * (rng.random((len(data), 50)) < 0.5)
        return np.minimum(data, top)

    levels = tuple(
        level * min(1.0, top / 4095.0 * 0.4 / gain)
        for level in (500.0, 1500.0, 3000.0, 5000.0, 8000.0)
    )
    read_e = 5.0 if top > 255 else 40.0
    result = measured(
        written(
            tmp_path,
            rng,
            wrong=wrong,
            frames=frames,
            gain=gain,
            read_e=read_e,
            black=20.0,
            levels=levels,
        )
    )
    holds(one(result, "system_gain"), gain, 0.04)
    holds(one(result, "read_noise", "DN"), np.hypot(read_e * gain, 12.0**-0.5), 0.03)


@pytest.mark.parametrize("frames", [2, 4])
@pytest.mark.parametrize("rate", [1e-4, 7e-4])
def test_hits_in_single_frames_move_nothing(tmp_path, seed, frames, rate):
    rng = np.random.default_rng(seed)

    def wrong(data):
        struck = rng.random(data.shape) < rate
        return data + struck * rng.uniform(200.0, 2000.0, data.shape)

    result = measured(
        written(tmp_path, rng, wrong=lambda data: np.rint(wrong(data)), frames=frames)
    )
    holds(one(result, "system_gain"), 0.4, 0.04)
    holds(one(result, "read_noise", "DN"), np.hypot(2.0, 12.0**-0.5), 0.03)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("scale", "black", "dtype"),
    [
        (1.0 / 4095.0, 100.0, np.float32),
        (16.0, 100.0, np.uint16),
        (1e-3, -500.0, np.float64),
        (2.5e-6, 0.0, np.float64),
    ],
)
def test_every_scale_gives_the_same_electrons(tmp_path, seed, scale, black, dtype):
    """Shares of one, codes shifted to the left, volts, negative numbers: only DN change."""
    result = measured(
        written(tmp_path, np.random.default_rng(seed), scale=scale, black=black, dtype=dtype)
    )
    holds(one(result, "system_gain"), 0.4 * scale, 0.04)
    holds(one(result, "read_noise", "e-"), 5.0, 0.04)
    holds(one(result, "read_noise", "DN"), np.hypot(2.0, 12.0**-0.5) * scale, 0.03)
    assert one(result, "blur_factor").value == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("em", [1.0, 30.0, 500.0])
def test_a_register_that_is_stated_counts(tmp_path, seed, em):
    rng = np.random.default_rng(seed)
    folder = written(
        tmp_path,
        rng,
        em=em,
        state=f"em_gain = {em}",
        read_e=30.0,
        frames=6,
        levels=tuple(em * n for n in (20.0, 40.0, 80.0, 160.0)),
        gain=0.2,
    )
    holds(one(measured(folder), "system_gain"), 0.2 * em, 0.05)


def test_read_noise_includes_that_of_columns_and_names_both(tmp_path, seed):
    rng, columns_dn = np.random.default_rng(seed), 1.5

    def wrong(data):
        return data + columns_dn * rng.standard_normal((len(data), 1, data.shape[2]))

    read = one(measured(written(tmp_path, rng, frames=16, wrong=wrong)), "read_noise", "DN")
    white_dn = np.hypot(2.0, 12.0**-0.5)
    assert read.value == pytest.approx(np.hypot(white_dn, columns_dn), rel=0.03)
    (note,) = (note for note in read.notes if "without it" in note)
    assert "complete columns" in note
    assert float(note.split()[-2]) == pytest.approx(white_dn, rel=0.02)


@pytest.mark.parametrize("depth", [0.0, 0.5])
def test_the_covariance_gain_of_white_noise_is_that_of_its_variance(tmp_path, seed, depth):
    rows, cols = np.meshgrid(np.linspace(-1, 1, 96), np.linspace(-1, 1, 112), indexing="ij")
    vignette = 1.0 - 0.5 * depth * (rows**2 + cols**2)
    levels = [level * vignette for level in (1000.0, 3000.0, 5000.0, 8000.0)]
    rng = np.random.default_rng(seed)
    result = measured(written(tmp_path, rng, frames=4, size=(96, 112), levels=levels))
    gain = one(result, "covariance_gain")
    assert gain.status == "ok" and gain.value == pytest.approx(0.4, rel=0.03)
    low, high = gain.interval95
    # 4.5 standard errors hold it for any seed; the interval is narrow for it.
    assert abs(gain.value - 0.4) < 4.5 * (high - low) / 3.92
    assert high - low < 0.08 * gain.value


@pytest.mark.parametrize("read_dn", [0.15, 0.25])
def test_read_noise_below_the_step_is_bounded_in_electrons_too(tmp_path, seed, read_dn):
    """Of noise far below the step the frames show one or two codes, whatever the noise is."""
    camera = {"gain": 0.05, "read_e": read_dn / 0.05, "black": 100.47, "frames": 4}
    result = measured(written(tmp_path, np.random.default_rng(seed), **camera))
    read = one(result, "read_noise", "e-")
    low, high = read.interval95
    assert read.status == "ok" and low <= camera["read_e"] <= high


def test_excess_noise_of_a_register_lies_between_one_and_two():
    """Robbins & Hadwen (2003): none at unit gain, 2 at high gain of many stages."""
    assert excess_noise_factor(1.0, 536) == pytest.approx(1.0)
    assert excess_noise_factor(1e5) == pytest.approx(2.0, abs=1e-4)
    # By stages of equal chance p of one more electron: F^2 = 1 + (1 - p) / (1 + p) (1 - 1 / g).
    stages, chance = 536, 1000.0 ** (1.0 / 536) - 1.0
    assert excess_noise_factor(1000.0, stages) == pytest.approx(
        1.0 + (1.0 - chance) / (1.0 + chance) * (1.0 - 1e-3), abs=1e-3
    )


def test_a_described_register_counts_without_a_stated_gain(tmp_path, seed):
    rng = np.random.default_rng(seed)
    folder = written(
        tmp_path,
        rng,
        em=1000.0,
        read_e=50.0,
        frames=6,
        gain=0.02,
        levels=tuple(1000.0 * n for n in (20.0, 40.0, 80.0, 160.0)),
    )
    manifest = folder / "session.toml"
    manifest.write_text('sensor = "emccd-512"\n' + manifest.read_text())
    gain = one(measured(folder), "system_gain")
    holds(gain, 20.0, 0.05)
    assert any("description" in note for note in gain.notes)
