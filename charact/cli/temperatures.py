"""The verb `temperatures`: surface temperatures of an outdoor scene over a day, and their map."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact.cli.options import Events, Json
from charact.cli.output import exit_on_bad_input, print_message, print_result, progress_bar
from charact.cli.outputs import Force, require_free
from labdata.settings import SceneCamera, Seed, Setting, WithinMk

if TYPE_CHECKING:
    import numpy as np

    from simulate.surface_temperatures import SurfaceTemperatures


def temperatures(
    scene: Annotated[
        Path, typer.Argument(help="Outdoor scene (.toml, or name of a shipped scene).")
    ],
    out: Annotated[Path, typer.Argument(help="New folder for tables and figures.")],
    sensor: SceneCamera = "pulnix-ag5745ef3",
    within_mk: WithinMk = 20.0,
    seed: Seed = 0,
    force: Force = False,
    explain: Annotated[
        bool, Setting("Print the bound on each term and which terms are neglected.")
    ] = False,
    as_json: Json = False,
    events: Events = False,
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
        import simulate
        from charact.cli.image_figures import save_png

        warm = simulate.temperatures(
            scene, sensor=sensor, within_mk=within_mk, seed=seed, progress=progress
        )
        for note in warm.notes:
            print_message(note, events=events)
        if explain:
            print("\n".join(_terms(warm, within_mk)), file=sys.stderr if as_json else sys.stdout)
        title = f"{warm.scene}, {warm.moment.isoformat(sep=' ', timespec='minutes')}"
        warm.save(out)
        save_png(_curves(warm, title), out / "temperatures.png")
        save_png(_map(warm.map_k, title), out / "map.png")
        if as_json:
            print_result(warm, given=str(scene), verb="temperatures", as_json=True, events=events)
            return
        print("\n".join(_last_row(warm)))
        print(
            f"{out}: temperatures.csv, temperatures.png, map.png, map.npz (kelvin), "
            f"temperatures.json (numbers used)"
        )


def _last_row(warm: "SurfaceTemperatures") -> list[str]:
    """Return lines on surfaces at the scene's time, the warmest first, with 95 % intervals."""
    from charact.reporting.summary import LINES

    count = LINES - 10
    ordered = sorted(warm.measurements, key=lambda m: -(m.value or 0.0))
    lines = [f"{'surface at the scene time':44}  {'mean, C':>8}  {'95 %':>6}"]
    for m in ordered[:count]:
        low, high = m.interval95 or (0.0, 0.0)
        lines.append(f"{m.stack or '':44}  {m.value:8.1f}  ±{0.5 * (high - low):5.1f}")
    more = len(ordered) - count
    return [*lines, *([f"and {more} more in temperatures.csv"] if more > 0 else [])]


def _terms(warm: "SurfaceTemperatures", within_mk: float) -> list[str]:
    """Return lines on retained and neglected terms."""
    lines = [f"{'term':58}  {'changes at most, mK':>20}"]
    for term in sorted(warm.terms, key=lambda term: (not term.kept, -term.changes_mk)):
        verdict = "kept" if term.kept else "left out"
        lines.append(f"{term.name:58}  {term.changes_mk:20.3g}  {verdict}")
    together = sum(term.changes_mk for term in warm.terms if not term.kept)
    lines.append(f"left out together: at most {together:.3g} mK; each may have {within_mk:g} mK")
    lines.append(f"{'uncertain input':58}  {'1 sd, at most, mK':>20}")
    largest = sorted(warm.input_errors_mk.items(), key=lambda error: -error[1])
    return [*lines, *(f"{name:58}  {size:20.3g}" for name, size in largest)]


def _curves(warm: "SurfaceTemperatures", title: str) -> Any:
    """Plot temperatures of the air and of each material against hours before the scene's time."""
    from charact.cli.image_figures import WIDTH_INCHES, new_figure

    hours = range(-24, 1)
    figure = new_figure(WIDTH_INCHES, 0.6 * WIDTH_INCHES)
    axes = figure.subplots()
    ordered = sorted(warm.surfaces_c.items(), key=lambda item: -item[1][-1])
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
    axes.plot(hours, warm.air_c, color="black", lw=2.0, label=f"air  {warm.air_c[-1]:.1f} C")
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
