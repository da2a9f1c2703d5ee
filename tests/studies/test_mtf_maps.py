"""The map of spectra: cells are what the methods still do, and what they show."""

import json

import numpy as np
import pytest

from benchmarks.studies import spectrum_map as spectra


def table():
    return json.loads(spectra.TABLE.read_text())


def cells(part):
    return [dict(zip(part["columns"], row, strict=True)) for row in part["rows"]]


def test_the_map_goes_through_all_that_breaks_the_method():
    kept = cells(table()["quick"])
    assert len(kept) >= 1000
    assert {one["axis"] for one in kept} == {"none", *spectra.BREAKING}
    assert len(table()["chains"]["rows"]) >= 0.02 * len(kept)


def test_a_cell_is_what_the_method_still_does(seed):
    """Every drawing has its own seed: the verdicts are the same, and the widths within a tenth."""
    kept = cells(table()["quick"])
    for number in np.random.default_rng(seed).choice(len(kept), 1):
        before, again = kept[number], spectra.measure_scenario(kept[number]["number"])
        assert (again.ok, again.refused) == (before["ok"], before["refused"]), (before, again)
        if again.ok:
            assert again.sd_percent == pytest.approx(before["sd_percent"], rel=0.1)


def test_what_the_map_shows():
    """In scope 95 % ok and as many misses as promised."""
    summary = table()["quick"]["summary"]
    inside = summary["by_axis"]["none"]
    assert summary["crashed"] == 0
    assert summary["in_scope_ok_percent"] >= 95.0
    # An honest Gaussian interval has one in one such map of twenty, two in one of a thousand.
    assert summary["silent_in_scope"] <= 1
    assert inside["missed"] <= 0.05 * inside["ok"] + 3.0 * np.sqrt(0.05 * 0.95 * inside["ok"])
    ok, missed = (
        sum(one[name] for one in summary["by_axis"].values()) for name in ("ok", "missed")
    )
    assert missed <= 0.05 * ok + 3.0 * np.sqrt(0.05 * 0.95 * ok)


def test_a_halo_drawn_spreads_as_much_light_as_is_said(seed):
    """Of photoelectrons with a halo of a third, 40 px wide, the share beyond 5 px is a third of (1
    - (10/40)^2).
    """
    from tests.truth.blur import TrueBlur
    from tests.truth.point import landing_places

    count = 200_000
    places = landing_places(
        TrueBlur(sigma_px=0.5, halo_share=1 / 3, halo_px=40.0), count, np.random.default_rng(seed)
    )
    expected = (1.0 - (10.0 / 40.0) ** 2) / 3.0
    found = float(np.mean(np.hypot(*places.T) > 5.0))
    assert abs(found - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / count) + 0.002


def test_spectra_that_one_form_alone_told_wrongly_are_not_silent():
    """A camera inside the scope whose most probable blur model alone is several percent off."""
    again = spectra.measure_scenario(306)
    assert again.ok == 1
    assert again.silent == 0


def test_a_curved_response_is_told_by_levels_of_few_dn():
    """An exponent of 1.8 over signals of 0.4 to 7 DN moves the MTF50 by 7 %."""
    assert spectra.measure_scenario(1551).suspect == 1
