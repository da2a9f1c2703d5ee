"""Infrared transmittance and emission of the air near the ground, in fixed spectral bins.

The bins are those of `air.csv`: 0.15 to 0.35 um wide from 3 to 5 um, 0.5 um from 7.5 to 14 um. In
place of the law of that file, the MODTRAN 5 database of pyBSM (LeMaster and Eismann, Proc. SPIE
10204, 2017; Apache-2.0) serves as an optional extra. It is read from its files: pyBSM is not
imported, so that a folder of them serves as well where the package cannot be installed.
"""

from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from simulate.arrays import Array
from simulate.radiance.atmosphere import Atmosphere
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.radiance.outdoor.scene import Weather as State
from simulate.radiance.spectrum import band_radiance, band_radiance_slope
from simulate.thermal.thresholds import INFRARED, MODTRAN
from simulate.thermal.weather import Weather

# Windows of the infrared that the bins cover, um.
WINDOWS_UM = ((3.0, 5.0), (7.5, 14.0))
# Temperature to which the continuum's coefficients belong, K.
CONTINUUM_K = 296.0
# Extinction of rural haze at 70 to 80 % relative humidity over that at 0.55 um (LOWTRAN7), at 4 and
# at 10 um.
HAZE_MWIR, HAZE_LWIR = 0.111, 0.090
VISIBLE_NM = 550.0
# Air of the database at the ground: mid-latitude summer at sea level.
MODTRAN_K, MODTRAN_G_M3, MODTRAN_HPA = 294.2, 14.0, 1013.0
# Its visibilities, km, and their codes.
CODE_OF_KM = {5.0: 2, 23.0: 1}
# Paths used: height of the sensor and distance on the ground of its target, km. Towards the horizon
# the paths of the database are shorter than it says: 5 km from a sensor 2 m up has the visible
# transmittance of 3.7 km, 8 km from one 32.5 m up that of 7.8 km.
PATHS_KM = ((0.002, (0.0, 0.1, 0.5)), (0.0325, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)))
WAVELENGTH_UM = np.linspace(0.3, 14.0, 1371)
HOLDS = (
    "the MODTRAN database holds level paths to 8 km less than 100 m up, in air of 21 C with 14 "
    "g/m3 of water vapour (76 % humidity) at sea level, with visibilities of 5 to 23 km"
)


@cache
def _table() -> NDArray[np.void]:
    """Return `air.csv`: one row for each bin."""
    with (resources.files("simulate.thermal") / "air.csv").open(encoding="utf-8") as file:
        return np.genfromtxt(file, delimiter=",", names=True)


def bins_of(band_um: tuple[float, float]) -> tuple[float, ...]:
    """Return the edges of the bins that a band overlaps, um.

    Parameters
    ----------
    band_um
        Ends of the band, um.

    Raises
    ------
    BadInput
        If the band is empty or not inside one of the windows.

    Examples
    --------
    >>> bins_of((3.4, 4.9))
    (3.25, 3.5, 3.75, 4.0, 4.15, 4.5, 4.75, 5.0)
    """
    low, high = band_um
    if not any(first <= low < high <= last for first, last in WINDOWS_UM):
        windows = " or ".join(f"{first:g} to {last:g} um" for first, last in WINDOWS_UM)
        raise BadInput(f"an infrared band must lie within {windows}, got {low:g} to {high:g} um")
    table = _table()
    overlapping = table[(table["high_um"] > low) & (table["low_um"] < high)]
    return (*overlapping["low_um"].tolist(), float(overlapping["high_um"][-1]))


def _lines(depth: Array, saturation: Array, power: Array | float) -> Array:
    """Return the optical depth of lines that would have a depth if none of them saturated."""
    return saturation / power * np.expm1(power * np.log1p(depth / saturation))


