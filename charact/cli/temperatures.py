"""The verb `temperatures`: surface temperatures of an outdoor scene over a day, and their map."""

import io
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message, print_result, progress_bar
from charact.cli.outputs import Force, require_free

if TYPE_CHECKING:
    import numpy as np

    from labdata.measurement import Result
    from simulate.thermal.temperatures import Temperatures


def temperatures(
    scene: Annotated[
        Path, typer.Argument(help="Outdoor scene (.toml, or name of a shipped scene).")
    ],
    out: Annotated[Path, typer.Argument(help="New folder for tables and figures.")],
    sensor: Annotated[
        str,
        typer.Option(
            help="Sensor description whose lens and pixels define the map: name or TOML file."
        ),
    ] = "pulnix-ag5745ef3",
    within_mk: Annotated[
        float,
        typer.Option(help="Error budget for neglected terms at the scene's time, mK.", min=0.0),
    ] = 20.0,
    seed: options.Seed = 0,
    force: Force = False,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain", help="Print the bound on each term and which terms are neglected."
        ),
    ] = False,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Compute surface temperatures of a scene over the day before its time, and their map at its
    time.

    Example: charact temperatures hangar warm --explain
    """
    with (
        exit_on_bad_input(str(scene), as_json=as_json, events=events),
        progress_bar(events=events) as progress,
    ):
        taken = out.exists() and (not out.is_dir() or any(out.iterdir()))
        other = (
            None
            if (out / "temperatures.json").is_file()
            else "something without a temperatures.json"
        )
        require_free(out, force=force, taken=taken, kept=lambda: other)
        import numpy as np

        from charact.cli.image_figures import save_png
        from labdata.conditions import Conditions
        from labdata.errors import BadInput
        from labdata.file_io import write_atomically
        from simulate.api import load_described_camera
        from simulate.camera.scene_to_photoelectrons import camera_from_description
        from simulate.outdoor_rendering import OutdoorRendering
        from simulate.radiance.scene import LabScene, load_scene
        from simulate.thermal.temperatures import temperatures_of

        loaded = load_scene(scene)
        if isinstance(loaded, LabScene):
            raise BadInput(
                f"surface temperatures need an outdoor scene, got the lab bench {loaded.name!r}"
            )
        view = OutdoorRendering(
            loaded, camera_from_description(load_described_camera(sensor)), Conditions()
        ).view
        progress("heat balance", 0.0)
        began = time.perf_counter()
        found = temperatures_of(loaded, tolerance_mk=within_mk, seed=seed)
        result = _result(found, time.perf_counter() - began, seed)
        kelvin = found.map_k(view, lambda fraction: progress("map", fraction))
        for note in found.balance.weather.notes:
            print_message(note, events=events)
        if explain:
            print("\n".join(_terms(found, within_mk)), file=sys.stderr if as_json else sys.stdout)
        title = (
            f"{loaded.name}, {found.balance.weather.moment.isoformat(sep=' ', timespec='minutes')}"
        )
        out.mkdir(parents=True, exist_ok=True)
        write_atomically(out / "temperatures.csv", _table(found).encode())
        write_atomically(out / "temperatures.json", json.dumps(_document(found), indent=1).encode())
        for name, figure in (
            ("temperatures.png", _curves(found, title)),
            ("map.png", _map(kelvin, title)),
        ):
            save_png(figure, out / name)
        content = io.BytesIO()
        np.savez_compressed(content, temperature_k=kelvin)
        write_atomically(out / "map.npz", content.getbuffer())
        if as_json:
            print_result(result, given=str(scene), verb="temperatures", as_json=True, events=events)
            return
        print("\n".join(_last_row(result)))
        print(
            f"{out}: temperatures.csv, temperatures.png, map.png, map.npz (kelvin), "
            f"temperatures.json (numbers used)"
        )


def _result(found: "Temperatures", seconds: float, seed: int) -> "Result":
    """Return the mean temperature of each OBJECT:MATERIAL at the scene's time as measurements."""
    from charact import __version__
    from labdata.measurement import Provenance, Result, measurement_from_sd

    of_library = {slab.source for slab in found.balance.slabs if slab.source}
    notes = (
        *found.balance.weather.notes,
        *(f"slabs: {source}" for source in sorted(of_library)[:1]),
    )
    _, _, surfaces = found.means_c()
    return Result(
        measurements=tuple(
            measurement_from_sd(
                "surface_temperature",
                "C",
                float(surfaces[name][-1]),
                sd,
                method="slab",
                seconds=seconds,
                stack=name,
                notes=notes,
                provenance=Provenance(version=__version__, seed=seed),
            )
            for name, sd in found.last_sd_k().items()
        )
    )


