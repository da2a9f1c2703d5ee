"""Figures of docs/explanation/night-light.md: spectra, magnitude of the moon over phase, and four
skies.
"""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from labdata import load_sensor
from simulate.camera.tube_photometry import quantum_efficiency
from simulate.radiance.lamps.spectra import spectrum
from simulate.radiance.sky.moon import ObserverLocation, moon_spectrum
from simulate.radiance.sky.night_sky import NightSky, TownGlow, dark_sky
from simulate.radiance.spectrum import LUMENS_PER_WATT, SourceSpectrum, luminous_efficiency

matplotlib.use("Agg")
from matplotlib import pyplot as plt

FOLDER = Path("docs/pictures/night-light")
CAMERA = "pulnix-ag5745ef3"
# Lines are drawn as if a spectrometer of this resolution had seen them.
RESOLUTION_NM = 4.0
GRID = np.arange(380.0, 1000.1, RESOLUTION_NM)
EYE = np.arange(380.0, 771.0, 5.0)
ROCHESTER = ObserverLocation(latitude_deg=43.16, longitude_deg=-77.61, altitude_m=150.0)
SKIES = (
    ("moon of 4° phase, 59° up", NightSky.at(ROCHESTER, datetime(2024, 2, 24, 6, tzinfo=UTC))),
    ("sun 8° below the horizon", NightSky.at(ROCHESTER, datetime(1998, 6, 24, 1, 44, tzinfo=UTC))),
    ("new moon, 02:00 local", NightSky.at(ROCHESTER, datetime(1998, 6, 24, 6, tzinfo=UTC))),
    (
        "and a town in the north-west",
        NightSky.at(
            ROCHESTER,
            datetime(1998, 6, 24, 6, tzinfo=UTC),
            towns=(TownGlow(azimuth_deg=315.0, luminance_cd_m2=0.01),),
        ),
    ),
)
# Pixels along the side of a sky.
SKY_PX = 240
# Magnitude of 1 lux.
LUX_MAGNITUDE = -13.93


def main() -> None:
    """Write all pictures."""
    FOLDER.mkdir(exist_ok=True)
    spectra(FOLDER / "spectra.png")
    moon_phase(FOLDER / "moon-phase.png")
    skies(FOLDER / "skies.png")


