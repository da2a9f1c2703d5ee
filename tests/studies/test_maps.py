"""Studies of maps, and peers of the edge on them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies import edge_map, gain_map, spectrum_map
from benchmarks.studies.cramer_rao import least_relative_sd
from benchmarks.studies.edge_peers import PEERS, TABLE, answers, bound, row, scene_of, without_noise
from benchmarks.studies.scenario_map import summarise_outcomes, worst
from charact.method.registry import methods_of_kind

# The committed maps of edges, gains and spectra: their cells are what the methods still do, and
# they keep what is promised of them.


# Of each map: the cells that it has at least, those that are measured again, and by how many of
# their drawings the verdicts may differ: each drawing of gains and spectra has its own seed.
MAPS = {edge_map: (5000, 5, 3), gain_map: (3000, 3, 0), spectrum_map: (1000, 1, 0)}


@pytest.fixture(scope="module", params=MAPS, ids=lambda study: study.__name__.rsplit(".", 1)[1])
def study(request):
    return request.param


def table(study):
    return json.loads(study.TABLE.read_text())


def cells(study):
    part = table(study)["quick"]
    return [dict(zip(part["columns"], row, strict=True)) for row in part["rows"]]


def test_the_map_goes_through_all_that_breaks_the_method(study):
    kept = cells(study)
    assert len(kept) >= MAPS[study][0]
    assert {cell["axis"] for cell in kept} == {"none", *study.BREAKING}
    assert len(table(study)["chains"]["rows"]) >= 0.02 * len(kept)


def test_cells_are_what_the_method_still_does(study, seed):
    """Statuses as in the table, the median width within a tenth."""
    kept, (_, count, apart) = cells(study), MAPS[study]
    for number in np.random.default_rng(seed).choice(len(kept), count, replace=False):
        before, again = kept[number], study.measure_scenario(kept[number]["number"])
        assert abs(again.ok - before["ok"]) <= apart, (before, again)
        assert abs(again.refused - before["refused"]) <= apart, (before, again)
        if min(again.ok, before["ok"]) >= (10 if apart else 1):
            assert again.sd_percent == pytest.approx(before["sd_percent"], rel=0.1)


def missed_at_most(cell):
    """One in twenty, and three standard errors."""
    return 0.05 * cell["ok"] + 3.0 * np.sqrt(0.05 * 0.95 * cell["ok"])


def test_what_the_map_shows(study):
    """No crash; in scope 95 % ok; between 2 and 5 % of the intervals miss.

    Silent failures: an honest Gaussian interval is off by more than twice itself once in 11,000.
    Over all that breaks the methods there are no more than such intervals have by chance.
    """
    for part in ("quick", *["chains"] * (study is edge_map)):
        summary = table(study)[part]["summary"]
        inside, honest = summary["by_axis"]["none"], summary.get("silent_of_honest_gaussian")
        assert summary["crashed"] == 0
        assert summary["in_scope_ok_percent"] >= 95.0
        assert inside["missed"] <= missed_at_most(inside)
        assert honest is None or summary["silent"] <= honest + 3.0 * np.sqrt(honest)
        assert summary.get("missed_standard_errors_over_5_percent", 0.0) <= 3.0


def test_the_map_of_edges_is_as_narrow_as_promised():
    """In scope as narrow as 1.3 times the bound, and silent no more than honest intervals are."""
    quick, chains = (table(edge_map)[part]["summary"] for part in ("quick", "chains"))
    assert quick["median_sd_over_bound"] <= 1.3 and chains["median_sd_over_bound"] <= 1.3
    # One drawing of two cells in five: honest Gaussian intervals have none in 8 of 9 such maps.
    assert len(table(edge_map)["chains"]["rows"]) >= 2000 and chains["silent"] == 0
    inside, honest = quick["by_axis"]["none"], quick["silent_of_honest_gaussian"]
    assert inside["missed"] >= 0.02 * inside["ok"]
    assert quick["silent"] <= honest + np.sqrt(honest)
    assert inside["silent"] <= inside["ok"] / 11_000
    assert len(quick["worst"]) == 10
    kept, verdicts = cells(edge_map), ("ok", "suspect", "refused", "crashed")
    assert all(sum(cell[name] for name in verdicts) >= 20 for cell in kept)
    assert all(cell["bound_percent"] for cell in kept if cell["axis"] == "none")


def test_glowing_gains_and_all_spectra_miss_no_more_than_promised():
    gains = table(gain_map)["quick"]["summary"]["by_axis"]
    spectra = table(spectrum_map)["quick"]["summary"]
    # An honest Gaussian interval has one in one such map of twenty, two in one of a thousand.
    assert spectra["silent_in_scope"] <= 1
    total = {
        name: sum(cell[name] for cell in spectra["by_axis"].values()) for name in ("ok", "missed")
    }
    for cell in (gains["decay_ms"], gains["interlaced_decay_ms"], total):
        assert cell["missed"] <= missed_at_most(cell)


def test_the_summary_counts_what_the_cells_say():
    outcomes = [edge_map.measure_scenario(number, repeats=2) for number in (0, 1, 6)]
    found = summarise_outcomes(outcomes)
    assert (found["cells"], found["draws"]) == (3, 6)
    assert found["ok"] == sum(cell.ok for cell in outcomes)
    assert [cell.number for cell in worst(outcomes, 1)] == found["worst"][:1]


def test_the_bound_halves_with_half_the_noise_and_falls_with_the_root_of_the_rows():
    scenes = (cell.scene for cell in map(edge_map.cell_of, range(100)) if cell.in_scope)
    scene = next(scene for scene in scenes if scene.noise_blur_px == 0)
    wide = replace(scene, shot_share=0.0, gradient=0.0, snr=20.0, rows=80, cols=120, angle_deg=6.0)
    bound = least_relative_sd(wide)
    assert least_relative_sd(replace(wide, snr=40.0)) == pytest.approx(bound / 2, rel=1e-3)
    assert least_relative_sd(replace(wide, rows=160)) == pytest.approx(bound / 2**0.5, rel=0.03)


def test_a_cell_is_a_camera_without_lag_unless_lag_is_what_breaks_it():
    scenes = [gain_map.cell_of(number) for number in range(40)]
    plain = next(cell for cell in scenes if cell.in_scope).scene
    slow = next(cell for cell in scenes if cell.axis == "decay_ms" and cell.strength > 20.0).scene
    assert plain.truth["decay_factor"] == pytest.approx(1.0, abs=1e-3)
    assert slow.truth["decay_factor"] < 0.9
    assert plain.truth["covariance_gain"] == pytest.approx(
        plain.truth["system_gain"]
        + plain.truth["photoelectron_gain"] * plain.truth["excess_noise_factor"],
        rel=1e-6,
    )


def test_spectra_that_one_form_alone_told_wrongly_are_not_silent():
    """A camera inside the scope whose most probable blur model alone is several percent off."""
    again = spectrum_map.measure_scenario(306)
    assert (again.ok, again.silent) == (1, 0)


def test_a_curved_response_is_told_by_levels_of_few_dn():
    """An exponent of 1.8 over signals of 0.4 to 7 DN moves the MTF50 by 7 %."""
    assert spectrum_map.measure_scenario(1551).suspect == 1


# The chart of edges beside other programs: its table is what the methods do, its bound the closed
# form's.


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