def _last_row(result: "Result") -> list[str]:
    """Return lines on surfaces at the scene's time, the warmest first, with 95 % intervals."""
    from charact.reporting.summary import LINES

    most = LINES - 10
    ordered = sorted(result.measurements, key=lambda one: -(one.value or 0.0))
    lines = [f"{'surface at the scene time':44}  {'mean, C':>8}  {'95 %':>6}"]
    for one in ordered[:most]:
        low, high = one.interval95 or (0.0, 0.0)
        lines.append(f"{one.stack or '':44}  {one.value:8.1f}  ±{0.5 * (high - low):5.1f}")
    more = len(ordered) - most
    return [*lines, *([f"and {more} more in temperatures.csv"] if more > 0 else [])]


def _terms(found: "Temperatures", within_mk: float) -> list[str]:
    """Return lines on retained and neglected terms."""
    solution = found.solution
    lines = [f"{'term':58}  {'changes at most, mK':>20}"]
    for effects, verdict in ((solution.effects, "kept"), (solution.left_out, "left out")):
        ordered = sorted(effects, key=lambda effect: -effect.influence)
        lines += [f"{effect.name:58}  {effect.influence:20.3g}  {verdict}" for effect in ordered]
    together = sum(effect.influence for effect in solution.left_out)
    lines.append(f"left out together: at most {together:.3g} mK; each may have {within_mk:g} mK")
    lines.append(f"{'uncertain input':58}  {'1 sd, at most, mK':>20}")
    errors = {name: 1e3 * float(abs(error).max()) for name, error in solution.errors_k.items()}
    return [
        *lines,
        *(
            f"{name:58}  {size:20.3g}"
            for name, size in sorted(errors.items(), key=lambda one: -one[1])
        ),
    ]


def _table(found: "Temperatures") -> str:
    import csv

    hours, air, surfaces = found.means_c()
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["hour", "air_c", *(f"{name}_c" for name in surfaces)])
    for row, hour in enumerate(hours):
        rows.writerow(
            [
                f"{hour:g}",
                f"{air[row]:.3f}",
                *(f"{values[row]:.3f}" for values in surfaces.values()),
            ]
        )
    return text.getvalue()


def _document(found: "Temperatures") -> dict:
    """Return terms, notes, and all slab parameters with basis and source, as plain values."""
    from dataclasses import asdict

    balance, solution = found.balance, found.solution
    slabs = dict(zip(balance.facets.names, balance.slabs, strict=True))
    return {
        "weather": list(balance.weather.notes),
        "terms": [
            {"name": effect.name, "changes_mk": effect.influence, "kept": kept}
            for effects, kept in ((solution.effects, True), (solution.left_out, False))
            for effect in effects
        ],
        "standard_deviation_k": found.last_sd_k(),
        "slabs": {
            name: {"label": slab.label}
            | {key: asdict(number) for key, number in slab.parameters().items()}
            for name, slab in slabs.items()
        },
    }


def _curves(found: "Temperatures", title: str) -> Any:
    """Plot temperatures of the air and of each material against hours before the scene's time."""
    from charact.cli.image_figures import WIDTH_INCHES, new_figure

    _, air, surfaces = found.means_c()
    hours = range(-24, 1)
    figure = new_figure(WIDTH_INCHES, 0.6 * WIDTH_INCHES)
    axes = figure.subplots()
    ordered = sorted(surfaces.items(), key=lambda item: -item[1][-1])
    for number, (name, values) in enumerate(ordered):
        style = ("-", "--", ":")[number // 10 % 3]
        axes.plot(
            hours,
            values,
            style,
            color=f"C{number % 10}",
            lw=1.3,
            label=f"{name}  {values[-1]:.1f} C",
        )
    axes.plot(hours, air, color="black", lw=2.0, label=f"air  {air[-1]:.1f} C")
    axes.set(
        xlabel="hours before the scene's time",
        ylabel="temperature, C",
        xlim=(-24, 0),
        xticks=range(-24, 1, 3),
    )
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(alpha=0.3)
    axes.legend(
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        fontsize=7,
        frameon=False,
        title="mean at that time",
    )
    return figure


def _map(kelvin: "np.ndarray", title: str) -> Any:
    """Plot the surface temperatures in the camera's view; the sky has none."""
    import numpy as np

    from charact.cli.image_figures import frame_figure

    celsius = kelvin - 273.15
    seen = celsius[np.isfinite(celsius)]
    # Percentiles of the map's pixels at the ends of its scale.
    low, high = np.percentile(seen, (0.5, 99.5)) if seen.size else (0.0, 1.0)
    label = "surface temperature, C (sky: grey)"
    figure = frame_figure(celsius, title, low, max(high, low + 1.0), label, cmap="inferno")
    figure.axes[0].set_facecolor("lightgrey")
    return figure
