"""Where infrared pictures could fail: calm wind, thin metal, low sun, wet air, grazing angles,
weather of hours.
"""

import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from benchmarks.studies.temperature_settings import FINE_STEP_S, Day, last_k
from labdata import BadInput
from labdata.camera.parameters import Parameter
from labdata.serialiser import from_mapping
from simulate.radiance.brdf.microfacet import dielectric
from simulate.radiance.brdf.protocol import directions_at_cosine
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.outdoor.materials import MaterialSpec, Slab
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.radiance.sky.moon import ObserverLocation
from simulate.radiance.spectrum import STEFAN_BOLTZMANN, band_radiance, band_radiance_slope
from simulate.thermal.clear_day import clear_sun, sky_emissivity, solar_hour, sun_directions
from simulate.thermal.infrared_rendering import infrared_radiance
from simulate.thermal.infrared_sky import InfraredSky
from simulate.thermal.infrared_surfaces import infrared_brdf
from simulate.thermal.infrared_tracer import AIR
from simulate.thermal.slab import ZERO_C
from simulate.thermal.temperatures import Temperatures, temperatures_of
from simulate.thermal.thresholds import LIMITS
from tests.simulate.thermal.test_air import (
    LEVEL_PATHS,
    RANGES_M,
    SKIES,
    ZENITH_DEG,
    humid_air,
    sky,
    ways,
    weighted,
)
from tests.simulate.thermal.test_infrared_rendering import down, ground, look_of

Array = NDArray[np.floating]
PLACE = ObserverLocation(latitude_deg=43.16, longitude_deg=-77.61, altitude_m=150.0)
# The brightness temperature of the clear sky 2 degrees above the horizon by LOWTRAN7, K, of the
# first band of `SKIES`.
NEAR_HORIZON_K = {
    299.7: 296.8,
    294.2: 291.8,
    287.2: 283.1,
    288.2: 278.5,
    272.2: 257.3,
    257.2: 232.1,
}
VERDICTS = ("within", "flagged", "refused", "SILENT")


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What the renderer made of one case; `error` and `tolerance` in `unit`, None where it was
    refused.
    """

    axis: str
    case: str
    verdict: str
    error: float | None = None
    tolerance: float | None = None
    unit: str = "mK"
    said: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return it as plain numbers, of three digits, and words."""
        found = asdict(self)
        return {
            key: float(f"{value:.3g}") if isinstance(value, float) else value
            for key, value in found.items()
        }


def brightness_temperature(
    low_um: float, high_um: float, radiance: ArrayLike
) -> NDArray[np.float64]:
    """Return the temperature of the black body of a band radiance (W m-2 sr-1, above 0), K.

    Notes
    -----
    Newton's method on ln L against 1/T, which is nearly straight; relative error below 1e-12.
    """
    wanted = np.log(np.asarray(radiance, float))
    inverse = np.full(wanted.shape, 1.0 / 300.0)
    for _ in range(30):
        kelvin = 1.0 / inverse
        black_body_radiance = band_radiance(low_um, high_um, kelvin)
        slope = -band_radiance_slope(low_um, high_um, kelvin) * kelvin**2 / black_body_radiance
        # At most by a half at a time: the first guess may be far away.
        inverse *= np.clip(1.0 + (wanted - np.log(black_body_radiance)) / slope / inverse, 0.5, 2.0)
    return 1.0 / inverse


def judge(
    axis: str, case: str, error: float, tolerance: float, said: str = "", unit: str = "mK"
) -> Verdict:
    """Return the verdict on an error: within its tolerance, else flagged by what was said, else a
    silent failure.
    """
    verdict = "within" if abs(error) <= tolerance else "flagged" if said else "SILENT"
    return Verdict(
        axis=axis,
        case=case,
        verdict=verdict,
        error=float(error),
        tolerance=float(tolerance),
        unit=unit,
        said=said,
    )


