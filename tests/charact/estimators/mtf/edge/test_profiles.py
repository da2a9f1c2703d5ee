"""Oversampled profiles, their gradients and the slanted edge: what each gives of an edge of
known blur.
"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies.edge_coverage import measure_mixed_scene
from benchmarks.studies.edge_peers import answers
from charact.estimators import mtf
from charact.estimators.mtf import PreparedEdge, crossing_frequency, edge_parametric, prepare_edge
from charact.estimators.mtf.edge import conventional as edge_slanted
from charact.estimators.mtf.edge import thresholds
from charact.estimators.mtf.edge.fit.edge_maps import apply_phases
from charact.estimators.mtf.edge.pixels import profile
from charact.method import Context
from labdata import FrameStack, read_frames
from tests.truth import EdgeScene, TrueBlur

# The plain slanted-edge estimator on edges of closed form, and what it cannot do told;
# `test_burns` has a real one.


PLAIN = EdgeScene(
    blur=TrueBlur(sigma_px=0.9),
    rows=120,
    cols=100,
    dark_dn=600.0,
    bright_dn=2100.0,
    black_dn=0.0,
    full_scale_dn=4095.0,
    shot_share=0.5,
)


def slanted_result_of(stack):
    return mtf.measure("edge", stack, method="edge-slanted", context=Context(quick=True))


def test_a_clean_edge_is_its_closed_form(seed):
    rng = np.random.default_rng(seed)
    for angle in (5.0, 95.0, 186.0):
        scene = replace(PLAIN, angle_deg=angle, snr=300.0)
        found = slanted_result_of(scene.frames_drawn(rng)).find("mtf50")[0]
        assert found.value == pytest.approx(scene.truth_mtf50, rel=0.02)
        assert found.interval95[0] < scene.truth_mtf50 < found.interval95[1]


def test_the_colour_plane_measured_is_on_record():
    stack = FrameStack(data=PLAIN.mean()[None], plane="b")
    assert all(m.provenance.settings["plane"] == "b" for m in slanted_result_of(stack).measurements)


def test_noise_is_refused_and_a_weak_edge_never_trusted(seed):
    rng = np.random.default_rng(seed)
    noise = slanted_result_of(FrameStack(data=rng.normal(900.0, 100.0, (1, 90, 90))))
    assert all(m.status == "refused" for m in noise.measurements)
    weak = replace(PLAIN, rows=90, cols=90, dark_dn=900.0, bright_dn=1400.0, snr=5.0)
    assert all(m.status != "ok" for m in slanted_result_of(weak.frames_drawn(rng)).measurements)


def test_uneven_light_is_told(seed):
    scene = replace(PLAIN, cols=120, gradient=0.3, snr=100.0)
    found = slanted_result_of(scene.frames_drawn(np.random.default_rng(seed)))
    assert "gradient" in found.find("mtf50")[0].flags


# Bins of an edge: wider ones hold what the narrow ones held, and cost a noisy edge nothing.


QUICK = Context(quick=True)
SCENE = EdgeScene(
    blur=TrueBlur(sigma_px=0.8),
    rows=120,
    cols=80,
    angle_deg=7.0,
    dark_dn=1000.0,
    bright_dn=2000.0,
    shot_share=0.0,
    full_scale_dn=65535.0,
)


def drawn(snr: float, seed: int):
    rng = np.random.default_rng([seed, round(snr)])
    return replace(SCENE, snr=snr, offset_px=float(rng.uniform(-2, 2))).frames_drawn(rng)


def found(snr: float, seed: int) -> PreparedEdge:
    edge = prepare_edge(drawn(snr, seed), None, QUICK)
    assert isinstance(edge, PreparedEdge)
    return edge


@pytest.mark.parametrize(("snr", "wide"), [(5.0, True), (30.0, False)])
def test_bins_are_as_narrow_as_the_noise_lets_them_tell_anything(snr, wide, seed):
    edge = prepare_edge(drawn(snr, seed), None, QUICK, quickly=True)
    assert isinstance(edge, PreparedEdge)
    assert (edge.profile.distance.size < 0.6 * found(snr, seed).profile.distance.size) == wide


def test_wider_bins_move_a_noisy_edge_by_a_small_part_of_its_error(seed, monkeypatch):
    """Six edges at a step of 6 standard deviations: the same number within a sixth of its error, on
    average none.
    """
    moved = []
    for number in range(6):
        stack = drawn(6.0, 100 * seed + number)
        monkeypatch.setattr(
            profile, "THRESHOLDS", replace(thresholds.THRESHOLDS, noisy_step_sd=8.0)
        )
        wide = edge_parametric(stack, context=QUICK).find("mtf50")[0]
        monkeypatch.setattr(
            profile, "THRESHOLDS", replace(thresholds.THRESHOLDS, noisy_step_sd=0.0)
        )
        narrow = edge_parametric(stack, context=QUICK).find("mtf50")[0]
        half = (narrow.interval68[1] - narrow.interval68[0]) / 2
        moved.append((wide.value - narrow.value) / half)
    assert np.std(moved) < 0.17
    assert abs(np.mean(moved)) < 0.1


# The gradient estimator of edges: slopes of light have the transform of the blur, and little
# noise.


LEVELS = {"dark_dn": 1000.0, "bright_dn": 3000.0, "black_dn": 0.0, "full_scale_dn": 4095.0}


def gradient_result_of(frame):
    return mtf.measure("edge", FrameStack(data=frame[None]), method="edge-gradient", context=QUICK)


@pytest.mark.parametrize("angle_deg", [3.3, -7.0, 97.0])
@pytest.mark.parametrize("sigma_px", [0.5, 1.5])
def test_without_noise_the_curve_is_the_transform_of_the_blur(sigma_px, angle_deg):
    """Within 0.4 %: where rows step by nearly an eighth of a pixel, as at 7 degrees, bins are
    filled unevenly.
    """
    pose = {"rows": 128, "cols": 96, "angle_deg": angle_deg, "offset_px": 0.3}
    scene = EdgeScene(blur=TrueBlur(sigma_px=sigma_px), **pose, **LEVELS)
    result = gradient_result_of(scene.mean())
    found, curve = result.find("mtf50")[0], result.curves["mtf"]
    assert found.value == pytest.approx(scene.truth_mtf50, rel=4e-3)
    assert found.status == "ok"
    away = curve.value - scene.blur.mtf(curve.frequency_cy_per_px, angle_deg)
    assert np.sqrt(np.mean(away**2)) < 4e-3


def test_light_outside_the_window_of_the_blur_counts():
    """A tube's tails: a tool that normalises to a window this narrow reads 4 % too much."""
    blur = TrueBlur(form="exponential", frequency_cy_per_px=0.25, exponent=1.1)
    scene = EdgeScene(blur=blur, rows=128, cols=128, **LEVELS)
    found = gradient_result_of(scene.mean()).find("mtf50")[0]
    assert found.value == pytest.approx(scene.truth_mtf50, rel=0.012)