@dataclass(frozen=True, kw_only=True)
class InfraredAir:
    """Homogeneous air near the ground, in bins.

    Parameters
    ----------
    edges_um
        Edges of the bins (`bins_of`), shape (bin + 1,), um.
    temperature_k
        Temperature, K.
    vapour_g_m3
        Water vapour, g m-3.
    visibility_km
        Distance at which a black object has a contrast of 2 % in the visible, km; None: no haze.
    """

    # What an image of this air should say about it.
    notes: ClassVar[tuple[str, ...]] = ()
    edges_um: tuple[float, ...]
    temperature_k: float
    vapour_g_m3: float
    visibility_km: float | None = None

    @property
    def low_um(self) -> Array:
        """Lower ends of the bins, shape (bin,), um."""
        return np.array(self.edges_um[:-1])

    @property
    def high_um(self) -> Array:
        """Upper ends of the bins, shape (bin,), um."""
        return np.array(self.edges_um[1:])

    @property
    def centre_nm(self) -> Array:
        """Middles of the bins, shape (bin,), nm."""
        return 500.0 * (self.low_um + self.high_um)

    @cached_property
    def rows(self) -> NDArray[np.void]:
        """Rows of `air.csv` of the bins."""
        table = _table()
        return table[np.searchsorted(table["low_um"], self.low_um)]

    @cached_property
    def haze_per_km(self) -> Array:
        """Extinction by haze, shape (bin,), per km."""
        relative = np.where(self.low_um < WINDOWS_UM[1][0], HAZE_MWIR, HAZE_LWIR)
        if self.visibility_km is None:
            return 0.0 * relative
        return relative * float(
            Atmosphere(visibility_km=self.visibility_km).haze_per_km(VISIBLE_NM)[0]
        )

    def depth(self, dry_km: ArrayLike, water_km: ArrayLike, continuum_km: ArrayLike) -> Array:
        r"""Return the optical depth of gases on paths, shape (path, bin), dimensionless.

        Parameters
        ----------
        dry_km, water_km, continuum_km
            Length of each path in air as at the ground for dry gases, lines of water and its
            continuum, shape (path,), km. They are the same on a level path.

        Notes
        -----
        .. math::
            D(A r, a, n) + D(B q r, b, 1/2) + C q^2 r \exp\left(s (1/T - 1/296)\right), \quad
            D(x, p, n) = \frac{p}{n} \left(\left(1 + x/p\right)^n - 1\right)

        with the water vapour q: lines are weak on short paths, where their depth grows with the
        range, and saturate beyond the depth p. n = 1/2 is the band model of Malkmus (J. Opt. Soc.
        Am. 57, 323, 1967); the bin of carbon dioxide's band at 4.3 um, of which some is opaque
        within metres, has n = 0.3.

        Fitted to MODTRAN 5.2 with 360 ppm of carbon dioxide at 294.2 K and 14 g m-3, 2 m to 8 km
        (database of pyBSM), and in other airs, 263 to 303 K and 20 to 100 % relative humidity, to
        LOWTRAN7, whose depth is multiplied by the 0.8th power of MODTRAN's over its own on that
        length at 294.2 K. The emission of a path is within 3.3 % of MODTRAN's over 0.1 to 8 km; the
        transmittance of a band is within 0.015 of LOWTRAN7's from 8 to 14 um, and up to 0.05 higher
        from 3 to 5 um, where MODTRAN's is.
        """
        dry_path, water, continuum = (
            np.asarray(km, float).reshape(-1, 1) for km in (dry_km, water_km, continuum_km)
        )
        row, vapour = self.rows, self.vapour_g_m3
        warmth = np.exp(row["continuum_k"] * (1.0 / self.temperature_k - 1.0 / CONTINUUM_K))
        return (
            _lines(row["dry_per_km"] * dry_path, row["dry_saturation"], row["dry_power"])
            + _lines(row["water_m3_per_g_km"] * vapour * water, row["water_saturation"], 0.5)
            + row["continuum"] * vapour**2 * warmth * continuum
        )

    def transmittance(self, range_m: ArrayLike) -> Array:
        """Return the transmittance of level paths of lengths (path,), m, shape (path, bin).

        Notes
        -----
        Slanted paths between heights less than 100 m apart count as level, and the earth is flat.
        """
        km = 1e-3 * np.asarray(range_m, float).reshape(-1)
        return np.exp(-self.depth(km, km, km) - self.haze_per_km * km[:, None])

    def black_body(self, temperature_k: ArrayLike) -> Array:
        """Return the radiance of a black body in the bins, W m-2 sr-1, shape (..., bin)."""
        return band_radiance(self.low_um, self.high_um, np.asarray(temperature_k, float)[..., None])

    def after_path(self, radiance: Array, range_m: ArrayLike) -> Array:
        """Return radiance (path, bin) after level paths of lengths (path,), m.

        Notes
        -----
        T L + (1 - T) B(air): air in thermal equilibrium emits what it absorbs; haze counts as
        absorbing.
        """
        transmittance = self.transmittance(range_m)
        return transmittance * radiance + (1.0 - transmittance) * self.black_body(
            self.temperature_k
        )

    def kelvin_per_radiance(self, temperature_k: float) -> float:
        """Return the change of temperature of a black body that changes its radiance in all bins by
        1 W m-2 sr-1, K.
        """
        return 1.0 / float(band_radiance_slope(self.edges_um[0], self.edges_um[-1], temperature_k))