def night(**weather: Any) -> dict[str, Any]:
    """Return the tables of a scene at night with a state of the weather."""
    return {
        "name": "stability",
        "place": {
            "latitude_deg": 43.16,
            "longitude_deg": -77.61,
            "altitude_m": 150.0,
            "time": "1998-06-24T02:00:00-04:00",
        },
        "weather": {"temperature_c": 16.0, "relative_humidity": 0.7, "wind_m_s": 1.0, **weather},
        "camera": {"position_m": [0, -20, 5], "look_at_m": [0, 0, 0]},
    }


def plates(base: dict[str, Any], *slabs: dict[str, Any]) -> OutdoorScene:
    """Return level plates of some slabs in the open, far apart."""
    materials = [
        {"label": slab["label"], "reflectance": [0.3], "slab": slab["label"]} for slab in slabs
    ]
    objects = [
        ground(slab["label"], 2.0, label=slab["label"], position_m=[50.0 * n, 0, 1])
        for n, slab in enumerate(slabs)
    ]
    tables = base | {"material": materials, "object": objects, "slab": list(slabs)}
    return from_mapping(tables, OutdoorScene, where="stability")


def slab(label: str, k: float, rho: float, c: float, mm: float, **more: Any) -> dict[str, Any]:
    """Return the table of a slab of one layer."""
    layer = {
        "conductivity_w_m_k": k,
        "density_kg_m3": rho,
        "specific_heat_j_kg_k": c,
        "thickness_mm": mm,
    }
    return {
        "label": label,
        "layer": [layer],
        "emissivity": 0.9,
        "absorptivity": 0.7,
        "back_w_m2_k": 0.0,
        **more,
    }


STEEL, CONCRETE = (
    slab("steel", 45.0, 7850.0, 470.0, 1.0),
    slab("concrete", 1.4, 2300.0, 880.0, 600.0),
)


def write_weather(
    folder: Path, name: str, moment: datetime, step_s: float, days: float, **changes: Any
) -> str:
    """Write weather of a clear day up to a moment, in rows that stamp their end, as the mean over
    five-minute steps.
    """
    fine = 300.0
    steps = round(days * 86400.0 / fine)
    times = [moment - timedelta(seconds=fine * (steps - 1 - n)) for n in range(steps)]
    hour = solar_hour(PLACE, times)
    sun, distance = sun_directions(PLACE, times)
    direct, diffuse = clear_sun(sun[:, 2], distance, PLACE.altitude_m, 3.8)
    air = 18.0 + 6.0 * np.sin(2.0 * np.pi * (hour - 9.0) / 24.0)
    columns = {
        "air_c": air,
        "dew_point_c": np.full(steps, 8.0),
        "wind_m_s": np.full(steps, 1.0),
        "direct_w_m2": direct,
        "diffuse_w_m2": diffuse,
    }
    columns["longwave_w_m2"] = sky_emissivity(
        columns["dew_point_c"] + ZERO_C, hour, 1000.0, 0.0
    ) * (STEFAN_BOLTZMANN * (air + ZERO_C) ** 4)
    for key, change in changes.items():
        columns[key] = np.broadcast_to(change(columns[key], np.arange(steps) - steps + 1), steps)
    each = round(step_s / fine)
    lines = [
        "# latitude_deg = 43.16, longitude_deg = -77.61, altitude_m = 150",
        f"time,{','.join(columns)}",
    ]
    for end in range(each - 1, steps, each):
        values = [
            columns[key][max(end - each + 1, 0) : end + 1].mean()
            if key in ("direct_w_m2", "diffuse_w_m2")
            else columns[key][end]
            for key in columns
        ]
        lines.append(f"{times[end].isoformat()},{','.join(f'{value:.4f}' for value in values)}")
    (folder / name).write_text("\n".join(lines) + "\n")
    return str(folder / name)


def at(moment: str, file: str) -> dict[str, Any]:
    """Return the tables of a scene with a weather file."""
    base = night(file=file)
    return base | {"place": base["place"] | {"time": moment}}


def last(found: Temperatures) -> dict[str, tuple[float, float]]:
    """Return the last mean of each object, C, and half of its 95 % interval, K."""
    means, sd = found.means_c()[2], found.last_sd_k()
    return {name: (float(mean[-1]), 1.96 * sd[name]) for name, mean in means.items()}


