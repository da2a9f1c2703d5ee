"""What economy saves: random scenes as planned against everything kept, and what each effect costs.

`python -m benchmarks.economy` times random scenes, `--costs` the effects of the case study one by
one: with all of them minus without that one. Both time the set-up, from the photoelectrons of a
picture on, and frames after it.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from statistics import median
from typing import Any

import numpy as np

from labdata import Conditions, load_sensor
from simulate.camera import pattern, stage_image
from simulate.camera.camera import CameraModel
from simulate.camera.effect_bounds import (
    NoiseBudget,
    bound_effects,
    per_pixel,
    select_camera_effects,
)
from simulate.camera.fast_sampler import charge_distribution
from simulate.camera.scene_to_photoelectrons import photoelectrons_from_image
from tests.simulate.random_scenes import Scene, random_scene

FRAMES = 10
SCENES = 12
REPEATS = 5
# What the first scene of a process works out and keeps for the next.
KEPT = (
    pattern.phosphor_granularity,
    pattern.multifibre_transmission,
    pattern.multifibre_gain,
    pattern.multifibre_offsets,
    pattern.dark_signal_map,
    pattern.prnu_map,
    charge_distribution.unit_variance_quantiles,
    stage_image._transfer,  # pyright: ignore[reportPrivateUsage]
    stage_image._resampling,  # pyright: ignore[reportPrivateUsage]
)


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Seconds that a run took.

    Parameters
    ----------
    setup_s
        Until the frames could begin, s.
    frame_s
        Each frame, s.
    """

    setup_s: float
    frame_s: float

    @property
    def run_s(self) -> float:
        """Seconds of the set-up and `FRAMES` frames."""
        return self.setup_s + FRAMES * self.frame_s


def timed(
    camera: Callable[[], CameraModel],
    freed: Any,
    conditions: Conditions,
    *,
    chain: bool = False,
) -> Timing:
    """Time a camera that is made, or planned, in the set-up."""
    for worked_out in KEPT:
        worked_out.cache_clear()
    start = time.perf_counter()
    taking = camera()
    draw = taking.chain_frames if chain else taking.frames
    frames = draw(taking.to_mcp_input(freed, conditions), conditions, seed=1)
    next(frames)
    begun = time.perf_counter()
    for _ in islice(frames, FRAMES):
        pass
    frame_s = (time.perf_counter() - begun) / FRAMES
    return Timing(setup_s=begun - start - frame_s, frame_s=frame_s)


def compared(scene: Scene) -> tuple[Timing, Timing, int]:
    """Time a scene as planned and with everything kept by cell; and count what the plan left
    out.
    """
    freed = photoelectrons_from_image(scene.camera, scene.image_pe)

    def thinned() -> CameraModel:
        return select_camera_effects(scene.camera, freed, scene.conditions, scene.tolerance)[0]

    as_planned = timed(thinned, freed, scene.conditions)
    exact = timed(lambda: scene.camera, freed, scene.conditions, chain=True)
    return as_planned, exact, len(thinned().left_out)


def speed_ups(
    scenes: int, first: int, shape: tuple[int, int] | None = None
) -> Iterator[tuple[float, float]]:
    """Print a line for each random scene and yield how many times as fast it was, with its set-up
    and each frame.
    """
    compared(random_scene(first, (48, 64)))
    print(
        f"{'scene':26} {'tolerance':>9} {'left out':>8} {'planned':>20} {'everything':>20} "
        f"{'times':>6} {'a frame':>8}"
    )
    for number in range(first, first + scenes):
        scene = random_scene(number, shape)
        ours, all_kept, left_out = compared(scene)
        ratio, of_frame = all_kept.run_s / ours.run_s, all_kept.frame_s / ours.frame_s
        row = f"{number} {scene.kind}, {scene.camera.description.phosphor.name}"
        times = "".join(f"{t.setup_s:9.2f} s +{1e3 * t.frame_s:6.1f} ms" for t in (ours, all_kept))
        line = (
            f"{row:26.26} {scene.tolerance:9.3f} {left_out:8} {times} {ratio:6.1f} {of_frame:8.1f}"
        )
        print(line, flush=True)
        yield ratio, of_frame


def costs(repeats: int) -> None:
    """Print what each effect of the case study costs once and a frame, for a million pixels."""
    camera = CameraModel(load_sensor("pulnix-ag5745ef3"), geometry=True, local_depletion=True)
    conditions = Conditions(mcp_v=800.0)
    # Many levels, each of which needs its law of pulses, and one lamp, so that wells overflow.
    image = np.broadcast_to(np.geomspace(1.0, 100.0, camera.shape[1]), camera.shape).copy()
    image[200:203, 300:303] = 3e4
    freed = photoelectrons_from_image(camera, image)
    timed(lambda: camera, freed, conditions)
    millions = image.size / 1e6
    for effect in bound_effects(NoiseBudget(camera, per_pixel(camera, freed), conditions)):
        without = replace(camera, left_out=frozenset({effect.name}))
        pairs = [
            (
                timed(lambda: camera, freed, conditions),
                timed(lambda c=without: c, freed, conditions),
            )
            for _ in range(repeats)
        ]
        once = max(median(kept.setup_s - left.setup_s for kept, left in pairs), 0.0) / millions
        frame = max(median(kept.frame_s - left.frame_s for kept, left in pairs), 0.0) / millions
        print(
            f"{effect.name:26} {once:6.2f} s once {1e3 * frame:7.2f} ms a frame, a million pixels",
            flush=True,
        )


def main() -> None:
    """Print the speed-ups and their median, or the costs."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--costs", action="store_true")
    asked.add_argument("--repeats", type=int, default=REPEATS)
    asked.add_argument("--scenes", type=int, default=SCENES)
    asked.add_argument("--first", type=int, default=0)
    asked.add_argument(
        "--small", action="store_true", help="frames of 96 x 128 instead of the cameras' own"
    )
    given = asked.parse_args()
    if given.costs:
        costs(given.repeats)
        return
    shape = (96, 128) if given.small else None
    whole, of_frame = zip(*speed_ups(given.scenes, given.first, shape), strict=True)
    print(
        f"medians: set-up and {FRAMES} frames {median(whole):.1f}, a frame {median(of_frame):.1f} "
        "times as fast"
    )


if __name__ == "__main__":
    main()