@dataclass(frozen=True, kw_only=True)
class ModtranAir(InfraredAir):
    """Air near the ground whose transmittance is that of MODTRAN's paths; the sky's depth stays
    that of the band model.

    Parameters
    ----------
    path_m
        Lengths of the paths, rising, shape (path,), m.
    path_depth
        Optical depth of each, haze included, shape (path, bin), dimensionless.
    """

    notes: ClassVar[tuple[str, ...]] = (
        "transmittance of paths: MODTRAN 5.2.1, mid-latitude summer, rural haze (database of "
        "pyBSM); the paths emit as black bodies of the scene's air do, for the database has the "
        "emission of air 1 km up, 4.5 K colder",
    )
    path_m: Array = field(repr=False, compare=False)
    path_depth: Array = field(repr=False, compare=False)

    def transmittance(self, range_m: ArrayLike) -> Array:
        """Return the transmittance of level paths of lengths (path,), m, shape (path, bin).

        Notes
        -----
        The logarithm of the depth is linear in that of the length, below 2 m and beyond the longest
        path as well.
        """
        nodes_m, length = (
            np.log(self.path_m),
            np.log(np.maximum(np.asarray(range_m, float).reshape(-1), 1e-6)),
        )
        index = np.clip(np.searchsorted(nodes_m, length) - 1, 0, len(nodes_m) - 2)
        fraction = ((length - nodes_m[index]) / (nodes_m[index + 1] - nodes_m[index]))[:, None]
        depth = np.log(self.path_depth)
        return np.exp(-np.exp(depth[index] + fraction * (depth[index + 1] - depth[index])))

    def after_path(self, radiance: Array, range_m: ArrayLike) -> Array:
        """Return radiance (path, bin) after level paths of lengths (path,), m; longer ones than
        known are refused.
        """
        farthest = float(np.max(range_m, initial=0.0))
        if farthest > self.path_m[-1]:
            raise BadInput(f"{HOLDS}, got a surface {1e-3 * farthest:.3g} km away")
        return super().after_path(radiance, range_m)


def modtran_air(
    air: InfraredAir, scene: OutdoorScene, weather: Weather, height_m: float
) -> ModtranAir:
    """Return air with the transmittance of MODTRAN's paths for a scene that requests it.

    Parameters
    ----------
    air
        Bins, temperature and vapour of the scene's air.
    scene, weather
        The scene, and its weather up to its time.
    height_m
        Height of the camera above the ground, m.

    Raises
    ------
    BadInput
        If the database is missing or broken, or does not cover this air.

    Examples
    --------
    >>> air = modtran_air(sky.air, scene, weather, 2.0)  # doctest: +SKIP
    """
    assert scene.weather is not None
    visibility, pressure = scene.weather.visibility_km, float(weather.pressure_hpa[-1])
    differs = {
        f"air of {air.temperature_k - 273.15:.1f} C": abs(air.temperature_k - MODTRAN_K)
        > MODTRAN.air_k,
        f"{air.vapour_g_m3:.1f} g/m3 of water vapour": abs(air.vapour_g_m3 - MODTRAN_G_M3)
        > MODTRAN.vapour_g_m3,
        f"a pressure of {pressure:.0f} hPa": abs(pressure - MODTRAN_HPA) > MODTRAN.pressure_hpa,
        f"a visibility of {visibility:g} km": not min(CODE_OF_KM) <= visibility <= max(CODE_OF_KM),
        f"a camera {height_m:.0f} m up": height_m > MODTRAN.height_m,
    }
    if any(differs.values()):
        values = ", ".join(value for value, is_outside in differs.items() if is_outside)
        raise BadInput(f"{HOLDS}, got {values}")
    folder = _folder(scene, scene.weather)
    table = np.genfromtxt(
        folder / "fileDecoder.csv", delimiter=",", skip_header=1, usecols=(0, 1, 2, 3)
    )
    lengths = np.array(
        [np.hypot(height, km) for height, lengths_km in PATHS_KM for km in lengths_km]
    )
    hazy, clear = (_bin_depths(folder, table, code, air) for code in CODE_OF_KM.values())
    # The depth of haze is as the reciprocal of the visibility.
    inverse_km = [1.0 / km for km in CODE_OF_KM]
    fraction = (1.0 / visibility - inverse_km[1]) / (inverse_km[0] - inverse_km[1])
    return ModtranAir(
        edges_um=air.edges_um,
        temperature_k=air.temperature_k,
        vapour_g_m3=air.vapour_g_m3,
        visibility_km=air.visibility_km,
        path_m=1e3 * lengths,
        path_depth=fraction * hazy + (1.0 - fraction) * clear,
    )


