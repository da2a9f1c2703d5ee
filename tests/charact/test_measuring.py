"""What one target of a session tells is known when the next is measured."""

import pytest

from charact.measuring import _knowing_halo
from charact.method import Context
from labdata.measurement import Result, from_sd, refused
from labdata.sensors import load_sensor


@pytest.fixture
def context() -> Context:
    return Context(sensor=load_sensor("pulnix-ag5745ef3"))


def test_a_halo_of_four_gaps_sets_the_gap(context: Context) -> None:
    halo = from_sd("halo_diameter", "px", 48.0, 0.1, method="series-forward")
    gap = _knowing_halo(context, Result(measurements=(halo,))).sensor.photocathode.gap_mm
    mm_per_px = 11.0e-3 * float(context.sensor.taper.demagnification)
    assert gap.value == pytest.approx(48.0 * mm_per_px / 4.0, rel=1e-12)
    assert gap.high - gap.low == pytest.approx(2 * 1.959964 * 0.1 * mm_per_px / 4.0, rel=1e-5)


@pytest.mark.parametrize(
    "halo",
    [
        refused("halo_diameter", "px", "no halo", method="series-forward"),
        from_sd("halo_diameter", "px", 48.0, 0.1, method="series-forward", flags=("saturated",)),
    ],
)
def test_a_halo_that_is_not_sound_tells_nothing(context: Context, halo) -> None:
    assert _knowing_halo(context, Result(measurements=(halo,))) is context