def spectra(path: Path) -> None:
    """Draw natural light on open ground, and lamps per lumen, each with the tube's quantum
    efficiency.
    """
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(8.0, 8.4), sharex=True, constrained_layout=True
    )
    natural = [
        ("moon, phase 5°, above the air", moon_spectrum(5.0)),
        ("moon, phase 90°", moon_spectrum(90.0)),
        ("dark sky, π L of the zenith", dark_sky().total.scale(np.pi)),
        ("its zodiacal light and stars", _quiet(np.pi)),
    ]
    _curves(upper, natural)
    upper.set_yscale("log")
    upper.set_ylim(1e-9, 1e-4)
    upper.set_ylabel("irradiance, W m⁻² nm⁻¹")
    lamps = [
        ("2856 K", spectrum("incandescent")),
        ("high-pressure sodium", spectrum("high-pressure-sodium")),
        ("mercury", spectrum("mercury")),
        ("metal halide", spectrum("metal-halide")),
        ("LED, warm", spectrum("led-warm")),
    ]
    _curves(lower, [(name, one.scale(1e3)) for name, one in lamps])
    lower.set_yscale("log")
    lower.set_ylim(1e-3, 1.0)
    lower.set_ylabel("flux per lumen, mW nm⁻¹")
    lower.set_xlabel("wavelength, nm")
    lower.set_xlim(GRID[0], GRID[-1])
    plt.setp(lower.get_xticklabels(), visible=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _quiet(scale: float) -> SourceSpectrum:
    parts = NightSky(airglow=0.0).sources()[-1]
    return parts.scale(scale)


def _curves(axes: plt.Axes, lights: Sequence[tuple[str, SourceSpectrum]]) -> None:
    for name, light in lights:
        value = light.on(GRID)
        axes.plot(GRID, np.maximum(value, 1e-12), label=name, linewidth=1.4)
    tube = axes.twinx()
    tube.fill_between(
        GRID,
        100.0 * quantum_efficiency(load_sensor(CAMERA), GRID),
        color="0.5",
        alpha=0.18,
        linewidth=0,
    )
    tube.set_ylabel("quantum efficiency of the tube (grey), %")
    tube.set_ylim(0.0, 60.0)
    axes.legend(loc="upper left", fontsize=8, ncols=2)
    axes.grid(alpha=0.3)


def moon_phase(path: Path) -> None:
    """Draw the moon's magnitude over phase beside Allen's curve, waxing and waning, and the
    differences.
    """
    phase = np.linspace(0.0, 150.0, 301)
    allen = -12.73 + 0.026 * phase + 4e-9 * phase**4
    waxing, waning = (
        np.array([LUX_MAGNITUDE - 2.5 * np.log10(moon_spectrum(g, sign * g).lumens) for g in phase])
        for sign in (1.0, -1.0)
    )
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(7.0, 6.4), sharex=True, height_ratios=(2, 1), constrained_layout=True
    )
    upper.plot(phase, waxing, label="ROLO, before full moon")
    upper.plot(phase, waning, label="ROLO, after full moon")
    upper.plot(phase, allen, "k--", linewidth=1.0, label="Allen")
    upper.invert_yaxis()
    upper.set_ylabel("V magnitude at mean distance")
    upper.legend()
    lower.plot(phase, waxing - allen)
    lower.plot(phase, waning - allen)
    lower.axhline(0.0, color="k", linewidth=0.8, linestyle="--")
    lower.axvspan(1.55, 97.0, color="0.5", alpha=0.12)
    lower.set_ylim(0.45, -0.45)
    lower.set_ylabel("ROLO - Allen, mag")
    lower.set_xlabel("phase angle, degrees (grey: phases that ROLO measured)")
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.set_xlim(0.0, 150.0)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def skies(path: Path) -> None:
    """Draw the luminance of four skies as seen lying on one's back: north up, east left."""
    figure, every = plt.subplots(2, 2, figsize=(8.4, 8.0), constrained_layout=True)
    for axes, (name, sky) in zip(every.ravel(), SKIES, strict=True):
        picture = axes.imshow(
            np.log10(_luminance(sky)), cmap="viridis", extent=(90, -90, -90, 90), origin="lower"
        )
        for disc in sky.discs():
            x, y, z = disc.direction
            radius = np.rad2deg(np.arccos(z)) / np.hypot(x, y)
            axes.plot(x * radius, y * radius, "o", color="white", markersize=5)
        axes.set_title(f"{name}: {sky.illuminance_lux():.2g} lux", fontsize=9)
        axes.set_xlabel("east                zenith angle, degrees                west", fontsize=8)
        axes.set_ylabel("south               north", fontsize=8)
        figure.colorbar(picture, ax=axes, shrink=0.75, label="log₁₀ luminance, cd m⁻²")
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _luminance(sky: NightSky) -> NDArray[np.floating]:
    """Return luminance over x (east) and y (north) of an equidistant map, cd m-2; not a number
    outside the sky.
    """
    side = np.linspace(-90.0, 90.0, SKY_PX)
    # East is on the left when one looks up, and the picture's extent runs from east to west.
    east, north = np.meshgrid(side[::-1], side)
    zenith = np.deg2rad(np.hypot(east, north))
    around = np.arctan2(east, north)
    way = np.stack(
        [np.sin(zenith) * np.sin(around), np.sin(zenith) * np.cos(around), np.cos(zenith)], axis=-1
    )
    inside = zenith < np.pi / 2.0
    weight = LUMENS_PER_WATT * 5.0 * luminous_efficiency(EYE)
    picture = np.full(inside.shape, np.nan)
    picture[inside] = weight @ sky.radiance(way[inside], EYE)
    return picture


if __name__ == "__main__":
    main()