def _folder(scene: OutdoorScene, state: State) -> Path:
    """Return the folder of the database: the scene's, or that of the package if it is installed."""
    if state.modtran_folder is not None:
        folder = scene.file(state.modtran_folder)
    else:
        package = find_spec("pybsm")
        if package is None or not package.submodule_search_locations:
            raise BadInput(
                'atmosphere = "modtran5" needs the database of pyBSM: pip install '
                "'charact[modtran5]', or name its "
                "folder atms as modtran_folder"
            )
        folder = Path(package.submodule_search_locations[0]) / "atms"
    if not (folder / "fileDecoder.csv").is_file():
        raise BadInput(
            f"the MODTRAN database must have a file fileDecoder.csv, got none in {folder}"
        )
    return folder


def _bin_depths(folder: Path, table: Array, code: int, air: InfraredAir) -> Array:
    """Return the optical depths of the paths in bins, as means of the transmittance by the air's
    black body.
    """
    position = (np.arange(INFRARED.bin_points) + 0.5) / INFRARED.bin_points
    um = air.low_um[:, None] + position * (air.high_um - air.low_um)[:, None]
    weight = band_radiance(um - 1e-3, um + 1e-3, air.temperature_k)
    weight /= weight.sum(axis=1, keepdims=True)
    depths = []
    for height, lengths_km in PATHS_KM:
        for km in lengths_km:
            transmittance = np.interp(
                um, WAVELENGTH_UM, _transmittance(folder, table, (height, km, code))
            )
            depths.append(
                -np.log(np.maximum((weight * transmittance).sum(axis=1), MODTRAN.negligible))
            )
    return np.maximum(depths, MODTRAN.negligible)


def _transmittance(folder: Path, table: Array, path: tuple[float, float, int]) -> Array:
    """Return the transmittance along a path of the database, by its height, distance and code,
    shape (wavelength,).
    """
    rows = table[np.isclose(table[:, 1:4], path, atol=1e-6).all(axis=1)]
    name = f"{int(rows[0, 0])}.bin" if len(rows) else "none"
    file = folder / name
    values = np.fromfile(file, np.float32) if file.is_file() else np.empty(0, np.float32)
    if values.size != 5 * len(WAVELENGTH_UM):
        raise BadInput(
            f"the MODTRAN database must have {5 * len(WAVELENGTH_UM)} numbers for the path from "
            f"{1e3 * path[0]:g} m up to {path[1]:g} km away, got {values.size} in {folder / name}"
        )
    # Five columns one after another, the first of them the transmittance.
    transmittance = values[: len(WAVELENGTH_UM)].astype(float)
    if not (
        np.isfinite(transmittance).all()
        and transmittance.min() >= 0.0
        and transmittance.max() <= 1.0 + 1e-3
    ):
        raise BadInput(
            f"transmittances of the MODTRAN database must lie between 0 and 1, got others in {file}"
        )
    return transmittance
