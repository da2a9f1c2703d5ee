"""No light is lost between the wavelengths of a grid, and no more of them are taken than the sensor
needs.
"""

import numpy as np
import pytest

from labdata import BadInput
from simulate.camera import JOULE_METRE, detection_weights, quantum_efficiency
from simulate.radiance import SourceSpectrum, band_widths, spectral_grid, sum_spectra
from simulate.radiance.lamps import spectra, spectrum
from simulate.radiance.outdoor import render_settings
from simulate.radiance.sky import NightSky, moon_spectrum


@pytest.mark.parametrize("kind", [*spectra.KINDS, "moon", "dark sky"])
def test_any_grid_keeps_all_power_and_its_mean_wavelength(kind, seed):
    """A weight that is linear in wavelength is integrated exactly, however coarse and uneven the
    grid.
    """
    light = {"moon": moon_spectrum(5.0), "dark sky": NightSky().sources()[-1]}.get(
        kind
    ) or spectrum(kind, lumens=100.0)
    rng = np.random.default_rng([seed, len(kind)])
    for bands in (2, 5, 40):
        grid = np.sort(np.concatenate([[300.0, 1200.0], rng.uniform(300.0, 1200.0, bands - 2)]))
        weight = (grid - 300.0) * band_widths(grid)
        expected = light.through([300.0, 1200.0], [0.0, 900.0])
        assert np.sum(light.on(grid) * weight) == pytest.approx(expected, rel=1e-9)
        assert np.sum(light.on(grid) * band_widths(grid)) == pytest.approx(
            light.total(300.0, 1200.0), rel=1e-9
        )


def test_light_outside_the_grid_is_not_folded_in():
    line = SourceSpectrum(
        wavelength_nm=np.array([300.0, 1200.0]),
        density=np.zeros(2),
        line_nm=(589.0,),
        line_power=(1.0,),
    )
    assert np.sum(line.on(np.array([600.0, 700.0, 800.0]))) == 0.0
    assert np.sum(spectrum("led-cool").on(np.array([900.0, 1000.0]))) == 0.0


def response(sheet):
    """The tube's photoelectrons per W, over its own wavelengths."""
    nm = np.asarray(sheet.photocathode.wavelength_nm)
    return nm, quantum_efficiency(sheet, nm) * nm * 1e-9 / JOULE_METRE


@pytest.mark.parametrize("kind", spectra.KINDS)
def test_every_line_is_on_the_grid(sheet, kind):
    light = spectrum(kind)
    grid = spectral_grid([light], *response(sheet))
    inside = [nm for nm in light.line_nm if grid[0] < nm < grid[-1]]
    assert set(inside) <= set(grid.tolist())


@pytest.mark.parametrize("tolerance", [0.02, 0.003])
def test_photoelectrons_on_the_grid_are_those_of_the_whole_spectrum(sheet, tolerance):
    """Also through a leaf, whose reflectance jumps at 700 nm, which the grid was told of."""
    nm, per_watt = response(sheet)
    leaf = np.array([400.0, 650.0, 690.0, 740.0, 950.0]), np.array([0.05, 0.04, 0.06, 0.42, 0.45])
    lights = [spectrum(kind) for kind in spectra.KINDS] + [
        moon_spectrum(5.0),
        *NightSky().sources(),
    ]
    grid = spectral_grid(lights, nm, per_watt, tolerance=tolerance, spectra=[leaf])
    width = band_widths(grid)
    for light in lights:
        for table in (None, leaf):

            def seen(at, table=table):
                reflected = 1.0 if table is None else np.interp(at, *table)
                return np.interp(at, nm, per_watt, left=0.0, right=0.0) * reflected

            fine = np.union1d(
                np.linspace(grid[0], grid[-1], 2001), np.concatenate([nm, leaf[0][1:-1]])
            )
            expected = light.through(fine, seen(fine))
            assert np.sum(light.on(grid) * width * seen(grid)) == pytest.approx(
                expected, rel=1.2 * tolerance
            )


