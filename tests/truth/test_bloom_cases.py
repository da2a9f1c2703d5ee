"""The studies of blooming: series are what they are said to be, and the chart is what the method
still does.
"""

from dataclasses import replace

import numpy as np
import pytest

import charact.estimators.bloom  # noqa: F401  # registers the methods
from charact.method import Context, choose
from charact.method.registry import chart_table, methods_of_kind
from tests.truth.bloom_light import BloomScene
from tests.truth.cases.bloom import BloomSeries, halo_overload, series_in_scope


def test_series_in_scope_show_the_halo_over_two_decades_and_saturate_beyond():
    for seed in range(20):
        series = series_in_scope(np.random.default_rng(seed))
        scene = series.scene
        plateau = np.array(series.overloads) / halo_overload(scene)
        assert 25 <= scene.halo_diameter_px <= 70
        assert 0.02 <= scene.halo_fraction <= 0.3
        assert ((plateau > 0.006) & (plateau < 1.0)).sum() >= 5
        assert plateau[0] < 0.008 < 1.0 < plateau[-1]
        assert series.overloads == tuple(sorted(series.overloads))


def test_streak_and_halo_are_told_apart_where_columns_overflow_and_smear():
    """Streak within 2 px, halo within 2 % or 1 px, or flagged or refused."""
    scene = BloomScene(
        rows=200,
        cols=120,
        halo_diameter_px=40.0,
        halo_fraction=0.1,
        halo_elastic_share=0.5,
        frames=4,
    )
    for well, smear in ((12.0, 1e-4), (4.0, 1e-3)):
        spoilt = replace(scene, full_well_dn=well * scene.span_dn, smear_fraction=smear)
        overloads = tuple(
            float(one) for one in halo_overload(spoilt) * np.array([0.003, 0.03, 0.3, 1.5])
        )
        series = BloomSeries(scene=spoilt, overloads=overloads)
        drawn = series.session_drawn(np.random.default_rng(7))
        context = Context(quick=True, seed=7, full_scale_dn=scene.full_scale_dn)
        found = (
            methods_of_kind("bloom")["series-forward"].function(drawn, context=context).measurements
        )
        sure = {(one.quantity, one.stack): one for one in found if one.status == "ok"}
        assert sure["halo_diameter", None].value == pytest.approx(40.0, abs=1.0)
        streaks = [
            (one.value, series.truth(*key))
            for key, one in sure.items()
            if key[0] == "streak_length"
        ]
        assert len(streaks) >= 2
        assert all(abs((value or 0.0) - (right or 0.0)) <= 2.0 for value, right in streaks), streaks
        assert max(right or 0.0 for _, right in streaks) > 30


def test_auto_takes_the_only_method_and_the_chart_says_how_well_it_measures():
    (row,) = chart_table("halo_diameter")
    assert [row["method"]] == list(methods_of_kind("bloom"))
    assert choose("bloom").name == "series-forward"
    assert row["error_percent"] < 2.0 and row["silent"] == 0
