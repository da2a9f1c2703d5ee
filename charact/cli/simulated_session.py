"""What simulated light leaves on disk: frames as a session, the scene behind them, and the image after each stage."""

import json
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from charact import __version__
from charact.cli.simulation_sources import Shot, SimulationRequest, night_of
from labdata.conditions import Conditions

if TYPE_CHECKING:
    from charact.cli.simulation_sources import Description
    from charact.cli.stage_image_files import Stage
    from simulate.outdoor_rendering import RenderedView


def preview_into(
    out: Path, asked: SimulationRequest, description: "Description", conditions: Conditions, *, explain: bool
) -> tuple[str, ...]:
    """Keep what a scene out of doors shows in seconds, print its plan if asked for, and return what it leaves out."""
    view = night_of(asked, description, conditions).render(tolerance=asked.tolerance, seed=asked.seed, preview=True)
    if explain:
        print(view.plan.text())
    _save_view(view, out)
    return view.left_out


def save_frames(
    shot: Shot,
    description: "Description",
    out: Path,
    *,
    frames: int,
    seed: int,
    notes: tuple[str, ...] = (),
    progress: Callable[[str, float], None] = lambda sentence, share: None,
) -> None:
    """Expose frames and keep them as a session, each written before the next is drawn."""
    from labdata.atomic_write import write_atomically
    from labdata.sensors import save_sensor
    from labdata.store import SessionWriter

    stream = shot.frames(seed=seed)
    first, video = next(stream), description.video
    with SessionWriter.create(
        out, name=f"simulated {shot.kind}", sensor="sensor.toml", bit_depth=video.bit_depth, interlaced=video.interlaced
    ) as writer:
        save_sensor(description, out / "sensor.toml")
        kind, pixel = shot.kind, first.dtype
        with writer.begin_stack(kind, kind, first.shape, pixel, shot.conditions, target=shot.target) as stack:
            stack.append(first, 0.0, 0)
            for number, frame in enumerate(islice(stream, frames - 1), 1):
                stack.append(frame, number * shot.camera.frame_s, number)
                progress(f"frame {number + 1} of {frames}", (number + 1) / frames)
            stack.finish(
                notes=(f"simulated by charact {__version__}, seed {seed}", *shot.notes, *_economy(shot), *notes)
            )
        if shot.view is not None:
            _save_view(shot.view, out)
        if shot.plan is not None:
            write_atomically(out / "economy.json", json.dumps(shot.plan.document(), indent=1).encode())


def _save_view(view: "RenderedView", out: Path) -> None:
    """Keep what a scene out of doors shows: its radiance as a picture, the truth of each pixel, and the plan."""
    from charact.cli.radiance_image import save_radiance
    from labdata.atomic_write import write_atomically

    out.mkdir(parents=True, exist_ok=True)
    save_radiance(view.picture.cube, view.title, out / "radiance.png")
    view.picture.truth.save(out / "truth.npz")
    write_atomically(out / "light.json", view.document())


def _economy(shot: Shot) -> tuple[str, ...]:
    """What was left out, in a sentence for the session."""
    if shot.plan is None or shot.exact:
        return ("nothing left out",)
    names = ", ".join(effect.name for effect in shot.plan.left_out) or "nothing"
    share = f"{100.0 * shot.plan.influence:.2g} % of the temporal noise, of {100.0 * shot.plan.tolerance:g} % allowed"
    return (f"left out, together at most {share}: {names}; see economy.json",)


def save_stage_images(shot: Shot, description: "Description", folder: Path, *, seed: int) -> int:
    """Keep the image after each stage, as files for teaching and for finding faults; return how many."""
    from charact.cli.stage_image_files import save_stages

    title = f"{description.name}, one frame through the chain, seed {seed}"
    return save_stages(_stages(shot, seed), folder, title)


def _stages(shot: Shot, seed: int) -> "Iterator[Stage]":
    """The picture and what the camera expects of it, or the radiance from the lens on; then every stage's image."""
    from simulate.iiccd.stage_images import stage_images
    from simulate.radiance.cube import RadianceCube

    if isinstance(shot.seen, RadianceCube):
        yield from stage_images(shot.camera, shot.seen, shot.conditions, seed)
        return
    if shot.seen is not None:
        yield "picture", "photoelectrons per exposure and pixel, expected", shot.seen
    place = "at the plate" if hasattr(shot.camera, "mcp") else "in the chip"
    yield f"photoelectrons {place}", "photoelectrons per exposure and cell, expected", _inside(shot.light)
    yield from stage_images(shot.camera, shot.light, shot.conditions, seed)


def _inside(light: Any) -> Any:
    """The cells of the picture, without those beyond its border."""
    grid = light.grid
    top, left = grid.margin_rows * grid.per_row, grid.margin_columns * grid.per_column
    return light.values[..., top : top + grid.rows * grid.per_row, left : left + grid.columns * grid.per_column]
