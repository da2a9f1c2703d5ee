"""Frames of simulated cameras as a session, with descriptions, truth of each pixel and selected
effects.

The truth of a view is `truth.npz`, of a sensor of a rig `truth/NAME.npz`: the auxiliary layers at
the middles of the pixels, such as `range_m` (row, col) along the ray from the lens, and the
geometry that leads from pixels to places. Of a moving scene it is that of the first frame; frame 12
has its own in `truth-0012.npz` or `truth/NAME-0012.npz` if its view is another than that of the
frame before.

- `focal_px` (x, y): focal length over the pitch of columns and of rows, px; the axis meets the
  middle of the frame.
- `position_m` (3,): position of the lens (east, north, up), m.
- `rotation` (3, 3): world to camera; its rows are the directions to the right, down and ahead.
- `distortion_fraction`: radial distortion D of the truth's own rays, r' = r (1 + D (r/R)^2), R at
  the corner.
- `frame_distortion` (stage,): D of lens and taper, in the order of the light, by which a frame
  differs from the truth.
- `time_s`: time of the frame after the scene's time, s.

A pixel's middle at columns x and rows y from the middle of the frame lies at position_m + range_m
d, with d the unit vector along (x / focal_px[0], y / focal_px[1], 1) @ rotation where there is no
distortion.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labdata import Camera, SessionWriter, save_sensor, write_atomically
from labdata.settings import Progress, ignore_progress
from simulate.shot import Shot

if TYPE_CHECKING:
    from labdata.session_writer import SessionWriter
    from simulate.infrared_view import InfraredView
    from simulate.outdoor_rendering import RenderedView


def save_session(
    shot: Shot,
    description: Camera,
    out: Path,
    *,
    frames: int,
    seed: int,
    notes: tuple[str, ...] = (),
    progress: Progress = ignore_progress,
) -> None:
    """Simulate frames and store them as a session, one frame at a time, with effect selection and
    auxiliary layers.
    """
    video = description.video
    with SessionWriter.create(
        out,
        name=f"simulated {shot.kind}",
        sensor="sensor.toml",
        bit_depth=video.bit_depth,
        interlaced=video.interlaced,
    ) as writer:
        save_sensor(replace(shot.camera.description, maps=None), out / "sensor.toml")
        _save_stack(writer, shot, shot.kind, out / "truth", frames, seed, notes, progress)
        if shot.view is not None:
            save_view(shot.view, out, shot.delay_s, shot.frame_distortion)
        if shot.plan is not None:
            write_atomically(
                out / "economy.json", json.dumps(shot.plan.document(), indent=1).encode()
            )


def save_rig_session(
    shots: Mapping[str, Shot],
    descriptions: Mapping[str, Camera],
    out: Path,
    *,
    frames: int,
    seed: int,
    notes: Mapping[str, tuple[str, ...]],
    progress: Progress = ignore_progress,
) -> None:
    """Simulate frames of several sensors and store them as one session, each with a stack of its
    name.

    Descriptions, truth, selected effects of light and camera are files `NAME` in the folders
    sensor, truth, light and economy.
    """
    with SessionWriter.create(out, name="simulated scene") as writer:
        for name, shot in shots.items():
            description, files = descriptions[name], {}
            (out / "sensor").mkdir(exist_ok=True)
            described = replace(shot.camera.description, maps=None)
            save_sensor(described, out / "sensor" / f"{name}.toml")
            stack_fields = {
                "sensor": f"sensor/{name}.toml",
                "bit_depth": description.video.bit_depth,
            }
            _save_stack(
                writer,
                shot,
                name,
                out / "truth" / name,
                frames,
                seed,
                notes.get(name, ()),
                progress,
                **stack_fields,
            )
            if shot.view is not None:
                save_truth(
                    shot.view, out / "truth" / f"{name}.npz", shot.delay_s, shot.frame_distortion
                )
                files["light"] = shot.view.document()
            if shot.plan is not None:
                files["economy"] = json.dumps(shot.plan.document(), indent=1).encode()
            for folder, content in files.items():
                (out / folder).mkdir(exist_ok=True)
                write_atomically(out / folder / f"{name}.json", content)


def _save_stack(
    writer: "SessionWriter",
    shot: Shot,
    label: str,
    truth: Path,
    frames: int,
    seed: int,
    notes: tuple[str, ...],
    progress: Progress,
    **stack_fields: Any,
) -> None:
    """Simulate the frames of a stack and store them one at a time, with the truth of each further
    view.
    """
    views = 1

    def keep(number: int, view: "RenderedView | InfraredView") -> None:
        nonlocal views
        views += 1
        path = truth.with_name(f"{truth.name}-{number:04d}.npz")
        save_truth(view, path, shot.time_s(number), shot.frame_distortion)

    stream = shot.frames(seed=seed, count=frames, keep=keep)
    first_frame, record_fields = next(stream), {"target": shot.target, **stack_fields}
    with writer.begin_stack(
        label, shot.kind, first_frame.shape, first_frame.dtype, shot.conditions, **record_fields
    ) as stack:
        stack.append(first_frame, shot.delay_s, 0)
        for number, frame in enumerate(stream, 1):
            stack.append(frame, shot.time_s(number), number)
            progress(f"frame {number + 1} of {frames}", (number + 1) / frames)
        software = f"simulated by charact {version('charact')}, seed {seed}"
        stack.finish(
            notes=(software, *shot.notes, *_motion_notes(shot, views), shot.economy_note, *notes)
        )


def _motion_notes(shot: Shot, views: int) -> tuple[str, ...]:
    if shot.motion is None:
        return ()
    fast = (
        "; pulses of light by the fast sampler"
        if shot.exact and views > 1 and shot.camera.has_tube
        else ""
    )
    return (
        (
            f"a moving scene: {views} views, each with its truth; within an exposure the scene "
            f"stands still{fast}"
        ),
    )


def save_view(
    view: "RenderedView | InfraredView",
    out: Path,
    time_s: float = 0.0,
    frame_distortion: tuple[float, ...] = (),
) -> None:
    """Save the rendering of an outdoor scene: truth and selected effects; arguments as for
    `save_truth`.
    """
    save_truth(view, out / "truth.npz", time_s, frame_distortion)
    write_atomically(out / "light.json", view.document())


def save_truth(
    view: "RenderedView | InfraredView",
    path: Path,
    time_s: float,
    frame_distortion: tuple[float, ...],
) -> None:
    """Save the truth of a view's pixels with its geometry.

    Parameters
    ----------
    view, path
        The rendering, and the .npz file.
    time_s
        Time after the scene's time, s.
    frame_distortion
        Radial distortions of the camera's frame against the view, in the order of the light,
        dimensionless.
    """
    lens = view.viewpoint
    path.parent.mkdir(parents=True, exist_ok=True)
    geometry: dict[str, Any] = {
        "focal_px": np.asarray(lens.focal_px, float),
        "position_m": np.asarray(lens.position_m, float),
        "rotation": lens.axes,
        "distortion_fraction": float(lens.distortion_fraction),
        "frame_distortion": np.asarray(frame_distortion, float),
        "time_s": float(time_s),
    }
    view.picture.truth.save(path, geometry)
