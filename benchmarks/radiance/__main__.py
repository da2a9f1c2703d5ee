"""`make study NAME=radiance-peers`: five scenes by us and by Mitsuba in turns, two threads each;
error over time, kept in docs.

References are kept in study/radiance; the first run makes them, which takes most of its time.
"""

import json
import os
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.radiance.chart import draw, table
from benchmarks.radiance.errors import Reference, reference
from benchmarks.radiance.export import export
from benchmarks.radiance.path_tracer import PathTracer, Timed
from benchmarks.radiance.scenes import Case, cases
from simulate.radiance.integrator.integrator_settings import (
    IntegratorSettings,
    SamplingSettings,
    workers,
)
from simulate.radiance.integrator.renderer import render_scene

KEPT = Path("study/radiance")
RESULTS, PAGE = Path("docs/validation/radiance-peers.json"), Path("docs/validation/radiance.md")
CHART = Path("docs/pictures/radiance/peers.png")
THREADS, REPEATS = 2, 1
# After a picture that took so much processor time, s, no stricter one of its family is made.
LONGEST_S = 12.0
# What a pixel may err by chance, as a share of its signal; rays of each pixel, of one at an edge
# and of each place that gathers, where all get as many; and samples of the path tracer's pixels.
ERRORS, FINE_ERRORS = (1.0, 0.1, 0.03, 0.01, 0.004), (0.03, 0.01, 0.004)
PLAIN = ((2, 8, 32), (4, 16, 64), (4, 64, 256), (8, 32, 256), (16, 64, 512), (32, 128, 1024))
THEIRS = (4, 16, 64, 256, 1024)
# Where neither comes near an RMSE of 0.01 by these, but both in a minute (on the road it would take
# Mitsuba hours): the error allowed and the most rays of a pixel and of a place, of one stricter
# setting, and samples of the path tracer.
AT_LENGTH = {"lab": ((0.004, 4096, 8192), 4096)}
REFERENCE_SAMPLES = {"yard": 10240, "lab": 8192, "hangar": 6144, "road": 2048, "room": 8192}


@dataclass(frozen=True)
class Setting:
    """A way to render: its name, which of them it is a stricter form of, and its rays."""

    name: str
    family: str
    rays: SamplingSettings


def settings(scene: str) -> Iterator[Setting]:
    """Ours: rays by the error that is asked for, or as many everywhere; finely, each pixel gathers
    for itself.
    """
    for fine in (False, True):
        finely = ", finely" if fine else ""
        for share in FINE_ERRORS if fine else ERRORS:
            rays = SamplingSettings(
                min_rays=2,
                edge=4,
                max_rays=1024,
                max_cache_rays=2048,
                refine=fine,
                error_limit=partial(_allowed, share),
            )
            yield Setting(f"{100.0 * share:g} %{finely}", f"errors{finely}", rays)
        for each, edge, shared in PLAIN:
            rays = SamplingSettings(
                min_rays=each, edge=edge, max_rays=1024, cache_rays=shared, refine=fine
            )
            yield Setting(f"{each}, {edge}, {shared} rays{finely}", f"plain{finely}", rays)
    if scene in AT_LENGTH:
        share, most, shared_most = AT_LENGTH[scene][0]
        allowed = partial(_allowed, share)
        rays = SamplingSettings(
            min_rays=2,
            edge=4,
            max_rays=most,
            max_cache_rays=shared_most,
            refine=True,
            error_limit=allowed,
        )
        yield Setting(f"{100.0 * share:g} %, finely, up to {shared_most} rays", "at length", rays)


def samples_of_theirs(scene: str) -> tuple[int, ...]:
    """The path tracer's samples of a pixel."""
    return (*THEIRS, AT_LENGTH[scene][1]) if scene in AT_LENGTH else THEIRS


def _allowed(share: float, signal: NDArray[np.floating]) -> NDArray[np.floating]:
    return (share * signal) ** 2


def ours(case: Case, rays: SamplingSettings, seed: int) -> Timed:
    """Return our picture."""
    # As plans follow light: to the end, or so many bounces.
    if case.max_bounces is None:
        effort = IntegratorSettings(max_bounces=200, roulette_depth=3)
    else:
        effort = IntegratorSettings(max_bounces=case.max_bounces, roulette_depth=1)
    start, used = time.perf_counter(), time.process_time()
    with workers(THREADS) as run:
        found = render_scene(
            case.stage, case.view, rays, effort, weight=np.ones(1), seed=seed, run=run
        )
    return Timed(found.signal, time.perf_counter() - start, time.process_time() - used)


def measured(case: Case, tracer: PathTracer, truth: Reference) -> Iterator[dict]:
    """Yield errors and times at all settings, both in turns; of several pictures the least time
    counts.
    """
    # The first picture of either compiles what the others use.
    ours(case, next(settings(case.name)).rays, 0)
    tracer.picture(case.name, THEIRS[0], 0)
    taken: dict[tuple[str, str], list[Timed]] = {}
    long = set()
    for how, samples in zip_longest(settings(case.name), samples_of_theirs(case.name)):
        if how is not None and how.family not in long:
            made = taken["ours", how.name] = [
                ours(case, how.rays, seed) for seed in range(1, REPEATS + 1)
            ]
            if min(picture.core_seconds for picture in made) > LONGEST_S:
                long.add(how.family)
        if samples is not None:
            pictures = [tracer.picture(case.name, samples, seed) for seed in range(1, REPEATS + 1)]
            taken["Mitsuba", f"{samples} samples"] = pictures
    for (who, setting), pictures in taken.items():
        errors = [truth.errors(made.image) for made in pictures]
        yield {
            "scene": case.name,
            "who": who,
            "setting": setting,
            "seconds": min(made.seconds for made in pictures),
            "core_seconds": min(made.core_seconds for made in pictures),
            **{name: float(np.median([error[name] for error in errors])) for name in errors[0]},
        }


def main() -> None:
    """Measure the scenes named, or all; draw, and write the table into the page."""
    chosen = [case for case in cases() if not sys.argv[1:] or case.name in sys.argv[1:]]
    with PathTracer(KEPT / "scenes") as tracer:
        for case in chosen:
            export(case, KEPT / "scenes")
            folder = KEPT / "references" / _digest(KEPT / "scenes" / case.name)
            truth = reference(case, tracer, folder, REFERENCE_SAMPLES[case.name])
            _keep(case.name, truth, list(measured(case, tracer, truth)), tracer.version)
    told = json.loads(RESULTS.read_text())
    draw(told, CHART)
    begin, end = "<!-- peers -->", "<!-- end peers -->"
    body = "\n\n".join((begin, table(told), end))
    PAGE.write_text(re.sub(f"{begin}.*{end}", lambda _: body, PAGE.read_text(), flags=re.S))
    print(table(told))


def _digest(folder: Path) -> str:
    """A name for a scene as it is written down: a reference serves no other."""
    return sha256(b"".join(path.read_bytes() for path in sorted(folder.iterdir()))).hexdigest()[:12]


def _keep(scene: str, truth: Reference, rows: list[dict], peer: str) -> None:
    """Put a scene's results in the place of older ones."""
    told = (
        json.loads(RESULTS.read_text())
        if RESULTS.exists()
        else {"rows": [], "references": {}, "load": {}}
    )
    told["references"][scene] = {"samples": truth.samples, "median_noise": truth.noise}
    told["rows"] = [row for row in told["rows"] if row["scene"] != scene] + rows
    told["peer"], told["load"][scene] = peer, round(os.getloadavg()[0], 1)
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
