"""Fusion of the hangar at 0200 against its truth: `python -m benchmarks.fusion_airfield [FRAMES]`.

Both cameras of one rig are simulated, and once more with people and drums painted over by their
surroundings. The truth is the mean of the same cameras without halo, smear, blooming, saturation
and lamps. Printed: restoration error of each method by zone, its ratio to the weighted addition,
and d' of each object in each band and in the colour picture.
"""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from charact.fitting.described_camera import describe_camera
from charact.fusion import (
    Band,
    FusionTruth,
    Source,
    align_bands,
    band_of,
    common_field,
    crop_band,
    detectability2,
    fill_holes,
    fuse_all,
    object_channels,
    read_source,
    truth_scores,
)
from charact.fusion.truth import find_zones
from simulate import api, conditions_of, load_described_camera, session_files
from simulate.camera.scene_to_photoelectrons import photoelectrons_from_radiance

SENSORS = ("pulnix-ag5745ef3", "vox-lwir-640")
METHODS = ("weighted", "laplacian", "guided-filter", "noise-aware", "noise-aware-colour")
# Objects that are detected, by their names in the scene, and the fewest pixels of one.
OBJECTS, LEAST_PX = ("people", "drums"), 60
BLOOMING = frozenset({"halo", "column blooming", "smear", "MCP saturation", "local gain depletion"})
# Half side of the window of a detector, px.
WINDOW_PX = 32


@dataclass(frozen=True)
class Scene:
    """Light of both cameras, with and without small objects, and the truth of the visible one."""

    shots: dict[str, Any]
    without_objects: tuple[
        Any, NDArray[Any]
    ]  # photoelectrons of the visible, signal of the thermal camera
    visible_truth: NDArray[Any]  # mean frame without blooming and lamps, DN above dark
    visible_mean: NDArray[Any]  # mean frame as it is, DN above dark
    objects: NDArray[np.int_]  # number of the object in the truth of the visible camera, 0: none


def paint_over(planes: NDArray[Any], hole: NDArray[np.bool_]) -> NDArray[Any]:
    """Return planes (band, row, col) with a hole filled from its surroundings."""
    scale = [max(float(np.median(plane)), 1e-30) for plane in planes]
    return np.stack(
        [
            fill_holes((plane / s).astype(np.float32), hole) * s
            for plane, s in zip(planes, scale, strict=True)
        ]
    )