def test_it_stands_noise_better_than_a_differentiated_profile(seed):
    """On the same frames; reference: 2.7 % for the gradient tool and 5.3 % for the profile tool at
    a step of 10 sd.
    """
    wanted = dict.fromkeys(("edge-gradient", "edge-slanted"), seed + 14)
    trials = [trial for one in range(14) for trial in answers(seed + one, 10.0, wanted)]
    rms = {
        name: np.sqrt(
            np.mean([trial.relative_error**2 for trial in trials if trial.method == name])
        )
        for name in ("edge-gradient", "edge-slanted")
    }
    # 2.5 standard errors of an RMS of 14.
    assert rms["edge-gradient"] < 0.031 * (1 + 2.5 / np.sqrt(28))
    assert rms["edge-gradient"] < rms["edge-slanted"]


@pytest.mark.parametrize("method", ["edge-gradient", "edge-slanted"])
def test_plain_intervals_hold_where_noise_makes_the_response_uneven(method, seed):
    """Mixed blurs, noises and light; three standard errors of a share of about 20 are 15 points at
    95 %.
    """
    trials = [trial for one in range(32) for trial in measure_mixed_scene(seed + one, (method,))]
    sure = [trial for trial in trials if trial.status == "ok"]
    assert len(sure) > 12
    assert np.mean([trial.covers95 for trial in sure]) > 0.95 - 0.15
    assert not any(trial.silent for trial in trials)