def worst(
    axis: str, case: str, found: Temperatures, exact: Temperatures, said: str = ""
) -> Verdict:
    """Return the verdict on the object that is furthest off beside its own 95 % interval."""
    pairs = [
        (1e3 * (c - last(exact)[name][0]), 1e3 * half) for name, (c, half) in last(found).items()
    ]
    error, half = max(pairs, key=lambda pair: abs(pair[0]) / max(pair[1], LIMITS.tolerance_mk))
    return judge(axis, case, error, max(half, LIMITS.tolerance_mk), said)


def calm(folder: Path) -> list[Verdict]:
    """Balance of an insulated plate against its closed equation: e L - e sigma T^4 = h(T) (T -
    Ta).
    """
    rows, moment = [], datetime.fromisoformat("1998-06-24T02:00:00-04:00")
    for wind in (0.0, 0.1, 0.5, 2.0, 10.0):
        constant: dict[str, Callable[[Array, Array], ArrayLike]] = {
            "air_c": lambda value, step: 10.0,
            "dew_point_c": lambda value, step: -20.0,
            "wind_m_s": lambda value, step, wind=wind: wind,
            "longwave_w_m2": lambda value, step: 260.0,
            "direct_w_m2": lambda value, step: 0.0,
            "diffuse_w_m2": lambda value, step: 0.0,
        }
        file = write_weather(folder, f"calm-{wind}.csv", moment, 300.0, 1.0, **constant)
        scene = plates(at(moment.isoformat(), file), STEEL | {"wind_coefficient": 3.0})
        air = 10.0 + ZERO_C

        def net(kelvin: float, wind: float = wind, air: float = air) -> float:
            convected = 1.81 / 2.382 * abs(kelvin - air) ** (1.0 / 3.0) + 3.0 * wind
            return 0.9 * (260.0 - STEFAN_BOLTZMANN * kelvin**4) - convected * (kelvin - air)

        ((celsius, half),) = last(temperatures_of(scene)).values()
        error = 1e3 * (celsius + ZERO_C - float(brentq(net, 200.0, air)))  # pyright: ignore[reportArgumentType]
        rows.append(judge("calm wind", f"{wind:g} m/s", error, 1e3 * half))
    return rows


def thin_metal() -> list[Verdict]:
    """Steel at sunrise by the step that ships and by a tenth of it."""
    rows = []
    for mm in (0.01, 0.1, 1.0, 5.0, 30.0):
        table = [(45.0, 7850.0, 470.0, mm, 0.7, 0.9, 0.0)]
        fine, found = (
            last_k(table, Day(step_s=step, end_h=6.0, h=2.0))[0]
            for step in (FINE_STEP_S, LIMITS.step_s)
        )
        base = night()
        base |= {"place": base["place"] | {"time": "1998-06-24T06:00:00-04:00"}}
        ((_, half),) = last(
            temperatures_of(plates(base, slab("steel", 45.0, 7850.0, 470.0, mm)))
        ).values()
        rows.append(judge("thin metal", f"{mm:g} mm at sunrise", 1e3 * (found - fine), 1e3 * half))
    return rows


def refracted_sunlight(light: InfraredSky, elevation_deg: float) -> Array:
    """Return the irradiance by the sun as a disc of 0.267 degrees behind refraction (Bennett 1982),
    W m-2, (bin,).
    """
    offset = 0.267 * (np.arange(41) - 20) / 20.5
    weight = np.sqrt(0.267**2 - offset**2)
    height = elevation_deg + offset
    height += 1.02 / np.tan(np.deg2rad(height + 10.3 / (height + 5.11))) / 60.0
    through = (
        light.clear_transmittance(np.sin(np.deg2rad(np.maximum(height, 0.0))))
        * (height > 0.0)[:, None]
    )
    straight = InfraredSky(air=light.air, sun=np.array([0.0, 0.0, 1.0]))
    outside = straight.sunlight / light.clear_transmittance(np.ones(1))[0]
    return outside * (weight @ through) / weight.sum()


