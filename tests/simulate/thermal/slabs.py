"""Slabs, weather and forcing for tests: single layers, and the reference day."""

from typing import Any

import numpy as np

from labdata.camera import Parameter
from simulate.radiance import STEFAN_BOLTZMANN
from simulate.radiance.outdoor import Layer, Slab
from simulate.thermal import Exchange, Forcing

HOUR, DAY = 3600.0, 86400.0
CONCRETE, ASPHALT, DRY_SOIL = (
    (1.4, 2300.0, 880.0, 600.0),
    (0.75, 2120.0, 920.0, 600.0),
    (0.30, 1600.0, 800.0, 600.0),
)
STEEL = (45.0, 7850.0, 470.0, 5.0)


def slab_of(*layers: tuple[float, float, float, float], **numbers: float) -> Slab:
    """Return a slab of layers (conductivity, density, specific heat, mm) and further numbers."""
    found = tuple(
        Layer(
            thickness_mm=Parameter(value=thickness),
            conductivity_w_m_k=Parameter(value=conductivity),
            density_kg_m3=Parameter(value=density),
            specific_heat_j_kg_k=Parameter(value=heat),
        )
        for conductivity, density, heat, thickness in layers
    )
    return Slab(layer=found, **{name: Parameter(value=value) for name, value in numbers.items()})


def forcing_of(
    flux, air_k, *, emissivity: Any = 0.0, h: float = 0.0, law: Any = "constant", **more: Any
) -> Forcing:
    """Return a forcing of a flux (step, surface) with air of a temperature (step,), dry and calm
    unless stated.
    """
    flux = np.atleast_2d(np.asarray(flux, float))
    steps, surfaces = flux.shape
    each = {"wind_m_s": 0.0, "vapour_pa": 0.0, "pressure_hpa": 1013.0} | more
    upward = np.broadcast_to(np.asarray(each.pop("upward", 1.0), float), surfaces)
    wind = np.broadcast_to(np.asarray(each.pop("wind_coefficient", 3.0), float), surfaces)
    return Forcing(
        flux_w_m2=flux,
        air_k=np.broadcast_to(np.asarray(air_k, float), steps)[:, None],
        emissivity=np.broadcast_to(np.asarray(emissivity, float), surfaces),
        exchange=Exchange(law=law, constant_w_m2_k=h, wind_coefficient=wind, upward=upward),
        **{
            name: np.broadcast_to(np.asarray(value, float), steps)[:, None]
            for name, value in each.items()
        },
    )


def reference_day(
    absorptivity, emissivity, *, end_h: float = 24.0, shade=(24.0, 24.0)
) -> tuple[np.ndarray, Forcing]:
    """Return solar hours and forcing of the reference day, ending at an hour: Haurwitz sun, Ta 18 +
    6 sin, h 13.3.
    """
    hour = (end_h - np.arange(287, -1, -1) * 300.0 / HOUR) % 24.0
    latitude, declination = np.deg2rad(43.16), np.deg2rad(23.4)
    sine = np.sin(latitude) * np.sin(declination)
    sine = sine - np.cos(latitude) * np.cos(declination) * np.cos(2.0 * np.pi * hour / 24.0)
    up = np.maximum(sine, 1e-9)
    sun = np.where(
        (sine > 0.0) & ~((hour > shade[0]) & (hour <= shade[1])),
        1098.0 * up * np.exp(-0.057 / up),
        0.0,
    )
    air = 291.15 + 6.0 * np.sin(2.0 * np.pi * (hour - 9.0) / 24.0)
    emissivity = np.asarray(emissivity, float)
    flux = (
        np.asarray(absorptivity) * sun[:, None]
        + emissivity * 0.7743 * STEFAN_BOLTZMANN * air[:, None] ** 4
    )
    return hour, forcing_of(flux, air, emissivity=emissivity, h=13.3)
