"""Steps, tolerances and iteration limits of the thermal model."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ThermalLimits:
    """Numbers of the thermal model that are neither physics nor a scene's; set against its analytic tests."""

    # Cells of a layer, each thicker than the one before: the day's wave on 0.6 m of soil has 0.15 % too much amplitude.
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
    # Steps between directions of the sun by which its shadows are found, and most passes of neighbours.
    sun_steps: int = 3
    max_neighbour_passes: int = 8
    # Half of the noise-equivalent temperature difference of a 40 mK imager; references this near count alike, K.
    tolerance_mk: float = 20.0
    near_k: float = 0.01
    # Rays of a pixel to the sky; steps of the day with one direction of the sun for pixels; rows at a time.
    pixel_rays: int = 64
    slot_steps: int = 3
    rows: int = 16
    # Points of a facet and rays of each to sky and neighbours, for a sky view factor within 0.01.
    points: int = 64
    rays: int = 32
    # A sky this close to a black body of the air's temperature is isotropic; Newton steps for the optical depth.
    even_sky: float = 1e-3
    newton_steps: int = 12
    # Farthest station of which a weather file may be, km, and most days of a file that are used.
    farthest_km: float = 200.0
    max_weather_days: int = 5


LIMITS = ThermalLimits()