def low_sun() -> list[Verdict]:
    """A wall of reflectance 0.12 that faces the sun, 3.4 to 4.1 um: no refraction and no disc,
    against both.
    """
    rows, air = [], humid_air((3.4, 4.1), 288.15, 0.7)
    for degrees in (-0.8, -0.4, 0.2, 0.8, 1.2, 2.0, 5.0, 10.0):
        direction = np.array([0.0, np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])
        light = InfraredSky(air=air, sun=direction if degrees > 0.0 else None)
        off = (light.sunlight - refracted_sunlight(light, degrees)).sum() * 0.12 / np.pi
        picture = infrared_notes(night(), sun=direction)
        said = next((note for note in picture if "without refraction" in note), "")
        error = 1e3 * off * air.kelvin_per_radiance(288.15)
        # A tenth of the sunlight's contribution, or half the NETD of 40 mK.
        whole = (
            1e3
            * refracted_sunlight(light, degrees).sum()
            * 0.12
            / np.pi
            * air.kelvin_per_radiance(288.15)
        )
        rows.append(
            judge("low sun", f"{degrees:g}°", error, max(0.1 * whole, LIMITS.tolerance_mk), said)
        )
    return rows


def infrared_notes(
    base: dict[str, Any], distance_m: float = 20.0, *, sun: Array | None = None
) -> tuple[str, ...]:
    """Return the notes of a picture of a plate that faces the camera at a distance, below the open
    sky.
    """
    from simulate.thermal.infrared_picture import notes_beyond_laws

    thing = {
        "label": "wall",
        "shape": "box",
        "size_m": [0.2 * distance_m, 1.0, 0.2 * distance_m],
        "material": "wall",
        "position_m": [0, distance_m, 0],
    }
    tables = base | {"material": [{"label": "wall", "library": "concrete"}], "object": [thing]}
    scene = from_mapping(tables, OutdoorScene, where="stability")
    view = Viewpoint(
        position_m=(0.0, 0.0, 0.1 * distance_m),
        forward=(0.0, 1.0, 0.0),
        shape=(8, 8),
        focal_px=(20.0, 20.0),
    )
    temperatures = temperatures_of(scene)
    picture = infrared_radiance(temperatures, scene, view, band_um=(8.0, 12.0), netd_k=0.5)
    if sun is None:
        return picture.notes
    return notes_beyond_laws(humid_air((3.4, 4.1), 288.15, 0.7), sun, view, picture.truth)


def wet_air() -> list[Verdict]:
    """A target 10 K above air: its apparent rise through level paths, against LOWTRAN7."""
    rows = []
    for kelvin, humidity, band, expected in LEVEL_PATHS:
        if kelvin not in (293.15, 303.15) or band != (8.0, 12.0):
            continue
        air = humid_air(band, kelvin, humidity)
        for range_m, found, exact in zip(
            RANGES_M, weighted(air, air.transmittance(RANGES_M)), expected, strict=True
        ):
            weather = night(temperature_c=kelvin - ZERO_C, relative_humidity=humidity)
            notes = infrared_notes(weather, range_m) if range_m >= 1000.0 else ()
            said = next((note for note in notes if "km away" in note), "")
            case = f"{kelvin - ZERO_C:.0f} °C, {100.0 * humidity:.0f} %, {1e-3 * range_m:g} km"
            rows.append(judge("wet air", case, 1e4 * (found - exact), 150.0, said))
    for celsius, humidity in ((34.0, 0.8), (40.0, 0.8), (-25.0, 0.7), (25.0, 0.08)):
        try:
            notes = infrared_notes(night(temperature_c=celsius, relative_humidity=humidity))
            said = next((note for note in notes if "transmittance was fitted" in note), "")
            verdict = "flagged" if said else "SILENT"
        except BadInput as error:
            verdict, said = "refused", str(error)
        case = f"{celsius:.0f} °C, {100.0 * humidity:.0f} %, no reference"
        rows.append(Verdict(axis="wet air", case=case, verdict=verdict, said=said))
    return rows