def test_noise_alone_is_refused(seed):
    frame = 900.0 + 100.0 * np.random.default_rng(seed).standard_normal((90, 90))
    assert all(m.status == "refused" for m in gradient_result_of(frame).measurements)


# The plain estimator against the table that its author made of a real edge, on every colour
# channel.


# Colour plane, as `--plane` takes it, and the column of the table.
CHANNELS = {"r": 1, "g": 2, "b": 3, "luminance": 4}
CONTEXT = Context(quick=True)


@pytest.fixture
def frame(shared_data):
    """One channel of one of the two frames, the second the first turned round."""
    pytest.importorskip("tifffile")
    return lambda name, plane: read_frames(shared_data / "burns_sfrmat3" / name, plane=plane)


@pytest.fixture
def table(shared_data):
    """Burns' own table of sfrmat3 for h_edge.tif: frequency in cy/px, then red, green, blue and
    luminance.
    """
    text = (shared_data / "burns_sfrmat3" / "me.xls").read_text(encoding="latin-1")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("%")]
    return np.array([[float(word) for word in line.split()] for line in lines])


def response_of(stack: FrameStack):
    edge = prepare_edge(stack, None, CONTEXT)
    assert isinstance(edge, PreparedEdge)
    return edge_slanted._estimate_slanted(edge.picture, edge.rows.line)


@pytest.mark.parametrize("name", ["h_edge.tif", "v_edge.tif"])
@pytest.mark.parametrize("plane", CHANNELS)
def test_the_author_s_whole_table_is_reproduced(frame, table, name, plane):
    """Acceptance: MTF50 within 1 % and RMS 0.003 over all frequencies of the table, to 1.004
    cy/px.
    """
    stack = frame(name, plane)
    reference, theirs = table[:, 0], table[:, CHANNELS[plane]]
    found = mtf.measure("edge", stack, method="edge-slanted", context=CONTEXT).find("mtf50")[0]
    assert found.status == "ok"
    assert found.value == pytest.approx(
        crossing_frequency(reference, theirs[None], 0.5)[0], rel=0.01
    )
    ours = response_of(stack)
    assert ours.frequency[1] == pytest.approx(reference[-1] / (len(reference) - 1), rel=1e-3)
    away = np.interp(reference, ours.frequency, ours.values[0]) - theirs
    print(
        f"{name} {plane}: MTF50 {found.value:.4f}, RMS {np.sqrt(np.mean(away**2)):.4f}, worst "
        f"{np.abs(away).max():.4f}"
    )
    assert np.sqrt(np.mean(away**2)) < 0.003


def test_all_eight_ways_to_turn_a_frame_give_the_same_numbers(frame):
    data = frame("h_edge.tif", "g").data[0]
    upright = response_of(FrameStack(data=data[None]))
    for turns in range(4):
        for turned in (np.rot90(data, turns), np.rot90(data, turns)[::-1]):
            other = response_of(FrameStack(data=np.ascontiguousarray(turned)[None]))
            assert np.abs(other.values[0] - upright.values[0]).max() < 1e-6


# Phases of an edge's transfers as they are, whatever the shift.


GRID = np.concatenate([[1e-5, 1e-3], np.linspace(0.01, 4.3, 40)])


def test_phases_of_shifts_near_and_far_are_those_of_numpy(seed):
    """From none to hundreds of turns, and where a quarter begins."""
    rng = np.random.default_rng(seed)
    shift = np.concatenate([[0.0], np.arange(-2.0, 2.01, 0.125), 30.0 * rng.standard_normal(200)])
    modulus, fixed = rng.random((shift.size, GRID.size)), rng.standard_normal((2, GRID.size))
    grid = np.where(GRID > 0.1, GRID, np.round(GRID, 1) + 0.5)
    expected = modulus * (fixed[0] + 1j * fixed[1]) * np.exp(-2j * np.pi * shift[:, None] * grid)
    found = apply_phases(modulus, shift[:, None] * grid, fixed)
    # Turns by the hundred have lost the last three digits before any sine is taken.
    assert found == pytest.approx(np.concatenate([expected.real, expected.imag], axis=1), abs=1e-11)
