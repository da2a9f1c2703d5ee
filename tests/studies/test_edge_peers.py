"""The chart of edges beside other programs: its table is what the methods do, its bound the closed
form's.
"""

import json

import numpy as np
import pytest

from benchmarks.studies.cramer_rao import least_relative_sd
from benchmarks.studies.edge_peers import PEERS, TABLE, answers, bound, row, scene_of, without_noise
from charact.method.registry import methods_of_kind


def test_every_edge_method_stands_in_the_table_with_enough_frames():
    table = json.loads(TABLE.read_text())
    assert {one["method"] for one in table["ours"]} == set(methods_of_kind("edge"))
    assert all(one["frames"] >= 60 for one in table["ours"])
    assert {one["snr"] for one in table["ours"]} == {100.0, 30.0, 10.0, 5.0, 2.0, 1.0}
    assert [peer["name"] for peer in table["peers"]] == [peer.name for peer in PEERS]


def test_the_table_is_what_the_method_still_does():
    (kept,) = [
        one
        for one in json.loads(TABLE.read_text())["ours"]
        if one["method"] == "edge-gradient" and one["snr"] == 10.0
    ]
    count = 120
    again = row(
        [one for seed in range(count) for one in answers(seed, 10.0, {"edge-gradient": count})],
        10.0,
    )
    assert again["numbers"] == count and kept["numbers"] == kept["frames"]
    # An RMS of n errors scatters by 1/sqrt(2 n) of it; the first frames are among those of the
    # table.
    within = 4.0 * np.sqrt(0.5 / count - 0.5 / kept["frames"])
    assert again["rms_percent"] == pytest.approx(kept["rms_percent"], rel=within)
    assert again["rms_mtf"] == pytest.approx(kept["rms_mtf"], rel=within)


def test_the_bound_of_the_curve_is_that_of_the_width():
    """M = exp(-2 pi^2 s^2 f^2) P(f): dM/ds = -4 pi^2 s f^2 M, and MTF50 moves by -dM/ds over dM/df
    there.
    """
    scene, _ = scene_of(10.0, 0)
    sigma, half = scene.blur.sigma_px, scene.truth_mtf50
    mtf = lambda f: scene.blur.mtf(np.atleast_1d(f), scene.angle_deg)  # noqa: E731
    change = lambda f: -4 * np.pi**2 * sigma * np.square(f) * mtf(f)  # noqa: E731
    steepness = (mtf(half + 1e-5) - mtf(half - 1e-5)) / 2e-5
    width_sd = least_relative_sd(scene) * half / (change(half) / -steepness)[0]
    frequency = np.linspace(0.0, 0.5, 101)
    assert bound(10.0)["rms_mtf"] == pytest.approx(
        abs(width_sd) * np.sqrt(np.mean(change(frequency) ** 2)), rel=1e-3
    )


def test_without_noise_the_plain_methods_are_within_half_a_percent():
    assert all(
        error < 0.5 for error in without_noise(("edge-slanted", "edge-gradient"), phases=2).values()
    )