def grazing() -> list[Verdict]:
    """The sky towards the horizon against LOWTRAN7, worst of six atmospheres, and a glossy coat
    against Fresnel.
    """
    rows, firsts = [], {}
    for kelvin, water, band, expected in SKIES:
        firsts.setdefault(kelvin, (water, band))
        for degrees, exact in zip(ZENITH_DEG, expected, strict=True):
            if degrees in (75.0, 80.0, 85.0):
                light = sky(kelvin, water, band).radiance(ways([degrees])).sum(axis=1)
                rows.append(
                    (
                        degrees,
                        1e3 * (float(np.ravel(brightness_temperature(*band, light))[0]) - exact),
                    )
                )
    for kelvin, (water, band) in firsts.items():
        light = sky(kelvin, water, band).radiance(ways([88.0])).sum(axis=1)
        rows.append(
            (
                88.0,
                1e3
                * (
                    float(np.ravel(brightness_temperature(*band, light))[0])
                    - NEAR_HORIZON_K[kelvin]
                ),
            )
        )
    said = next((note for note in infrared_notes(night()) if "above the horizon" in note), "")
    found = []
    for degrees in (75.0, 80.0, 85.0, 88.0):
        error = max((error for at, error in rows if at == degrees), key=abs)
        found.append(
            judge(
                "85° from the zenith",
                f"sky at {degrees:g}°",
                error,
                3000.0,
                said if degrees > 85.0 else "",
            )
        )
    paint = MaterialSpec(
        label="enamel",
        reflectance=(0.1,),
        finish="glossy",
        roughness=0.01,
        refractive_index=1.5,
        slab="x",
    )
    coat = infrared_brdf(
        paint, Slab(above_air_k=Parameter(value=0.0), emissivity=Parameter(value=0.96))
    )
    for degrees in (60.0, 75.0, 85.0):
        cosine = np.cos(np.deg2rad([degrees]))
        error = (
            1.0
            - coat.albedo(directions_at_cosine(cosine), [10e3])[0, 0]
            - (1.0 - dielectric(cosine, 1.5)[0])
        )
        found.append(
            judge(
                "85° from the zenith",
                f"glossy coat at {degrees:g}°",
                error,
                0.02,
                unit="emissivity",
            )
        )
    return found


def bare_metal() -> list[Verdict]:
    """A plate of 10 °C under an even sky of 220 K against its closed form; the spectrum within bins
    is noted.
    """
    rows = []
    for emissivity in (0.02, 0.05, 0.1, 0.3):
        table = {"label": "plate", "temperature_c": 10.0, "emissivity": emissivity}
        surface = {
            "label": "plate",
            "reflectance": [0.5],
            "slab": "plate",
            "finish": "metal",
            "roughness": 0.2,
        }
        scene = from_mapping(
            night() | {"material": [surface], "object": [ground("plate")], "slab": [table]},
            OutdoorScene,
            where="s",
        )
        light = look_of(scene, down(), sky_k=220.0, without=(AIR,)).rows(0).radiance.sum(axis=1)
        closed = (1.0 - emissivity) * band_radiance(8.0, 12.0, 220.0) + emissivity * band_radiance(
            8.0, 12.0, 283.15
        )
        error = np.abs(
            brightness_temperature(8.0, 12.0, light) - brightness_temperature(8.0, 12.0, closed)
        ).max()
        rows.append(
            judge("bare metal", f"emissivity {emissivity:g}", 1e3 * error, LIMITS.tolerance_mk)
        )
    view = Viewpoint(
        position_m=(0.0, 0.0, 3.0), forward=(0.0, 0.0, -1.0), shape=(6, 8), focal_px=(20.0, 20.0)
    )
    tables = {"material": [{"label": "plate", "library": "aluminium"}], "object": [ground("plate")]}
    scene = from_mapping(night() | tables, OutdoorScene, where="s")
    picture = infrared_radiance(
        temperatures_of(scene), scene, view, band_um=(8.0, 12.0), netd_k=0.04
    )
    finer = next(effect for effect in picture.left_out if effect.name.startswith("bins finer"))
    said = f"{finer.name}: {finer.influence:g} mK" if finer.influence >= 100.0 else ""
    return [
        *rows,
        judge(
            "bare metal", "spectrum of sky and air within bins", 100.0, LIMITS.tolerance_mk, said
        ),
    ]


