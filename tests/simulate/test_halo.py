"""The halo: as wide as four gaps whatever the light, and flat with a bright rim for elastic
electrons.
"""

import numpy as np
import pytest

from labdata import Conditions, Target
from simulate import LabBench
from simulate.camera import HaloBlur, true_quantities

GAP_MM = 0.21
# Section 1.5: density times d^2 at r/d = 0.1, 0.3, ... 1.9, elastic and for energies uniform in
# 0..1.
ELASTIC = [0.040, 0.040, 0.041, 0.042, 0.045, 0.048, 0.053, 0.061, 0.077, 0.182]
UNIFORM = [1.21, 0.38, 0.21, 0.14, 0.10, 0.07, 0.05, 0.04, 0.03, 0.01]


def _landing(rng: np.random.Generator, elastic: bool, count: int) -> np.ndarray:
    """Distances, in gaps, of electrons re-emitted by the cosine law: r = 2 e d sin(2 t)."""
    angle = np.arcsin(np.sqrt(rng.random(count)))
    energy = 1.0 if elastic else rng.random(count)
    return 2.0 * energy * np.sin(2.0 * angle)


@pytest.mark.parametrize(("elastic", "table"), [(True, ELASTIC), (False, UNIFORM)])
def test_cosine_emission_lands_within_two_gaps_as_tabulated(elastic, table, seed):
    distance = _landing(np.random.default_rng(seed), elastic, 400_000)
    assert distance.max() <= 2.0
    assert not elastic or distance.max() > 2.0 - 1e-6
    edges = np.linspace(0.0, 2.0, 11)
    density = np.histogram(distance, edges)[0] / len(distance) / (np.pi * np.diff(edges**2))
    assert density == pytest.approx(table, rel=0.03, abs=0.006)


@pytest.mark.parametrize("elastic", [True, False])
def test_transfer_is_the_hankel_transform_of_the_landing_distances(elastic, seed):
    from scipy.special import j0

    count = 200_000
    distance_mm = GAP_MM * _landing(np.random.default_rng(seed), elastic, count)
    halo = HaloBlur(fraction=1.0, gap_mm=GAP_MM, elastic_share=float(elastic))
    for frequency in (0.3, 1.0, 3.0, 8.0):
        sample = j0(2.0 * np.pi * frequency * distance_mm)
        found = float(halo.transfer(np.array([frequency]), np.array([0.0]))[0])
        assert abs(sample.mean() - found) < 4.5 * sample.std() / np.sqrt(count)


def test_halo_of_the_camera_ends_at_four_gaps_at_every_light_level(plain):
    """A sharp elastic halo on a nearly blurless tube: no light of the point beyond two gaps."""
    sensor = plain(
        120,
        120,
        photocathode__halo_elastic_share=1.0,
        photocathode__ebi_lm_per_cm2=0.0,
        tube__mtf_frequency_lp_per_mm=400.0,
        tube__mtf_exponent=2.0,
        ccd__full_well_e=1e12,
    )
    bench, target = LabBench(sensor), Target(pinhole_px=1.5)
    radius_px = true_quantities.true_quantities(sensor)["halo_diameter"] / 2.0
    assert 2.0 * radius_px == pytest.approx(4.0 * GAP_MM / 0.018)
    row, col = np.indices((120, 120))
    distance = np.hypot(col + 0.5 - 60.0, (row + 0.5 - 60.0) * 13.0 / 11.0)
    for lux in (1e-3, 1e-1):
        light = bench.mean("point", target, Conditions(illuminance_lux=lux)) - 400.0
        background = np.median(light[distance > radius_px + 12.0])
        rim = light[np.abs(distance - radius_px + 1.0) < 1.0].mean() - background
        plateau = light[(distance > 6.0) & (distance < 12.0)].mean() - background
        beyond = (
            light[(distance > radius_px + 4.0) & (distance < radius_px + 10.0)].mean() - background
        )
        assert rim > 1.5 * plateau > 0.0
        assert abs(beyond) < 0.06 * plateau


def test_halo_holds_its_fraction_of_the_light(plain):
    sensor = plain(120, 120, photocathode__ebi_lm_per_cm2=0.0, photocathode__halo_fraction=0.2)
    bench, conditions = LabBench(sensor), Conditions(illuminance_lux=1e-2)
    plate = bench.mcp_input("point", Target(pinhole_px=3.0), conditions).values
    none = LabBench(sensor.with_values({"photocathode.halo_fraction": 0.0}))
    sharp = none.mcp_input("point", Target(pinhole_px=3.0), conditions).values
    # The holder's ring glows beside the picture and its halo reaches in.
    assert plate.sum() == pytest.approx(sharp.sum(), rel=2e-3)
    grid = bench.camera.cells
    y, x = ((np.arange(n) + 0.5) / 2 - 10.0 for n in grid.shape)
    distance = np.hypot((x - 60.0)[None, :], ((y - 60.5) * 13.0 / 11.0)[:, None])
    far = (distance > 4.0) & (distance < 30.0)
    # The density of the mixed halo falls off as tabulated; what lies within 4 px is the rest.
    inside = 0.3 * (1.0 - np.sqrt(1.0 - (4.0 / 23.33) ** 2))
    reach = 4.0 / 23.33
    spread = 0.7 * (
        1.0 - np.mean(np.sqrt(np.maximum(0.0, 1.0 - (reach / np.linspace(5e-4, 1.0, 2000)) ** 2)))
    )
    expected = 0.2 * (1.0 - inside - spread) * sharp.sum()
    assert (plate - sharp)[far].sum() == pytest.approx(expected, rel=0.05)
