"""Steps, tolerances and iteration limits of the thermal model."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ThermalLimits:
    """Numbers of the thermal model that are neither physics nor a scene's; set against its analytic
    tests.
    """

    # Cells of a layer, each thicker than the one before: the day's wave on 0.6 m of soil has 0.15 %
    # too much amplitude.
    cells: int = 30
    ratio: float = 1.15
    step_s: float = 300.0
    # Newton's method on the balance of the face ends below this change, K; it takes 3 to 5 steps.
    converged_k: float = 1e-6
    max_steps: int = 60
    # The periodic state changes by less than this in a pass, K.
    periodic_k: float = 1e-4
    max_passes: int = 5000
    # A kernel is followed back until a day adds less than this fraction of it, in steps of an hour.
    kernel_fraction: float = 1e-4
    max_days: int = 90
    steps_of_hour: int = 12
    # Steps between directions of the sun by which its shadows are found, and most passes of
    # neighbours.
    sun_steps: int = 3
    max_neighbour_passes: int = 8
    # Half of the noise-equivalent temperature difference of a 40 mK imager; references this near
    # count alike, K.
    tolerance_mk: float = 20.0
    near_k: float = 0.01
    # Rays of a pixel to the sky; steps of the day with one direction of the sun for pixels; rows at
    # a time.
    pixel_rays: int = 64
    slot_steps: int = 3
    rows: int = 16
    # Points of a facet and rays of each to sky and neighbours, for a sky view factor within 0.01.
    points: int = 64
    rays: int = 32
    # A sky this close to a black body of the air's temperature is isotropic; Newton steps for the
    # optical depth.
    even_sky: float = 1e-3
    newton_steps: int = 12
    # Farthest station of which a weather file may be, km, and most days of a file that are used.
    farthest_km: float = 200.0
    # Sunlight of a file while the sun is so far below the horizon (sine) is that of another time
    # zone, W m-2.
    night_sine: float = -0.05
    night_w_m2: float = 20.0
    max_weather_days: int = 5


LIMITS = ThermalLimits()


@dataclass(frozen=True, kw_only=True)
class InfraredLimits:
    """Numbers of infrared rendering that are neither physics nor a scene's."""

    # What terms left out may change together, as a fraction of the imager's noise-equivalent
    # temperature difference.
    tolerance: float = 0.1
    # Monte Carlo error of a pixel over that difference: it adds 22 % to the noise, less after a
    # lens, for neighbours share rays. Rays of diffuse surfaces, and of glossy ones and metals, are
    # doubled until random pixels reach it.
    error_share: float = 0.7
    min_rays: int = 16
    max_rays: int = 512
    min_mirror_rays: int = 64
    max_mirror_rays: int = 512
    pilot_pixels: int = 600
    # Panes one behind the other that are looked through, and the transmittance below which one is
    # opaque.
    panes: int = 4
    opaque: float = 1e-4
    # Points of a bin at which spectra of glass and of the MODTRAN database are read.
    bin_points: int = 50
    # Ground of the model atmospheres of LOWTRAN7 to which the sky was fitted: temperature, K, and
    # water vapour, g m-3.
    models_k: tuple[float, float] = (257.2, 299.7)
    models_g_m3: tuple[float, float] = (1.75, 17.1)
    # Parts along a side of a pixel where objects or faces meet, and such pixels at a time.
    edge_parts: int = 3
    edge_batch: int = 1000
    # Rows at a time, and most rays of glossy surfaces at a time.
    rows: int = 16
    batch_rays: int = 200_000
    # Error of half-micrometre bins for 11 non-metals below 3 skies at 0.1 to 5 km, root mean
    # square, mK (LOWTRAN7 at 5 cm-1 and emissivities of SLUM as reference), and of bare metals,
    # which reflect more than half.
    finer_bins_mk: float = 20.0
    finer_bins_metal_mk: float = 100.0
    # Air of the paths of LOWTRAN7 to which its transmittance was fitted, C and relative humidity;
    # longest path that was compared with MODTRAN 5; elevation to which the sky is within 3 K of
    # LOWTRAN7, and error at 2 degrees, K; elevation of the sun within which refraction, 0.6
    # degrees, and its radius, 0.3 degrees, count.
    fitted_c: tuple[float, float] = (-10.0, 30.0)
    fitted_humidity: tuple[float, float] = (0.2, 1.0)
    farthest_km: float = 8.0
    lowest_sky_deg: float = 5.0
    low_sky_k: float = 5.0
    low_sun_deg: float = 1.0


INFRARED = InfraredLimits()


@dataclass(frozen=True, kw_only=True)
class ModtranLimits:
    """How far a scene's air may be from that of the MODTRAN database.

    By the band model these change the transmittance of a kilometre by 0.023 at most; what the path
    emits follows the scene's air.
    """

    air_k: float = 2.0
    vapour_g_m3: float = 1.0
    pressure_hpa: float = 30.0
    # Slanted paths count as level: height of the camera, m.
    height_m: float = 100.0
    # Transmittance and optical depth that count as zero.
    negligible: float = 1e-12


MODTRAN = ModtranLimits()


@dataclass(frozen=True, kw_only=True)
class ThermalUncertainty:
    """Standard deviations of what a scene's temperatures are computed from."""

    # Longwave of the sky: spread of the formulas for its emissivity, 0.04; calibration of a
    # pyrgeometer, W m-2.
    modelled_longwave_w_m2: float = 15.0
    measured_longwave_w_m2: float = 5.0
    # Coefficient of convection, as a fraction: the laws in use differ by a factor of 2 at 1 m/s.
    convection: float = 0.3
    # Spread of the urban samples of one class in SLUM (Kotthaus et al. 2014).
    absorptivity: float = 0.05
    emissivity: float = 0.02
    # Thermal inertia, as a fraction: handbook values of conductivity and of heat capacity, each by
    # 20 %.
    inertia: float = 0.2


UNCERTAINTY = ThermalUncertainty()

# What a weather file may hold, from the records of the earth's surface (World Meteorological
# Organization) with some margin: below and beyond is a broken sensor, another unit or a code for a
# missing value.
WEATHER_BOUNDS: dict[str, tuple[float, float]] = {
    "air_c": (-95.0, 62.0),
    "dew_point_c": (-110.0, 40.0),
    "wind_m_s": (0.0, 115.0),
    "pressure_hpa": (300.0, 1090.0),
    "direct_w_m2": (0.0, 1450.0),
    "diffuse_w_m2": (0.0, 1450.0),
    "longwave_w_m2": (40.0, 700.0),
    "cloud": (0.0, 1.0),
}