def filtered(middle_nm, width_nm, edge_nm=0.2):
    """A detector behind a filter with steep edges: wavelengths and efficiency."""
    half = 0.5 * width_nm
    edges = [
        middle_nm - half - edge_nm,
        middle_nm - half,
        middle_nm + half,
        middle_nm + half + edge_nm,
    ]
    return np.array([400.0, *edges, 950.0]), np.array([0.0, 0.0, 0.5, 0.5, 0.0, 0.0])


def detected(light, nm, efficiency):
    """Photons of a rendered light that a detector detects, as lens and detector take them from a
    picture's bands.
    """
    fine = np.union1d(nm, np.arange(nm[0], nm[-1], 5.0))
    per_watt = np.interp(fine, nm, efficiency) * fine * 1e-9 / JOULE_METRE
    grid = spectral_grid(
        [light], fine, per_watt, tolerance=render_settings.RENDER_LIMITS.max_spectral_error
    )
    return light.on(grid) @ detection_weights(grid, nm, efficiency, averaged=True)


BROAD = (
    np.array([400.0, 500.0, 600.0, 700.0, 900.0, 950.0]),
    np.array([0.1, 0.4, 0.42, 0.38, 0.1, 0.0]),
)


@pytest.mark.parametrize("detector", [BROAD, filtered(589.3, 5.0), filtered(590.1, 10.0)])
def test_a_watt_of_low_pressure_sodium_is_detected_line_by_line(detector):
    """The closed form: power, efficiency and energy of a photon at 589.0 and 589.6 nm, in the
    shares 2 to 1.
    """
    light = spectrum("low-pressure-sodium", watts=1.0)
    exact = sum(
        share / 3.0 * np.interp(line, *detector) * line * 1e-9 / JOULE_METRE
        for line, share in ((589.0, 2.0), (589.6, 1.0))
    )
    assert detected(light, *detector) == pytest.approx(exact, rel=0.001)


@pytest.mark.parametrize(("width_nm", "middle_nm"), [(5.0, 612.37), (10.0, 800.7)])
def test_even_light_through_a_steep_filter_keeps_the_filters_area(width_nm, middle_nm):
    """A watt per nm: 0.5 (width + one edge) lambda / (h c), of bands of a rendering and of bands
    that a file states.
    """
    nm, efficiency = filtered(middle_nm, width_nm)
    exact = 0.5 * (width_nm + 0.2) * middle_nm * 1e-9 / JOULE_METRE
    even = SourceSpectrum(wavelength_nm=np.array([300.0, 1200.0]), density=np.ones(2))
    assert detected(even, nm, efficiency) == pytest.approx(exact, rel=0.001)
    assert detection_weights([400.0, 700.0, 950.0], nm, efficiency).sum() == pytest.approx(
        exact, rel=1e-6
    )


def test_a_smooth_light_needs_few_bands_and_a_tighter_tolerance_more(sheet):
    sensor = response(sheet)
    loose, tight = (
        spectral_grid([moon_spectrum(5.0)], *sensor, tolerance=x) for x in (0.02, 0.001)
    )
    assert loose.size < 16 < tight.size < 60
    lines = spectral_grid([spectrum("mercury")], *sensor, tolerance=0.02)
    assert lines.size > loose.size


def test_spectra_add():
    parts = [spectrum("mercury"), spectrum("low-pressure-sodium", lumens=3.0)]
    assert sum_spectra(parts).lumens == pytest.approx(4.0, rel=1e-3)
    half = parts[0].multiply(lambda nm: np.full(np.shape(nm), 0.5))
    assert half.lumens == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: spectral_grid([], [400.0, 500.0], [0.0, 0.0]), "must respond at some wavelength"),
        (
            lambda: spectral_grid([], [400.0, 500.0], [1.0, 1.0], tolerance=0.0),
            "must be positive, got 0",
        ),
        (lambda: spectrum("mercury").on([500.0]), "at least two bands"),
        (lambda: spectrum("mercury").on([500.0, 400.0]), "must be positive and ascend"),
    ],
)
def test_impossible_grids_are_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()
