"""Objective MRTD: the constant, the worked examples, and edges of drawn cameras."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.infrared import FOUR_BARS, mrtd, scan_directions
from charact.method import Context
from charact.session_measurement import measure
from labdata import FrameStack, Target, load_camera
from tests.truth.infrared import (
    NOISE_K,
    Camera,
    blackbody_session,
    edge_frames,
    entry,
)

WHITE = {name: 0.1 * (name == "tvh") for name in NOISE_K}


def diffraction(f_cy_per_mm, wavelength_um, f_number):
    x = f_cy_per_mm * wavelength_um * 1e-3 * f_number
    return 2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x * x))


def test_the_constant_is_that_of_four_bars():
    assert pytest.approx(0.6594, abs=5e-5) == FOUR_BARS


def test_worked_example_of_a_scanner():
    """0.1 K, 1.8 mrad, 30 frames/s; MTF of footprint, 1.5 MHz and 0.3 mrad: within 2 % of the
    sheet's numbers.
    """
    f = np.array([0.05, 0.1, 0.2, 0.25])
    found = mrtd(f, [0.938, 0.790, 0.467, 0.338], 0.1, frame_rate_hz=30.0, footprint=1.8)
    assert found == pytest.approx([0.0065, 0.0153, 0.0519, 0.0896], rel=0.02)


@pytest.mark.parametrize(
    ("pitch_um", "um", "f_number", "netd_k", "rate_hz", "sheet"),
    [
        (17.0, 10.0, 1.0, 0.040, 30.0, [0.0038, 0.0092, 0.0178, 0.0335]),
        (15.0, 4.0, 2.5, 0.018, 60.0, [0.0012, 0.0030, 0.0060, 0.0115]),
    ],
)
def test_worked_examples_of_arrays(pitch_um, um, f_number, netd_k, rate_hz, sheet):
    """Quarters of Nyquist, MTF of diffraction and pixel; the sheet has two or three digits."""
    f = np.array([0.125, 0.25, 0.375, 0.5])
    mtf = diffraction(f / pitch_um * 1e3, um, f_number) * np.sinc(f)
    assert mrtd(f, mtf, netd_k, frame_rate_hz=rate_hz) == pytest.approx(sheet, rel=0.02, abs=5e-5)


@pytest.fixture(scope="module")
def session():
    rng = np.random.default_rng(47)
    camera = Camera(shape=(8, 80, 80), noise_k=WHITE)
    half_moon = entry(
        "edge", "edge", edge_frames(camera, rng, 0.0, blur_px=0.8), target=Target(angle_deg=5.0)
    )
    return blackbody_session(camera, rng, (18.0, 22.0, 26.0), more=(half_moon,))


@pytest.fixture(scope="module")
def result(session):
    return measure(session, quick=True, seed=1)


def test_an_edge_gives_mrtd_by_netd_and_mtf(result):
    """A Gaussian blur of 0.8 px and 0.1 K, at 30 frames/s by time stamps; the interval is that of
    NETD and MTF.
    """
    netd_k = np.hypot(0.1, 1.0 / np.sqrt(12.0) / 20.0)
    for f in (0.125, 0.25):
        (found,) = result.find("mrtd", frequency_cy_per_px=f)
        expected = (
            0.6594
            * 2.5
            * netd_k
            * f
            / (np.exp(-2.0 * (np.pi * 0.8 * f) ** 2) * np.sqrt(0.2 * 30.0))
        )
        assert (found.status, found.unit, found.stack) == ("ok", "K", "edge")
        assert found.value == pytest.approx(expected, rel=0.03)
        assert found.interval95[0] < expected < found.interval95[1]
    assert any("STANAG 4349" in note for note in found.notes)
    assert any("30 frames/s" in note and "one pixel" in note for note in found.notes)


def test_what_is_missing_is_named(session, result):
    flats = tuple(entry for entry in session.stacks if entry.kind == "flat")
    (no_edge,) = measure(replace(session, stacks=flats), quick=True).find("mrtd")
    assert "add an edge stack (a half-moon plate" in no_edge.reason
    (one,) = measure(replace(session, stacks=flats[:1]), quick=True).find("mrtd")
    assert "needs the NETD" in one.reason
    assert "two or more black-body levels" in one.reason
    (found,) = result.find("sitf")
    assert not result.find("system_gain"), "flats of a black body are no photon transfer"
    assert found.status == "ok"


def test_scan_directions_are_rows_of_one_sweep():
    """Rows 4 n and 4 n + 1 go right, 4 n + 2 and 4 n + 3 left; both keep their fields, at twice the
    row pitch.
    """
    rows = np.broadcast_to(np.arange(482.0)[:, None], (2, 482, 20))
    context = Context(camera=load_camera("scanning-lwir"), interlaced=True)
    parts = list(scan_directions(FrameStack(data=rows), (8, 2, 40, 10), context=context))
    (right, to_right, cut, own), (left, to_left, _, _) = parts
    assert (right, left, cut) == ("to the right", "to the left", (4, 2, 20, 10))
    assert to_right.data[0, :4, 0].tolist() == [0, 1, 4, 5]
    assert to_left.data[0, :4, 0].tolist() == [2, 3, 6, 7]
    assert own.pitch_ratio == pytest.approx(2.0 * context.pitch_ratio)
    array = replace(context, camera=load_camera("vox-lwir-640"))
    assert [name for name, *_ in scan_directions(FrameStack(data=rows), None, context=array)] == [
        ""
    ]
