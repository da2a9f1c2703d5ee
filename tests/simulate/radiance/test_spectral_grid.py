"""No light is lost between the wavelengths of a grid, and no more of them are taken than the sensor needs."""

import numpy as np
import pytest

from labdata.errors import BadInput
from simulate.iiccd.photons import JOULE_METRE, quantum_efficiency
from simulate.radiance.cube import band_widths
from simulate.radiance.lamps import KINDS, spectrum
from simulate.radiance.sky import NightSky
from simulate.radiance.sky.moon import moon_spectrum
from simulate.radiance.spectral_grid import spectral_grid
from simulate.radiance.spectrum import Spectrum, combined


@pytest.mark.parametrize("kind", [*KINDS, "moon", "dark sky"])
def test_any_grid_keeps_all_power_and_its_mean_wavelength(kind, seed):
    """A weight that is linear in wavelength is integrated exactly, however coarse and uneven the grid."""
    light = {"moon": moon_spectrum(5.0), "dark sky": NightSky().sources()[-1]}.get(kind) or spectrum(kind, lumens=100.0)
    rng = np.random.default_rng([seed, len(kind)])
    for bands in (2, 5, 40):
        grid = np.sort(np.concatenate([[300.0, 1200.0], rng.uniform(300.0, 1200.0, bands - 2)]))
        weight = (grid - 300.0) * band_widths(grid)
        expected = light.weighted(lambda nm: nm - 300.0)
        assert np.sum(light.on(grid) * weight) == pytest.approx(expected, rel=1e-3)
        assert np.sum(light.on(grid) * band_widths(grid)) == pytest.approx(light.total(300.0, 1200.0), rel=1e-9)


def test_light_outside_the_grid_is_not_folded_in():
    line = Spectrum(wavelength_nm=np.array([300.0, 1200.0]), density=np.zeros(2), line_nm=(589.0,), line_power=(1.0,))
    assert np.sum(line.on(np.array([600.0, 700.0, 800.0]))) == 0.0
    assert np.sum(spectrum("led-cool").on(np.array([900.0, 1000.0]))) == 0.0


def response(sheet):
    """The tube's photoelectrons per W, over its own wavelengths."""
    nm = np.asarray(sheet.photocathode.wavelength_nm)
    return nm, quantum_efficiency(sheet, nm) * nm * 1e-9 / JOULE_METRE


@pytest.mark.parametrize("kind", KINDS)
def test_every_line_is_on_the_grid(sheet, kind):
    light = spectrum(kind)
    grid, _ = spectral_grid([light], *response(sheet))
    inside = [nm for nm in light.line_nm if grid[0] < nm < grid[-1]]
    assert set(inside) <= set(grid.tolist())


@pytest.mark.parametrize("tolerance", [0.02, 0.003])
def test_photoelectrons_on_the_grid_are_those_of_the_whole_spectrum(sheet, tolerance):
    """Also through a leaf, whose reflectance jumps at 700 nm, which the grid was told of."""
    nm, per_watt = response(sheet)
    leaf = np.array([400.0, 650.0, 690.0, 740.0, 950.0]), np.array([0.05, 0.04, 0.06, 0.42, 0.45])
    lights = [spectrum(kind) for kind in KINDS] + [moon_spectrum(5.0), *NightSky().sources()]
    grid, width = spectral_grid(lights, nm, per_watt, tolerance=tolerance, spectra=[leaf])
    for light in lights:
        for table in (None, leaf):

            def seen(at, table=table):
                reflected = 1.0 if table is None else np.interp(at, *table)
                return np.interp(at, nm, per_watt, left=0.0, right=0.0) * reflected

            expected = light.weighted(lambda at, seen=seen: np.where((at >= grid[0]) & (at <= grid[-1]), seen(at), 0.0))
            assert np.sum(light.on(grid) * width * seen(grid)) == pytest.approx(expected, rel=1.2 * tolerance)


def test_a_smooth_light_needs_few_bands_and_a_tighter_tolerance_more(sheet):
    sensor = response(sheet)
    loose, tight = (spectral_grid([moon_spectrum(5.0)], *sensor, tolerance=x)[0] for x in (0.02, 0.001))
    assert loose.size < 16 < tight.size < 60
    lines, _ = spectral_grid([spectrum("mercury")], *sensor, tolerance=0.02)
    assert lines.size > loose.size


def test_spectra_add():
    parts = [spectrum("mercury"), spectrum("low-pressure-sodium", lumens=3.0)]
    assert combined(parts).lumens == pytest.approx(4.0, rel=1e-3)
    half = parts[0].filtered(lambda nm: np.full(np.shape(nm), 0.5))
    assert half.lumens == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: spectral_grid([], [400.0, 500.0], [0.0, 0.0]), "must respond at some wavelength"),
        (lambda: spectral_grid([], [400.0, 500.0], [1.0, 1.0], tolerance=0.0), "must be positive, got 0"),
        (lambda: spectrum("mercury").on([500.0]), "at least two bands"),
        (lambda: spectrum("mercury").on([500.0, 400.0]), "must be positive and ascend"),
    ],
)
def test_impossible_grids_are_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()