def hourly(folder: Path) -> list[Verdict]:
    """Sheet steel and concrete by weather of hours, against weather of five minutes."""
    rows = []

    def clouds(light: Array, step: Array) -> Array:
        """Clouds that pass for 20 minutes of each 40, the last of them now."""
        return light * np.where((-step // 4) % 2 == 0, 0.1, 1.0)

    for hour, change in (("02", None), ("06", None), ("13", None), ("19", None), ("13", clouds)):
        text = f"1998-06-24T{hour}:00:00-04:00"
        moment, files = datetime.fromisoformat(text), []
        for step_s in (300.0, 3600.0):
            changes = {} if change is None else {"direct_w_m2": change}
            name = f"{hour}-{step_s:g}-{change is None}.csv"
            files.append(write_weather(folder, name, moment, step_s, 1.25, **changes))
        exact, found = (temperatures_of(plates(at(text, file), STEEL, CONCRETE)) for file in files)
        said = next((note for note in found.balance.weather.notes if "in steps of" in note), "")
        case = f"{hour}:00{', clouds of 20 minutes' if change else ', clear'}"
        rows.append(worst("one-hour weather", case, found, exact, said))
    return rows


def history(folder: Path) -> list[Verdict]:
    """A file that is short, one with a gap, and one day after another that the file does not
    show.
    """
    rows, text = [], "1998-06-24T02:00:00-04:00"
    moment = datetime.fromisoformat(text)

    def dull(light: Array, step: Array) -> Array:
        return np.where(step < -288, 0.1 * light, light)

    whole = write_weather(folder, "whole.csv", moment, 300.0, 2.0, direct_w_m2=dull)
    short = write_weather(folder, "short.csv", moment, 300.0, 0.5)
    lines = Path(whole).read_text().splitlines(keepends=True)
    gap, day = folder / "gap.csv", folder / "day.csv"
    gap.write_text("".join(lines[:-100] + lines[-76:]))
    day.write_text("".join(lines[:2] + lines[-288:]))
    for case, file in (("12 hours", short), ("2 hours missing", str(gap))):
        try:
            temperatures_of(plates(at(text, file), STEEL, CONCRETE))
            rows.append(Verdict(axis="missing history", case=case, verdict="SILENT"))
        except BadInput as error:
            rows.append(
                Verdict(axis="missing history", case=case, verdict="refused", said=str(error))
            )
    found, exact = (
        temperatures_of(plates(at(text, file), STEEL, CONCRETE)) for file in (str(day), whole)
    )
    said = next((note for note in found.balance.weather.notes if "one day of weather" in note), "")
    rows.append(worst("missing history", "one day, the day before dull", found, exact, said))
    synthetic = temperatures_of(plates(night(), STEEL)).balance.weather.notes
    said = next((note for note in synthetic if "through the state" in note), "")
    rows.append(
        Verdict(
            axis="missing history",
            case="no file",
            verdict="flagged" if said else "SILENT",
            said=said,
        )
    )
    return rows


def sweep() -> list[Verdict]:
    """Return the verdicts along all axes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = (
            calm(folder),
            thin_metal(),
            low_sun(),
            wet_air(),
            grazing(),
            bare_metal(),
            hourly(folder),
        )
        return [row for part in (*parts, history(folder)) for row in part]


def text_of(rows: list[Verdict]) -> str:
    """Return the table of the page."""
    lines = ["| axis | case | error | tolerance | verdict | said |", "|---|---|---|---|---|---|"]
    for row in rows:
        numbers = [
            "–" if value is None else f"{value:.3g} {row.unit}"
            for value in (row.error, row.tolerance)
        ]
        lines.append(
            f"| {row.axis} | {row.case} | {' | '.join(numbers)} | {row.verdict} | "
            f"{row.said.partition(':')[0]} |"
        )
    count = {verdict: sum(row.verdict == verdict for row in rows) for verdict in VERDICTS}
    return "\n".join(
        [*lines, "", ", ".join(f"{verdict}: {number}" for verdict, number in count.items())]
    )
