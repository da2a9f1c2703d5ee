"""Runner of the studies: `python -m benchmarks.studies list` and `python -m benchmarks.studies run
NAME [OPTIONS]`.
"""

import runpy
import sys
from dataclasses import dataclass

from labdata import BadInput


@dataclass(frozen=True, kw_only=True)
class Study:
    """A study: the module that measures it, its usual arguments, and what it keeps.

    Parameters
    ----------
    module, arguments
        Module to run, and arguments that the runner puts before those of the command line.
    about
        What it measures, which files it rewrites, and how long it takes on two cores.
    """

    module: str
    about: str
    arguments: tuple[str, ...] = ()


STUDIES = {
    "chart": Study(
        module="chart",
        about="error against time of the methods of a QUANTITY: study/; OPTIONS=--update stores it",
    ),
    "stability": Study(
        module="stability",
        about="breaking points of the methods of a QUANTITY: study/; 10 minutes to hours",
    ),
    "bar-bias": Study(
        module="bar_bias", about="bias of bar methods by cell: table, figure; 10 minutes"
    ),
    "dark-events": Study(
        module="dark_events_coverage", about="coverage of dark-event intervals: table; 20 minutes"
    ),
    "edge-calibration": Study(
        module="edge_ranks",
        about="simulation-based calibration of edges: table, figures; 5 minutes",
    ),
    "edge-coverage": Study(
        module="edge_coverage", about="coverage of edge intervals: table; 10 minutes"
    ),
    "edge-map": Study(
        module="edge_map", about="failure map of the edge methods: table, figure; 40 minutes"
    ),
    "edge-peers": Study(
        module="edge_peers",
        about="edge methods compared with other programs: table, figure; 5 minutes",
    ),
    "effect-selection": Study(
        module="effect_selection",
        about="renderings with neglected effects against exact ones: table, figure; 15 minutes",
    ),
    "fit-ranks": Study(
        module="fit_ranks",
        about="ranks of true parameters in fits of drawn numbers: printed; 3 to 10 minutes",
    ),
    "gain-map": Study(
        module="gain_map", about="failure map of the gain methods: table, figure; 30 minutes"
    ),
    "gain-sweeps": Study(
        module="gain_sweeps", about="coverage of gain sweeps: printed; 10 minutes"
    ),
    "held-out": Study(
        module="held_out_cases",
        about="choice of `auto` on cases that no chart used: table; 5 minutes",
    ),
    "infrared-settings": Study(
        module="infrared_settings",
        about=(
            "settings of the infrared renderer and where it could fail: page, figure, table; 6 "
            "minutes"
        ),
    ),
    "mtf-consistency": Study(
        module="consistency_table",
        arguments=("--keep", "--simulated", "100", "--workers", "2"),
        about="consistency of the targets of a session: table; 20 minutes",
    ),
    "power-injection": Study(
        module="power_injection",
        about="printed power of a validation against injected errors: table; 8 minutes",
    ),
    "spectrum-map": Study(
        module="spectrum_map", about="failure map of the noise spectrum: table, figure; 15 minutes"
    ),
    "strangers-bars": Study(
        module="strangers_bars", about="bars of other generators: printed; 15 minutes"
    ),
    "strangers-edges": Study(
        module="strangers_edges", about="edges of other generators: printed; 15 minutes"
    ),
    "strangers-halos": Study(
        module="strangers_halos", about="halos of other generators: printed; 20 minutes"
    ),
    "strangers-intensified": Study(
        module="strangers_intensified", about="tubes of other generators: printed; 20 minutes"
    ),
    "strangers-noise": Study(
        module="strangers_noise", about="flats of other generators: printed; 20 minutes"
    ),
    "strangers-points": Study(
        module="strangers_points", about="points of other generators: printed; 15 minutes"
    ),
    "temperature-settings": Study(
        module="temperature_settings",
        about="settings of the temperature solver: printed, figure; 1 minute",
    ),
    "validation-power": Study(
        module="validation_power",
        about="power of a validation by simulated sets: table, figure; 10 minutes",
    ),
    "fault-campaign": Study(
        module="benchmarks.studies.faults.campaign",
        arguments=("--strikes", "5", "--seed", "20260", "--keep", "docs/validation/faults.md"),
        about="random faults on the virtual bench: docs/validation/faults.md; 40 minutes",
    ),
    "invented-faults": Study(
        module="benchmarks.studies.faults.inventing",
        arguments=("--seconds", "600"),
        about="random programs of faults, those that fail shrunk: printed; 10 minutes",
    ),
    "rehearsal": Study(
        module="benchmarks.studies.faults.rehearsal",
        arguments=("--keep", "docs/validation/rehearsal.md"),
        about="unattended run with injected faults: docs/validation/rehearsal.md; 30 minutes",
    ),
    "figures-simulator": Study(
        module="benchmarks.figures.simulator", about="figures of the simulator page; 5 minutes"
    ),
    "figures-bloom": Study(
        module="benchmarks.figures.bloom", about="figures of the bloom page; 5 minutes"
    ),
    "figures-night-light": Study(
        module="benchmarks.figures.night_light", about="figures of the sky page; 2 minutes"
    ),
    "figures-night-scenes": Study(
        module="benchmarks.figures.night_scenes", about="figures of the scenes; 20 minutes"
    ),
    "fuzz": Study(module="tests.fuzz", about="mangled bytes for every external parser; an hour"),
    "acquisition": Study(
        module="benchmarks.acquisition",
        about="frame rate, storage and overhead of a step; 10 minutes",
    ),
    "frontier": Study(
        module="benchmarks.frontier", about="moment error against frame rate of the samplers: docs"
    ),
    "live-page": Study(
        module="benchmarks.live_page",
        arguments=("build/live-page",),
        about="live page in a browser; 2 minutes",
    ),
    "radiance-peers": Study(
        module="benchmarks.radiance",
        about="renderer against Mitsuba 3 (needs its own environment): docs; an hour",
    ),
}


def main() -> None:
    """List the studies, or run one."""
    words = sys.argv[1:]
    if words[:1] == ["list"]:
        for name, study in STUDIES.items():
            print(f"{name:22} {study.about}")
    elif len(words) >= 2 and words[0] == "run" and words[1] in STUDIES:
        study = STUDIES[words[1]]
        module = study.module if "." in study.module else f"benchmarks.studies.{study.module}"
        sys.argv = [module, *(words[2:] or study.arguments)]
        try:
            runpy.run_module(module, run_name="__main__", alter_sys=True)
        except BadInput as error:
            sys.exit(str(error))
    else:
        sys.exit(
            f"a study must be one of {', '.join(STUDIES)}, as `run NAME`, or `list`; got "
            f"{' '.join(words)!r}"
        )


if __name__ == "__main__":
    main()
