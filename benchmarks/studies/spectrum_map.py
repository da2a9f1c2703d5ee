"""Where noise spectra break: a thousand random cameras, half of them with one thing wrong.

`make study NAME=spectrum-map` writes the table. A cell is a dark and flats whose pulses fall in
continuous space before a camera that blurs after its gain: blur, light, noise, frames, levels; what
breaks it goes from too little to matter to far too much.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import charact.estimators.mtf  # noqa: F401  # registers the methods
from benchmarks.studies import scenario_map
from benchmarks.studies.harness import attempt
from benchmarks.studies.scenario_map import (
    Breaking,
    Scenario,
    ScenarioOutcome,
    draw_case,
    draw_scenario,
    outcome_of,
)
from charact.method import Context
from charact.method.registry import methods_of_kind
from tests.truth.cases.case import Case
from tests.truth.scintillating_flats import ScintillatingFlats

TABLE = Path(__file__).with_name("tables") / "spectrum_map.json"
METHOD, QUANTITY = "noise-spectrum", "post_gain_mtf50"
CELLS, REPEATS = 1000, 1
# How forms are weighed, and what is flagged, was set looking at cells 0 to 999: nothing was on
# these.
FIRST = 1000
# What breaks noise spectra, from where it hardly matters to where nothing is left, and whether
# steps are even in ln.
BREAKING: Breaking = {
    "photoelectrons": (0.003, 0.3, True),
    "bright_photoelectrons": (10.0, 200.0, True),
    "read_noise_dn": (10.0, 500.0, True),
    "codes": (0.05, 5.0, True),
    "wide_cy_per_px": (0.015, 0.1, True),
    "sharp_cy_per_px": (0.35, 1.5, True),
    "exponent": (0.6, 1.2, False),
    "steep": (1.9, 4.0, False),
    "anisotropy": (0.3, 3.0, True),
    "halo_fraction": (0.005, 0.4, True),
    "halo_px": (1.5, 40.0, True),
    "coloured_px": (0.2, 3.0, True),
    "coloured_no_darks_px": (0.2, 3.0, True),
    "row_noise_dn": (0.3, 30.0, True),
    "electron_gain_dn": (0.05, 20.0, True),
    "rows": (32.0, 96.0, True),
    "frames": (1.0, 4.0, False),
    "lag": (0.01, 0.7, True),
    "lag_between_fields": (0.01, 0.7, True),
    "gamma": (0.45, 2.2, True),
    "saturation": (0.4, 3.0, True),
    "flicker": (0.003, 0.5, True),
    "vignetting": (0.05, 0.95, False),
    "ion_share": (1e-4, 0.03, True),
}
# Share of the light in a veil where its width is what breaks the method.
VEIL_SHARE = 0.1


def cell_of(number: int) -> Scenario[ScintillatingFlats]:
    """Return a cell from its number."""
    return draw_scenario(number, BREAKING, _scene_in_scope, _broken)


def _scene_in_scope(rng: np.random.Generator) -> ScintillatingFlats:
    light, side = float(np.exp(rng.uniform(np.log(0.3), np.log(10.0)))), int(rng.integers(96, 161))
    read_noise_dn = float(np.exp(rng.uniform(np.log(0.5), np.log(10.0))))
    return ScintillatingFlats(
        half_frequency_cy_per_px=float(np.exp(rng.uniform(np.log(0.08), np.log(0.4)))),
        exponent=float(rng.choice([2.0, rng.uniform(1.2, 1.9)])),
        anisotropy=float(np.exp(rng.uniform(np.log(0.8), np.log(1.25)))),
        photoelectrons=_levels(light, int(rng.integers(2, 5))),
        gain_dn=float(rng.uniform(10.0, 40.0)),
        electron_gain_dn=float(np.exp(rng.uniform(np.log(0.02), np.log(0.5)))),
        read_noise_dn=read_noise_dn,
        black_dn=60.0 + 5.0 * read_noise_dn,
        frames=int(rng.integers(4, 17)),
        rows=side,
        cols=side + int(rng.integers(0, 33)),
    )


def _levels(brightest: float, count: int) -> tuple[float, ...]:
    return tuple(float(level) for level in brightest * np.geomspace(0.25, 1.0, count))


def _broken(scene: ScintillatingFlats, axis: str, strength: float) -> ScintillatingFlats:
    """Return flats with one thing wrong."""
    levels = len(scene.photoelectrons)
    top = scene.full_scale_dn - scene.black_dn
    changed: dict[str, Any] = {
        "photoelectrons": {"photoelectrons": _levels(strength, levels)},
        "bright_photoelectrons": {
            "photoelectrons": _levels(strength, levels),
            "gain_dn": 0.4 * top / strength,
        },
        "read_noise_dn": {"read_noise_dn": strength, "black_dn": 60.0 + 5.0 * strength},
        "codes": {
            "gain_dn": strength,
            "read_noise_dn": 0.1 * strength,
            "electron_gain_dn": 0.0,
            "black_dn": 12.0,
            "full_scale_dn": 255.0,
        },
        "wide_cy_per_px": {"half_frequency_cy_per_px": strength},
        "sharp_cy_per_px": {"half_frequency_cy_per_px": strength},
        "steep": {"exponent": strength},
        "halo_px": {"halo_px": strength, "halo_fraction": VEIL_SHARE},
        "coloured_px": {"read_smoothing_px": strength},
        "coloured_no_darks_px": {"read_smoothing_px": strength, "darks": False},
        "rows": {"rows": round(strength), "cols": round(strength)},
        "frames": {"frames": round(strength)},
        "lag_between_fields": {"lag": strength, "interlaced": True, "rows": 2 * scene.rows},
        "saturation": {"gain_dn": strength * top / max(scene.photoelectrons)},
    }.get(axis, {axis: strength})
    return replace(scene, **changed)


def measure_scenario(
    number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD
) -> ScenarioOutcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.mtf50()
    rows = [
        attempt(methods_of_kind("post-gain")[method], case_of(cell, truth, i), Context(quick=quick))
        for i in range(repeats)
    ]
    return outcome_of(cell, rows, truth, truths=truths_of(cell.scene))


def truths_of(scene: ScintillatingFlats) -> tuple[float, float]:
    """Return the least and the largest MTF50 that are right, cy/px.

    Of light scattered after the gain all, a part, or none may be counted: the method says how much
    would not show.
    """
    return scene.mtf50(), replace(scene, halo_fraction=0.0).mtf50()


def case_of(cell: Scenario[ScintillatingFlats], truth: float, repeat: int) -> Case:
    """Return one drawing of a cell."""
    scene = cell.scene
    return draw_case(
        cell,
        repeat,
        kind="post-gain",
        quantity=QUANTITY,
        truth=truth,
        draw=scene.session_drawn,
        context={"full_scale_dn": scene.full_scale_dn, "interlaced": scene.interlaced},
    )


def main() -> None:
    """Make the map."""
    scenario_map.make_map(
        measure_scenario,
        kind="post-gain",
        method=METHOD,
        table=TABLE,
        cells=CELLS,
        repeats=REPEATS,
        about=__doc__,
        first=FIRST,
    )
    plot_map(json.loads(TABLE.read_text()), FIGURE)


FIGURE = Path("docs/pictures/mtf/spectrum-map.png")
LABELS = {
    "photoelectrons": "few photoelectrons (1/px)",
    "bright_photoelectrons": "many photoelectrons (1/px)",
    "read_noise_dn": "read noise (DN)",
    "codes": "gain on few codes (DN/photoelectron)",
    "wide_cy_per_px": "half frequency, wide blur (cy/px)",
    "sharp_cy_per_px": "half frequency, sharp blur (cy/px)",
    "exponent": "exponent of a blur with tails (1)",
    "steep": "exponent of a steep blur (1)",
    "anisotropy": "columns' over rows' frequency (1)",
    "halo_fraction": "light in a veil of sd 6 px (1)",
    "halo_px": "sd of a veil of a tenth (px)",
    "coloured_px": "sd of blurred read noise (px)",
    "coloured_no_darks_px": "the same without darks (px)",
    "row_noise_dn": "noise of whole rows (DN)",
    "electron_gain_dn": "CCD's gain (DN/electron)",
    "rows": "rows and columns (px)",
    "frames": "frames of each stack (1)",
    "lag": "lag (share of an exposure)",
    "lag_between_fields": "the same, of fields (share)",
    "gamma": "exponent of the response (1)",
    "saturation": "brightest level / full scale (1)",
    "flicker": "rms flicker of the light (1)",
    "vignetting": "light lost in the corners (1)",
    "ion_share": "share of pulses by ions (1)",
}


def plot_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `benchmarks.studies.spectrum_map`; returns the path of the PNG."""
    scope = (
        "half frequency after the gain (cy/px)",
        lambda number: cell_of(number).scene.half_frequency_cy_per_px,
    )
    return scenario_map.plot_map(
        found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=7
    )


if __name__ == "__main__":
    main()
