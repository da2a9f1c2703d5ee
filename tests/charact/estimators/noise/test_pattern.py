"""The fixed pattern of unequal pixels is neither the noise of the frames nor the light they keep
from each other.
"""

from importlib import import_module
from typing import Any

import numpy as np
import pytest

from charact.estimators import noise
from charact.observables import Estimates, Observable, Printed, declare, observables
from charact.reporting.emva_sheet import emva_summary
from labdata import QUANTITIES
from labdata.quantity import Catalogue, Quantity, StandardRow
from tests.truth.counted_pulses import (
    METHODS,
    QUICK,
    Pulses,
    errors,
    flat_series,
    gaussian,
    memory_of,
)


@pytest.mark.parametrize(("share", "frames"), [(0.0, 8), (0.2, 2), (0.2, 8), (0.8, 16), (0.6, 32)])
def test_non_uniformity_of_an_intensified_camera_is_right_or_flagged(seed, share, frames):
    camera = Pulses(
        gain_dn=5.0,
        transfer=gaussian(0.7),
        memory=memory_of(share),
        pattern=0.02,
        offset_dn=1.0,
        shape=(128, 160),
    )
    session = flat_series(
        camera, np.random.default_rng(seed), (40.0, 120.0, 360.0), frames=frames, dark_frames=frames
    )
    realised = 100.0 * np.random.default_rng(7).standard_normal(camera.shape).std() * 0.02
    spread = np.random.default_rng(11).standard_normal(camera.shape).std()
    for method in METHODS:
        result = noise.measure(session, method=method, context=QUICK)
        (prnu,) = result.find("prnu")
        assert prnu.status == "ok" or (share and frames != 32), method
        for found, truth in [
            (prnu, realised),
            *((m, spread) for m in result.find("dsnu") if m.unit == "DN"),
        ]:
            low, high = found.interval68 or (0.0, 0.0)
            assert found.status != "ok" or abs(found.value - truth) < max(
                4.5 * 0.5 * (high - low), 0.02 * truth
            )


class Kurtosis(Observable[Any]):
    """Excess kurtosis of the noise of a dark."""

    name = "kurtosis"
    order = 99
    printed = Printed(
        quantity="dark_kurtosis",
        unit="1",
        entry=Quantity(
            units=("1",),
            title="Excess kurtosis of the dark",
            standard=(
                StandardRow(
                    unit="1", name="Kurtosis", symbol="k", clause="", element=("other", "k")
                ),
            ),
        ),
    )

    def measure(self, stacks):
        noise = stacks.dark.data - stacks.dark.data.mean(axis=0)
        kurtosis = np.mean(noise**4) / np.mean(noise**2) ** 2 - 3.0
        return Estimates.of_number(float(kurtosis), float(np.sqrt(24.0 / noise.size)))


def test_a_statistic_is_printed_and_on_the_sheet_by_its_class_alone(seed, monkeypatch):
    registry = import_module("charact.observables.observable")
    monkeypatch.setattr(registry, "_KNOWN", [*observables()])
    declare(Kurtosis())
    camera = Pulses(gain_dn=0.0, electron_gain_dn=0.5, shape=(96, 128))
    session = flat_series(camera, np.random.default_rng(seed), (500.0, 1500.0, 3000.0), frames=4)
    try:
        result = noise.measure(session, method="variance", context=QUICK)
        (kurtosis,) = result.find("dark_kurtosis")
        assert kurtosis.status == "ok" and abs(errors(kurtosis, 0.0)) < 4.5
        assert "Kurtosis" in [row.entry.name for row in emva_summary(result)["rows"]]
    finally:
        del QUANTITIES["dark_kurtosis"]


def test_a_quantity_that_a_statistic_declares_is_known_when_it_is_asked_for():
    listed = Catalogue(gain=Quantity(units=("DN",), title="Gain"))
    declared = Quantity(units=("1",), title="Declared")
    listed.declare_more = lambda: listed.update(declared=declared)
    assert listed["gain"].title == "Gain" and "declared" in listed
    assert listed.get("declared") is declared and "neither" not in listed