def grown(mask: NDArray[np.bool_], px: int) -> NDArray[np.bool_]:
    """Return a mask with a border."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * px + 1, 2 * px + 1), np.uint8)) > 0


def objects_of(truth: Any) -> NDArray[np.int_]:
    """Return the number of the small object that each pixel of a truth shows, 0: none, shape (row,
    col).
    """
    names = [str(name) for name in truth.objects]
    chosen = np.isin(truth.object, [i for i, name in enumerate(names) if name in OBJECTS])
    _, labels, stats, _ = cv2.connectedComponentsWithStats(chosen.astype(np.uint8), connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= LEAST_PX
    large[0] = False
    return np.where(large, np.cumsum(large), 0)[np.asarray(labels, np.intp)]


def simulate_scene() -> Scene:
    """Render the hangar for both cameras: some minutes."""
    described = {name: load_described_camera(name) for name in SENSORS}
    request = api.SimulationRequest(source=Path("hangar"), tolerance=0.1, seed=0)
    shots = api.simulate_rig(
        request, {name: (one, conditions_of(one)) for name, one in described.items()}
    )
    return scene_of(shots)


def scene_of(shots: dict[str, Any]) -> Scene:
    """Return light without objects, and the truth, of rendered cameras."""
    visible, thermal = shots.values()
    cube, camera, conditions = visible.seen, visible.camera, visible.conditions
    objects = objects_of(visible.view.picture.truth)
    empty = replace(cube, radiance=paint_over(cube.radiance, grown(objects > 0, 2)))
    signal = thermal.seen.signal
    signal = paint_over(signal[None], grown(objects_of(thermal.view.picture.truth) > 0, 2))[0]
    # Lamps: radiance above ten times that of the brightest surface within the scale.
    bright = cube.radiance.sum(axis=0)
    unlit = replace(
        cube,
        radiance=paint_over(cube.radiance, grown(bright > 10.0 * np.percentile(bright, 98.0), 3)),
    )
    without = replace(camera, left_out=camera.left_out | BLOOMING)

    def mean(of: Any, light: Any) -> NDArray[Any]:
        at_mcp = of.to_mcp_input(photoelectrons_from_radiance(of, light, conditions), conditions)
        return of.mean_frame(at_mcp, conditions) - float(of.description.video.black_level_dn)

    # The saturated plate has one gain over the frame but for the surroundings of lamps: the truth
    # has the same.
    truth, seen = mean(without, unlit), mean(camera, cube)
    truth = truth * float(np.median(seen) / np.median(truth))
    freed = photoelectrons_from_radiance(camera, empty, conditions)
    return Scene(shots, (camera.to_mcp_input(freed, conditions), signal), truth, seen, objects)


def draw_frames(scene: Scene, count: int, *, objects: bool) -> list[NDArray[Any]]:
    """Return frames of the visible and of the thermal camera, shape (frame, row, col) each."""
    visible, thermal = scene.shots.values()
    if objects:
        return [
            np.stack(list(islice(visible.frames(seed=1, count=count), count))),
            np.stack(list(islice(thermal.frames(seed=1, count=count), count))),
        ]
    light, signal = scene.without_objects
    drawn = visible.camera.frames(light, visible.conditions, seed=2)
    return [
        np.stack(list(islice(drawn, count))),
        np.stack(list(islice(thermal.seen.camera.frames_of_signal(signal, seed=2), count))),
    ]


def sources_of(scene: Scene, folder: Path) -> list[Source]:
    """Return the cameras with all that a session states of them."""
    described = {name: load_described_camera(name) for name in SENSORS}
    session_files.save_rig_session(
        scene.shots, described, folder, frames=8, seed=0, notes=dict.fromkeys(SENSORS, ())
    )
    return [
        read_source(f"{folder}#{name}", band, describe=describe_camera)
        for name, band in zip(SENSORS, ("visible", "thermal"), strict=True)
    ]


def measure(
    scene: Scene, frames: int
) -> tuple[dict[str, dict[str, float]], dict[int, dict[str, float]]]:
    """Return restoration errors by method and zone, and d' of each object by band and in colour."""
    with tempfile.TemporaryDirectory() as folder:
        sources = sources_of(scene, Path(folder) / "night")
        first = [band_of(source, 0) for source in sources]
        aligned, places = align_bands(first, sources)
        region = common_field(places) or (0, 0, *first[0].image.shape)
        thermal_mean = band_of(sources[1], None)
        placement = places[1]
        assert placement is not None
        bands = [crop_band(band, region) for band in aligned]
    cut = np.s_[region[0] : region[0] + region[2], region[1] : region[1] + region[3]]
    kelvin = float(np.median(first[1].image / np.maximum(sources[1].stack.data[0], 1)))
    black = sources[0].black[0]
    visible, heat = scene.visible_truth[cut], placement.warp(thermal_mean.image)[cut]
    assert bands[0].clip is not None
    zones = find_zones(visible, np.maximum(scene.visible_mean[cut] - visible, 0.0), bands[0].clip)
    # Ground that clips without any lamp's halo is not hidden by lamps.
    lit = visible > 0.5 * bands[0].clip
    zones = {name: mask & ~lit for name, mask in zones.items()} | {"lit": lit}
    truth = FusionTruth(
        bands=np.stack([visible, heat]).astype(float),
        objects=np.zeros(visible.shape, int),
        zones=zones,
    )
    geometry = sources[0].geometry
    assert geometry is not None
    objects = geometry.on_frame(scene.objects)[cut]

    def redrawn(pictures: Sequence[NDArray[Any]], number: int) -> list[Band]:
        images = pictures[0][number][cut] - black, placement.warp(pictures[1][number] * kelvin)[cut]
        return [replace(band, image=image) for band, image in zip(bands, images, strict=True)]

    errors: dict[str, list[dict[str, float]]] = {name: [] for name in METHODS}
    outputs: dict[tuple[int, str], tuple[list[Any], list[Any]]] = {}
    for side, drawn in enumerate(
        (draw_frames(scene, frames, objects=True), draw_frames(scene, frames, objects=False))
    ):
        for number in range(frames):
            now = redrawn(drawn, number)
            names = METHODS if side == 0 and number < 4 else METHODS[-1:]
            found = {
                name: one.picture for name, one in fuse_all(now, names, registered=True).items()
            }
            for name in found if len(names) > 1 else ():
                rows = truth_scores(
                    found[name],
                    truth,
                    np.stack([band.image for band in now]),
                    rng=np.random.default_rng(0),
                )
                errors[name].append(
                    {row.quantity: row.value for row in rows if row.value is not None}
                )
            views = {
                "visible": now[0].image[..., None],
                "thermal": now[1].image[..., None],
                "colour": found[METHODS[-1]][..., :2],
            }
            for item in np.unique(objects[objects > 0]).tolist():
                row, col = (round(float(one.mean())) for one in np.nonzero(objects == item))
                window = np.s_[
                    max(0, row - WINDOW_PX) : row + WINDOW_PX,
                    max(0, col - WINDOW_PX) : col + WINDOW_PX,
                ]
                templates = object_channels(objects[window] == item)
                for name, planes in views.items():
                    outputs.setdefault((item, name), ([], []))[side].append(
                        np.einsum("krc,rcb->kb", templates, planes[window]).ravel()
                    )
    mean = {
        name: {key: float(np.mean([one[key] for one in rows])) for key in rows[0]}
        for name, rows in errors.items()
    }
    seen: dict[int, dict[str, float]] = {}
    for (item, name), (present, absent) in outputs.items():
        power = detectability2(np.array(present), np.array(absent))
        seen.setdefault(item, {})[name] = float(np.sqrt(max(power, 0.0)))
    return mean, seen


def report(errors: dict[str, dict[str, float]], seen: dict[int, dict[str, float]]) -> str:
    """Return both tables as text."""
    zones = ("dark", "halo", "core", "lit")
    lines = [
        f"{'error over the spread of the truth':36}" + "".join(f"{zone:>10}" for zone in zones)
    ]
    best = errors["noise-aware"]
    for name, own in errors.items():
        values = [own.get(f"restoration_error_{zone}", np.nan) for zone in zones]
        lines.append(f"{name:36}" + "".join(f"{value:10.3g}" for value in values))
    keys = [f"restoration_error_{zone}" for zone in zones]
    ratios = [errors["weighted"].get(key, np.nan) / best.get(key, np.nan) for key in keys]
    lines.append(
        f"{'weighted over noise-aware':36}" + "".join(f"{ratio:10.3g}" for ratio in ratios)
    )
    for item, own in seen.items():
        better = max(own["visible"], own["thermal"])
        lines.append(
            f"object {item}: d' visible {own['visible']:.3g}, thermal {own['thermal']:.3g}, "
            f"colour {own['colour']:.3g}, {own['colour'] / better:.2f} of the better band's"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    print(report(*measure(simulate_scene(), int(sys.argv[1]) if len(sys.argv) > 1 else 32)))
