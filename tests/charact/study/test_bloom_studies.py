"""The studies of blooming: series are what they are said to be, and the tables are what the methods still do."""

from dataclasses import replace

import numpy as np
import pytest

import charact.bloom  # noqa: F401  # registers the methods
from charact.method import choose
from charact.method.registry import chart_table, of_kind
from charact.study.bloom.coverage import Trial, is_silent, quantity_told, series_of, told
from charact.study.bloom.map import BREAKING, bloom_told, cell_of, measured_cell
from charact.study.bloom.scene import BloomScene, truth
from charact.study.bloom.series import BloomSeries, halo_overload, measured
from labdata.measurement import Provenance, from_sd, refused

PROVENANCE = Provenance(version="", seed=0, settings={})


def number(value, sd, **given):
    return from_sd("bloom_diameter", "px", value, sd, method="", provenance=PROVENANCE, **given)


def trial(value, truth, *, status="ok", covers=True, silent=False):
    return Trial(
        kind="halo", number=0, method="m", quick=True, quantity="halo_diameter", unit="px", stack=None, status=status,
        truth=truth, value=value, covers68=covers, covers95=covers, silent=silent, seconds=1.0,
    )  # fmt: skip


def test_series_in_scope_show_the_halo_over_two_decades_and_saturate_beyond():
    for seed in range(20):
        series = series_of("halo", seed)
        scene = series.scene
        plateau = np.array(series.overloads) / halo_overload(scene)
        assert 25 <= scene.halo_diameter_px <= 70
        assert 0.02 <= scene.halo_fraction <= 0.3
        assert ((plateau > 0.006) & (plateau < 1.0)).sum() >= 5
        assert plateau[0] < 0.008 < 1.0 < plateau[-1]
        assert series.overloads == tuple(sorted(series.overloads))


def test_halo_meets_full_scale_where_it_is_said_to():
    scene = BloomScene(halo_elastic_share=1.0, core_sigma_px=1.0, glare_fraction=0.0)
    meets = halo_overload(scene)
    assert truth(scene, 0.4 * meets)["bloom_diameter"] < 20
    assert truth(scene, 0.6 * meets)["bloom_diameter"] > 40


def test_a_hidden_halo_is_under_the_noise_and_a_bare_source_has_none():
    for seed in range(10):
        hidden, bare = series_of("hidden halo", seed), series_of("no halo", seed)
        scene = hidden.scene
        plateau = hidden.overloads[-1] / halo_overload(scene) * scene.span_dn
        noise = np.sqrt(scene.photoelectron_dn * scene.excess * scene.background_dn / scene.frames)
        assert plateau < 0.35 * noise
        assert bare.scene.halo_fraction == 0
        assert bare.truth("halo_diameter", None) is None


def test_silent_is_beyond_twice_the_half_interval_of_every_right_value():
    found = number(10.0, 1.0)
    assert not is_silent(found, 13.9)
    assert is_silent(found, 14.1)
    assert not is_silent(found, 14.1, 9.0)
    assert is_silent(found, None)
    assert not is_silent(number(10.0, 1.0, flags=("model-misfit",)), 20.0)
    assert not is_silent(refused("bloom_diameter", "px", "why", method="", provenance=PROVENANCE), 20.0)


def test_a_quantity_is_summed_up_over_its_ok_numbers():
    found = quantity_told([trial(51.0, 50.0), trial(49.0, 50.0, covers=False), trial(20.0, 50.0, status="suspect")])
    assert (found["due"], found["due_and_ok"], found["suspect"]) == (3, 2, 1)
    assert (found["bias"], found["rms"]) == (0.0, 1.0)
    assert (found["within_tolerance_percent"], found["covers95_percent"]) == (100.0, 50.0)
    assert quantity_told([trial(52.0, 50.0)])["within_tolerance_percent"] == 0.0
    assert told([trial(50.5, 50.0)], "m")["quantities"]["halo_diameter"]["rms"] == 0.5


def test_each_axis_of_the_map_puts_one_thing_wrong():
    cells = [cell_of(number) for number in range(200)]
    assert {cell.axis for cell in cells} == {"none", *BREAKING}
    for cell in cells:
        scene, axis = cell.scene.scene, cell.axis
        assert (scene.second_distance_px is not None) == axis.startswith("second")
        assert (scene.motion_px > 0) == (axis in ("motion_px", "moving_lag"))
        assert scene.agc == (axis == "agc")
        assert (scene.wrong_dark_dn != 0) == axis.startswith("dark_too")
        assert cell.scene.darks == (axis != "no_darks")
        assert (scene.full_scale_dn in (255.0, 4095.0)) == (axis != "codes")


def test_a_cell_counts_its_blooms():
    found = measured_cell(next(number for number in range(50) if cell_of(number).in_scope))
    assert found.ok == 1
    assert found.blooms == len(cell_of(found.number).scene.overloads)
    assert bloom_told([found])["bloom_ok"] == found.bloom_ok <= found.blooms
    assert found.bloom_worst_px < 1.0


def test_streak_and_halo_are_told_apart_where_columns_overflow_and_smear():
    """Streak within 2 px, halo within 2 % or 1 px, or flagged or refused."""
    scene = BloomScene(rows=200, cols=120, halo_diameter_px=40.0, halo_fraction=0.1, halo_elastic_share=0.5, frames=4)
    for well, smear in ((12.0, 1e-4), (4.0, 1e-3)):
        spoilt = replace(scene, full_well_dn=well * scene.span_dn, smear_fraction=smear)
        overloads = tuple(float(one) for one in halo_overload(spoilt) * np.array([0.003, 0.03, 0.3, 1.5]))
        series = BloomSeries(scene=spoilt, overloads=overloads)
        drawn = series.session_drawn(np.random.default_rng(7))
        found, _ = measured(of_kind("bloom")["series-forward"], series, drawn, seed=7, quick=True)
        assert found is not None
        sure = {(one.quantity, one.stack): one for one in found if one.status == "ok"}
        assert sure["halo_diameter", None].value == pytest.approx(40.0, abs=1.0)
        streaks = [(one.value, series.truth(*key)) for key, one in sure.items() if key[0] == "streak_length"]
        assert len(streaks) >= 2
        assert all(abs((value or 0.0) - (right or 0.0)) <= 2.0 for value, right in streaks), streaks
        assert max(right or 0.0 for _, right in streaks) > 30


def test_auto_takes_the_forward_model_from_a_chart_of_four_methods():
    rows = {row["method"]: row for row in chart_table("halo_diameter")}
    assert len(rows) >= 4
    assert set(rows) <= set(of_kind("bloom"))
    assert choose("bloom").name == "series-forward"
    assert rows["series-forward"]["error_percent"] < 2.0
    assert sum(row["silent"] for row in rows.values()) == 0
