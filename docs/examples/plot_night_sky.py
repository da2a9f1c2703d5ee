"""
Light of the night
==================

Illuminance and spectrum of moonlight, dark sky and a sodium lamp at a place and time.
"""

from datetime import UTC, datetime

import numpy as np
from matplotlib import pyplot as plt

from simulate.radiance.atmosphere import Atmosphere
from simulate.radiance.lamps.distribution import Lamp, SpotBeam
from simulate.radiance.lamps.spectra import spectrum
from simulate.radiance.sky.moon import ObserverLocation
from simulate.radiance.sky.night_sky import NightSky
from simulate.radiance.spectrum import spectral_grid

# %%
# Sun and moon above the horizon, and the radiance of the sky straight up.
place = ObserverLocation(latitude_deg=43.16, longitude_deg=-77.61, altitude_m=150.0)
sky = NightSky.at(
    place, datetime(2024, 2, 24, 6, tzinfo=UTC), atmosphere=Atmosphere(visibility_km=15.0)
)
lamp = Lamp(
    flux=spectrum("high-pressure-sodium", lumens=9000.0), distribution=SpotBeam(half_angle_deg=60.0)
)

# %%
# Spectra are means over bands. The bands follow the lines of the sources and the quantum efficiency
# of the sensor.
wavelength_nm = spectral_grid(
    [*sky.sources(), lamp.flux], [450, 550, 750, 900, 940], [0.02, 0.2, 0.6, 0.15, 0.0]
)
up = np.array([[0.0, 0.0, 1.0]])
radiance = sky.radiance(up, wavelength_nm)[:, 0]
intensity = lamp.flux.on(wavelength_nm) * lamp.distribution.per_sr(up)
print(f"{len(wavelength_nm)} bands, {wavelength_nm[0]:.0f} to {wavelength_nm[-1]:.0f} nm")

figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
axes.step(wavelength_nm, radiance / radiance.max(), where="mid", label="sky straight up")
axes.step(
    wavelength_nm, intensity / intensity.max(), where="mid", label="high-pressure sodium lamp"
)
axes.set(xlabel="wavelength (nm)", ylabel="relative spectral radiance, intensity")
axes.legend()
