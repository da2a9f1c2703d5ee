"""Spectral radiance of scenes: light sources, materials, geometry, integrator and renderers."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.radiance.atmosphere import (
        Atmosphere,
        airmass,
        kruse_per_km,
        rayleigh_depth,
        vapour_density_g_m3,
        visibility_extinction_per_km,
    )
    from simulate.radiance.cube import RadianceCube, band_widths
    from simulate.radiance.lab_target import (
        TargetView,
        outline_cells,
        render_bench,
        target_outlines,
    )
    from simulate.radiance.materials import (
        Material,
        clearest,
        internal_transmittance,
        material,
        material_names,
        pane_fractions,
    )
    from simulate.radiance.scene import LabScene, load_bench, load_scene
    from simulate.radiance.spectrum import (
        LUMENS_PER_WATT,
        STEFAN_BOLTZMANN,
        SourceSpectrum,
        band_photon_radiance,
        band_radiance,
        band_radiance_slope,
        luminous_efficiency,
        planck,
        spectral_grid,
        sum_spectra,
    )

__all__ = [
    "LUMENS_PER_WATT",
    "STEFAN_BOLTZMANN",
    "Atmosphere",
    "LabScene",
    "Material",
    "RadianceCube",
    "SourceSpectrum",
    "TargetView",
    "airmass",
    "band_photon_radiance",
    "band_radiance",
    "band_radiance_slope",
    "band_widths",
    "clearest",
    "internal_transmittance",
    "kruse_per_km",
    "load_bench",
    "load_scene",
    "luminous_efficiency",
    "material",
    "material_names",
    "outline_cells",
    "pane_fractions",
    "planck",
    "rayleigh_depth",
    "render_bench",
    "spectral_grid",
    "sum_spectra",
    "target_outlines",
    "vapour_density_g_m3",
    "visibility_extinction_per_km",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.radiance.atmosphere": (
            "Atmosphere airmass kruse_per_km rayleigh_depth vapour_density_g_m3 "
            "visibility_extinction_per_km"
        ),
        "simulate.radiance.cube": "RadianceCube band_widths",
        "simulate.radiance.lab_target": "TargetView outline_cells render_bench target_outlines",
        "simulate.radiance.materials": (
            "Material clearest internal_transmittance material material_names pane_fractions"
        ),
        "simulate.radiance.scene": "LabScene load_bench load_scene",
        "simulate.radiance.spectrum": (
            "LUMENS_PER_WATT STEFAN_BOLTZMANN SourceSpectrum band_photon_radiance band_radiance "
            "band_radiance_slope luminous_efficiency planck spectral_grid "
            "sum_spectra"
        ),
    },
)
