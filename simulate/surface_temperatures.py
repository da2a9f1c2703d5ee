"""Surface temperatures of an outdoor scene: measurements, table of the day and map."""

import csv
import io
import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput, Conditions, Provenance, Result, measurement_from_sd, write_atomically
from labdata.settings import (
    Argument,
    ProgressSink,
    SceneCamera,
    Seed,
    WithinMk,
    documented,
    ignore_progress,
)
from labdata.short_repr import short_repr

if TYPE_CHECKING:
    from simulate.radiance.outdoor.scene import OutdoorScene


@dataclass(frozen=True, kw_only=True)
class Term:
    """A term of the heat balance, and whether it was kept."""

    name: str
    changes_mk: float  #: Largest change at the scene's time, mK
    kept: bool


@dataclass(frozen=True, kw_only=True)
class SurfaceTemperatures(Result):
    """Temperatures of a scene's surfaces, with their means at its time as measurements
    `surface_temperature` (C), whose `stack` is OBJECT:MATERIAL.
    """

    scene: str  #: Name of the scene
    moment: datetime  #: Local time of the scene
    hours: tuple[float, ...]  #: Hours of local time of the day before, the scene's time last
    air_c: NDArray[np.floating]  #: Temperature of the air at these hours, C
    surfaces_c: Mapping[
        str, NDArray[np.floating]
    ]  #: Mean of each OBJECT:MATERIAL at these hours, C
    sd_k: Mapping[str, float]  #: Standard deviation of the last mean of each OBJECT:MATERIAL, K
    map_k: NDArray[np.float32]  #: Temperatures in the view, (row, col), NaN for the sky, K
    terms: tuple[Term, ...]
    input_errors_mk: Mapping[str, float]  #: Largest change by 1 sd of each uncertain input, mK
    slabs: Mapping[str, Mapping[str, Any]]  #: Label and parameters of the slab of OBJECT:MATERIAL
    notes: tuple[str, ...]  #: Remarks on the weather

    __repr__ = short_repr

    def table(self) -> str:
        """Return the temperatures by hours as CSV: hour, air_c, and OBJECT:MATERIAL_c each."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(["hour", "air_c", *(f"{name}_c" for name in self.surfaces_c)])
        columns = (self.air_c, *self.surfaces_c.values())
        for hour, *values in zip(self.hours, *columns, strict=True):
            rows.writerow([f"{hour:g}", *(f"{value:.3f}" for value in values)])
        return text.getvalue()

    def save(self, out: str | Path) -> None:
        """Write temperatures.csv, temperatures.json (terms, slabs and notes) and map.npz into a
        folder.
        """
        folder, buffer = Path(out), io.BytesIO()
        document = {
            "weather": list(self.notes),
            "terms": [asdict(term) for term in self.terms],
            "standard_deviation_k": self.sd_k,
            "slabs": self.slabs,
        }
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / "temperatures.csv", self.table().encode())
        write_atomically(folder / "temperatures.json", json.dumps(document, indent=1).encode())
        np.savez_compressed(buffer, temperature_k=self.map_k)
        write_atomically(folder / "map.npz", buffer.getbuffer())


@documented
def temperatures(
    scene: Annotated[
        "str | Path | OutdoorScene",
        Argument("A scene, its TOML file, or the name of a shipped one."),
    ],
    *,
    sensor: SceneCamera = "pulnix-ag5745ef3",
    within_mk: WithinMk = 20.0,
    seed: Seed = 0,
    out: Annotated[
        str | Path | None,
        Argument("Folder for the table, the map and the numbers used (default: none)."),
    ] = None,
    progress: ProgressSink = ignore_progress,
) -> SurfaceTemperatures:
    """Compute surface temperatures of an outdoor scene over the day before its time, and their map.

    Returns
    -------
    SurfaceTemperatures
        `find("surface_temperature")` (C), `hours`, `surfaces_c`, `air_c` (C), `map_k` (K), `terms`.

    Raises
    ------
    BadInput
        If the scene is a lab bench, or lacks a place, weather with wind or the slab of a material.

    Examples
    --------
    The ground of a shipped scene, seen by a camera of few pixels:

    >>> from dataclasses import replace
    >>> from labdata.sensors import load_camera
    >>> from simulate.radiance.scene import load_scene
    >>> scene = load_scene("hangar")
    >>> yard = replace(scene, object=tuple(o for o in scene.object if o.shape == "ground"))
    >>> camera = load_camera("pulnix-ag5745ef3")
    >>> small = replace(camera, ccd=replace(camera.ccd, rows=16, columns=20))
    >>> warm = temperatures(yard, sensor=small)
    >>> warm.map_k.shape
    (16, 20)
    """
    from simulate.camera.scene_to_photoelectrons import camera_from_description
    from simulate.operating_conditions import load_described_camera
    from simulate.outdoor_rendering import OutdoorRendering
    from simulate.radiance.scene import LabScene, load_scene
    from simulate.thermal.temperatures import temperatures_of

    loaded = load_scene(Path(scene)) if isinstance(scene, str | Path) else scene
    if isinstance(loaded, LabScene):
        raise BadInput(
            f"surface temperatures need an outdoor scene, got the lab bench {loaded.name!r}"
        )
    camera = load_described_camera(str(sensor)) if isinstance(sensor, str | Path) else sensor
    view = OutdoorRendering(loaded, camera_from_description(camera), Conditions()).view
    progress("heat balance", 0.0)
    began_s = time.perf_counter()
    solved = temperatures_of(loaded, tolerance_mk=within_mk, seed=seed)
    (hours, air_c, surfaces_c), sd_k = solved.means_c(), solved.last_sd_k()
    seconds = time.perf_counter() - began_s
    balance, solution, weather = solved.balance, solved.solution, solved.balance.weather
    of_library = sorted({slab.source for slab in balance.slabs if slab.source})
    notes = (*weather.notes, *(f"slabs: {source}" for source in of_library[:1]))
    result = SurfaceTemperatures(
        measurements=tuple(
            measurement_from_sd(
                "surface_temperature",
                "C",
                float(surfaces_c[name][-1]),
                sd,
                method="slab",
                seconds=seconds,
                stack=name,
                notes=notes,
                provenance=Provenance(version=version("charact"), seed=seed),
            )
            for name, sd in sd_k.items()
        ),
        scene=loaded.name,
        moment=weather.moment,
        hours=tuple(hours),
        air_c=air_c,
        surfaces_c=surfaces_c,
        sd_k=sd_k,
        map_k=solved.map_k(view, lambda fraction: progress("map", fraction)),
        terms=tuple(
            Term(name=effect.name, changes_mk=effect.influence, kept=is_retained)
            for effects, is_retained in ((solution.effects, True), (solution.left_out, False))
            for effect in effects
        ),
        input_errors_mk={
            name: 1e3 * float(abs(error_k).max()) for name, error_k in solution.errors_k.items()
        },
        slabs={
            name: {"label": slab.label}
            | {key: asdict(number) for key, number in slab.parameters().items()}
            for name, slab in zip(balance.facets.names, balance.slabs, strict=True)
        },
        notes=tuple(weather.notes),
    )
    if out is not None:
        result.save(out)
    return result
