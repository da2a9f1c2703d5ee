"""Moonless sky (airglow, zodiacal light, stars), twilight, and glow of towns: spectra and angular distributions."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from simulate.radiance.lamps.spectra import spectrum
from simulate.radiance.sky.moon import sun_spectrum
from simulate.radiance.spectrum import SourceSpectrum, planck, sum_spectra, table

Array = NDArray[np.floating]

BAND_NM = 50.0
# Airglow's lines that stand out of a 50 nm band, W m-2 sr-1: oxygen at 558 and 630 nm (160 and 115 rayleigh), sodium.
LINES_NM = (557.7, 589.3, 630.0)
LINES_W_M2_SR = (4.5e-8, 1.3e-8, 2.9e-8)


def van_rhijn(elevation_deg: ArrayLike) -> Array:
    """Return how much longer a slanting ray runs in a thin layer 90 km up, dimensionless: 1 at the zenith, 6 at 0.

    Notes
    -----
    (1 - (R cos h/(R + H))^2)^-1/2 (van Rhijn 1921).
    """
    grazing = np.cos(np.deg2rad(np.maximum(np.asarray(elevation_deg, float), 0.0)))
    return 1.0 / np.sqrt(1.0 - np.square(grazing * 6370.0 / (6370.0 + 90.0)))


@dataclass(frozen=True, eq=False)
class DarkSky:
    """Zenith radiance of the moonless sky in three parts, W m-2 sr-1, as it arrives at the ground in clear air."""

    # Their spectra.
    airglow: SourceSpectrum
    zodiacal: SourceSpectrum
    starlight: SourceSpectrum

    @property
    def total(self) -> SourceSpectrum:
        """Their sum."""
        return sum_spectra([self.airglow, self.zodiacal, self.starlight])


@cache
def dark_sky() -> DarkSky:
    """Return the three parts of a dark site's sky.

    Notes
    -----
    The sum is a measured spectrum; zodiacal light has the sun's spectrum and 30 % of the luminance, stars that of a
    black body of 4700 K and 20 %; airglow is the rest, so nearly all of the near infrared. The airglow varies twofold
    over the solar cycle; where on the sky the ecliptic and the Milky Way lie is left out.
    """
    smooth = _continuum()
    lines = SourceSpectrum(wavelength_nm=smooth.wavelength_nm, density=0.0 * smooth.density,
                     line_nm=LINES_NM, line_power=LINES_W_M2_SR)  # fmt: skip
    whole = sum_spectra([smooth, lines])
    sunlight = np.interp(smooth.wavelength_nm, sun_spectrum().wavelength_nm, sun_spectrum().density)
    zodiacal = _share(whole, sunlight, 0.30)
    # Colour of the stars' integrated light: redder than the sun.
    # Shares of the zenith's luminance, after Leinert et al., Astron. Astrophys. Suppl. 127, 1 (1998).
    starlight = _share(whole, planck(smooth.wavelength_nm, 4700.0), 0.20)
    rest = whole.density - zodiacal.density - starlight.density
    airglow = SourceSpectrum(
        wavelength_nm=whole.wavelength_nm, density=rest, line_nm=whole.line_nm, line_power=whole.line_power
    )
    return DarkSky(airglow, zodiacal, starlight)


def _share(whole: SourceSpectrum, shape: Array, luminance_share: float) -> SourceSpectrum:
    one = SourceSpectrum(wavelength_nm=whole.wavelength_nm, density=shape)
    return one.scale(luminance_share * whole.lumens / one.lumens)


def _continuum() -> SourceSpectrum:
    """Return the continuum of the table without the lines: the smoothest broken line with the bands' means."""
    bands = table("dark_sky")
    start, mean = bands["wavelength_nm"], 1e-9 * bands["radiance_1e-6_w_m2_sr_um"]
    for nm, power in zip(LINES_NM, LINES_W_M2_SR, strict=True):
        mean = mean - np.where((start <= nm) & (nm < start + BAND_NM), power / BAND_NM, 0.0)
    knots = np.arange(350.0, 1150.0 + 1.0, 10.0)
    rows = np.stack([_band_mean(knots, low) for low in start])
    # Least sum of squared second differences under the bands' means, which Lagrange's multipliers keep exactly.
    bend = np.diff(np.eye(knots.size), 2, axis=0)
    flat = np.zeros((2, knots.size))
    flat[0, :2], flat[1, -2:] = (1.0, -1.0), (1.0, -1.0)
    system = np.block([[bend.T @ bend + 10.0 * flat.T @ flat, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    solved = np.linalg.solve(system, np.concatenate([np.zeros(knots.size), mean]))
    return SourceSpectrum(wavelength_nm=knots, density=solved[: knots.size])


def _band_mean(knots: Array, low_nm: float) -> Array:
    """Return the weights that average a broken line over a band; its ends are knots."""
    inside = (knots >= low_nm) & (knots <= low_nm + BAND_NM)
    weight = np.where(inside, 1.0, 0.0)
    weight[np.flatnonzero(inside)[[0, -1]]] = 0.5
    return weight / weight.sum()


# Zenith brightness, mag arcsec-2, over the depression d in degrees: a0 + a1 (d - 5) + a2 (d - 5)^2 for 5 <= d <= 15,
# in U, B, V, R, I (Patat, Ugolnikov and Postylyakov, Astron. Astrophys. 455, 385, 2006).
BANDS_NM = np.array([366.0, 438.0, 545.0, 641.0, 798.0])
A0 = np.array([11.78, 11.84, 11.84, 11.40, 10.93])
A1 = np.array([1.376, 1.411, 1.518, 1.567, 1.470])
A2 = np.array([-0.039, -0.041, -0.057, -0.064, -0.062])
# Flux of magnitude 0 in these bands, W m-2 nm-1 (Bessell, Castelli and Plez 1998).
ZERO_W_M2_NM = np.array([4.175e-11, 6.32e-11, 3.631e-11, 2.177e-11, 1.126e-11])
FIRST_DEG, TANGENT_DEG, LAST_DEG = 5.0, 12.0, 20.0
# Relative radiance 1 + RISE s^2 + 2.0 s^2 cos(azimuth from the sun), s the sine of the zenith angle: with a hemisphere
# of twice the zenith the illuminances of civil and nautical dusk come out, 3.4 and 0.008 lux.
RISE = 2.0


def twilight_magnitude(depression_deg: float) -> Array:
    """Return the zenith's brightness in U, B, V, R, I, mag arcsec-2, at a depression of the sun of 0 to 20 degrees."""
    if depression_deg < FIRST_DEG:
        # From sunset on the zenith dims so much per degree that a level place has 600 lux at sunset; above, the
        # glow fades out until daylight of `scattering` has taken over.
        return A0 - 0.85 * (FIRST_DEG - depression_deg)
    # Beyond 12 degrees the measured sky approaches its night level; the twilight is extrapolated with the slope there.
    x = min(depression_deg, TANGENT_DEG) - FIRST_DEG
    beyond = max(depression_deg - TANGENT_DEG, 0.0)
    return A0 + A1 * x + A2 * x**2 + beyond * (A1 + 2.0 * A2 * (TANGENT_DEG - FIRST_DEG))


def twilight_spectrum(elevation_deg: float, relative: float = 1.0) -> SourceSpectrum | None:
    """Return the zenith's radiance by twilight, W m-2 sr-1, or None, for an elevation and strength over the sun's.

    Notes
    -----
    Below -20 degrees there is none, above 0 it stays and fades out towards 10 degrees. The moon counts as a dim sun.
    """
    if elevation_deg <= -LAST_DEG or elevation_deg >= 10.0 or relative <= 0.0:
        return None
    magnitude = twilight_magnitude(max(-elevation_deg, 0.0))
    faded = 1.0 - max(elevation_deg, 0.0) / 10.0
    radiance = relative * faded * ZERO_W_M2_NM * (180.0 * 3600.0 / np.pi) ** 2 * 10.0 ** (-0.4 * magnitude)
    fine = np.arange(350.0, 1151.0, 10.0)
    return SourceSpectrum(wavelength_nm=fine, density=np.exp(np.interp(fine, BANDS_NM, np.log(radiance))))


def twilight_shape(direction: Array, towards: tuple[float, float, float]) -> Array:
    """Return radiance relative to the zenith's for directions (path, 3) and a body's direction, shape (path,)."""
    level = float(np.hypot(towards[0], towards[1]))
    sine = np.hypot(direction[:, 0], direction[:, 1])
    if level == 0.0:
        return 1.0 + RISE * sine**2
    # s cos(azimuth difference) is the projection on the body's azimuth.
    along = (direction[:, 0] * towards[0] + direction[:, 1] * towards[1]) / level
    return 1.0 + RISE * sine**2 + 2.0 * sine * along


@dataclass(frozen=True, kw_only=True)
class TownGlow:
    """Lamp light scattered by the air above a town.

    Notes
    -----
    exp(-h/height) exp(-(azimuth difference/half width)^2), an empirical shape.
    """

    azimuth_deg: float  # where the town lies, from north by east, degrees
    luminance_cd_m2: float  # at the horizon above it, cd m-2; a dark zenith has 2.4e-4
    # Where it has fallen to 1/e: upwards and sideways, degrees.
    height_deg: float = 10.0
    half_width_deg: float = 35.0
    lamp: str = "high-pressure-sodium"  # kind of its lamps, one of `lamps.spectra.KINDS`

    def __post_init__(self) -> None:
        if not self.luminance_cd_m2 >= 0.0:
            raise BadInput(f"luminance_cd_m2 must not be negative, got {self.luminance_cd_m2:g}")
        for name in ("height_deg", "half_width_deg"):
            if not getattr(self, name) > 0.0:
                raise BadInput(f"{name} must be positive, got {getattr(self, name):g}")
        _ = self.spectrum

    @property
    def spectrum(self) -> SourceSpectrum:
        """Radiance at the horizon above the town, W m-2 sr-1."""
        return spectrum(self.lamp, lumens=self.luminance_cd_m2)

    def shape(self, direction: Array) -> Array:
        """Return radiance relative to the maximum for directions (path, 3), shape (path,)."""
        elevation = np.rad2deg(np.arcsin(np.clip(direction[:, 2], 0.0, 1.0)))
        azimuth = np.rad2deg(np.arctan2(direction[:, 0], direction[:, 1])) - self.azimuth_deg
        aside = (azimuth + 180.0) % 360.0 - 180.0
        return np.exp(-elevation / self.height_deg - np.square(aside / self.half_width_deg))
