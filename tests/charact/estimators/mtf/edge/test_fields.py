"""An edge that moved between the fields of an interlaced frame is measured in each field at its own
place.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import PreparedEdge, edge_gradient, edge_parametric, prepare_edge
from charact.estimators.mtf.edge import checks
from charact.method import Context
from tests.truth import EdgeScene, TrueBlur

INTERLACED = Context(quick=True, interlaced=True)
SCENE = EdgeScene(
    blur=TrueBlur(sigma_px=1.0),
    rows=120,
    cols=100,
    dark_dn=1200.0,
    bright_dn=2700.0,
    snr=40.0,
    shot_share=0.0,
    black_dn=200.0,
    full_scale_dn=65535.0,
)


def drawn(angle_deg, motion_px, seed, **more):
    scene = replace(SCENE, angle_deg=float(angle_deg), motion_px=float(motion_px), **more)
    return scene.truth_mtf50, scene.frames_drawn(np.random.default_rng(seed))


def measured(stack, context=INTERLACED):
    return edge_parametric(stack, context=context).find("mtf50")[0]


# Odd rows move along the rows: an edge at 100 degrees moves by 0.17 px across itself for each.
@pytest.mark.parametrize(
    ("angle_deg", "motion_px"),
    [(6.0, 0.3), (6.0, 1.0), (186.0, 4.0), (130.0, 2.0), (100.0, 4.0), (276.0, 4.0)],
)
def test_motion_between_fields_moves_no_number(angle_deg, motion_px, seed):
    """The same noise on an edge at rest and on one that moved, where half of it falls elsewhere on
    the edge.
    """
    _, still = drawn(angle_deg, 0.0, seed)
    truth, moved = drawn(angle_deg, motion_px, seed)
    before, after = measured(still), measured(moved)
    error = (before.interval68[1] - before.interval68[0]) / 2
    assert after.status == "ok"
    across = abs(motion_px * np.cos(np.deg2rad(angle_deg)))
    assert after.value == pytest.approx(before.value, abs=(0.5 if across < 0.5 else 3.5) * error)
    assert after.value == pytest.approx(truth, abs=4.5 * error)
    assert any("in the two fields" in note for note in after.notes)


@pytest.mark.parametrize("angle_deg", [6.0, 100.0, 186.0, 276.0])
def test_the_displacement_is_found_either_way(angle_deg, seed):
    for motion in (-1.5, 1.5):
        _, stack = drawn(angle_deg, motion, seed)
        edge = prepare_edge(stack, None, INTERLACED, fields_apart=True)
        assert isinstance(edge, PreparedEdge)
        # Along the picture's columns the edge moves by the motion over its direction's cosine
        # there.
        across = motion * np.cos(np.deg2rad(angle_deg)) / np.cos(edge.profile.angle_rad)
        assert abs(edge.rows.line.fields_apart_px) == pytest.approx(abs(across), abs=0.03)


def test_the_displacement_of_lines_along_the_edge_is_found_wherever_its_bins_lie(seed):
    """Bins that lie a fiftieth of a pixel apart made half of it."""
    for number in range(5):
        offset_px = float(np.random.default_rng([seed, number]).uniform(-2.0, 2.0))
        _, stack = drawn(
            251.6, 3.0, 10 * seed + number, snr=20.0, noise_blur_px=0.9, offset_px=offset_px
        )
        edge = prepare_edge(stack, None, INTERLACED, fields_apart=True)
        assert isinstance(edge, PreparedEdge)
        across = 3.0 * np.cos(np.deg2rad(251.6)) / np.cos(edge.profile.angle_rad)
        # At a twentieth of the step the noise leaves 0.03 px.
        assert abs(edge.rows.line.fields_apart_px) == pytest.approx(abs(across), abs=0.15)


def test_fields_of_an_edge_at_rest_are_taken_together(seed):
    for number in range(5):
        _, stack = drawn(6.0, 0.0, 10 * seed + number)
        together, apart = measured(stack, Context(quick=True)), measured(stack)
        assert apart.value == together.value
        assert not any("in the two fields" in note for note in apart.notes)


def test_a_frame_that_is_not_interlaced_has_its_motion_flagged(seed):
    truth, stack = drawn(6.0, 1.0, seed)
    found = measured(stack, Context(quick=True))
    assert "interlace-motion" in found.flags
    assert found.value < 0.95 * truth


def test_methods_that_mix_rows_flag_the_motion_in_interlaced_frames_too(seed):
    _, stack = drawn(6.0, 1.0, seed)
    assert "interlace-motion" in edge_gradient(stack, context=INTERLACED).find("mtf50")[0].flags


@pytest.mark.parametrize("angle_deg", [105.0, 251.6, 290.0])
def test_motion_of_lines_along_the_edge_is_told_in_every_drawing(angle_deg, seed):
    """Some bins of such an edge lie a thousandth of a pixel apart, which told no slope of its
    profile.
    """
    across = 3.0 * abs(np.cos(np.deg2rad(angle_deg)))
    for number in range(5):
        offset_px = float(np.random.default_rng([seed, number]).uniform(-2.0, 2.0))
        _, stack = drawn(
            angle_deg, 3.0, 10 * seed + number, snr=20.0, noise_blur_px=0.9, offset_px=offset_px
        )
        edge = prepare_edge(stack, None, Context(quick=True), quickly=True)
        assert isinstance(edge, PreparedEdge)
        apart_px, error_px = checks.displacement_of_fields(edge)
        # The mean profile is smeared over both places, and its slope a fifth off.
        assert 0.8 * across - 5.0 * error_px < abs(apart_px) < 1.25 * across + 5.0 * error_px
        assert checks.plain("interlace-motion") in checks.edge_findings(
            edge, 0.2, Context(), 0.01, np.inf
        )


@pytest.mark.parametrize("angle_deg", [93.0, 251.6])
def test_lines_along_an_edge_at_rest_scatter_as_noise_lets_them(angle_deg, seed):
    away = []
    for number in range(30):
        offset_px = float(np.random.default_rng([seed, number]).uniform(-2.0, 2.0))
        _, stack = drawn(angle_deg, 0.0, 100 * seed + number, snr=20.0, offset_px=offset_px)
        edge = prepare_edge(stack, None, Context(quick=True), quickly=True)
        assert isinstance(edge, PreparedEdge)
        apart_px, error_px = checks.displacement_of_fields(edge)
        away.append(apart_px / error_px)
    # The root mean square of thirty is known to an eighth.
    assert np.sqrt(np.mean(np.square(away))) == pytest.approx(1.0, abs=0.52)
