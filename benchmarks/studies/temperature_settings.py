"""Error and time of the settings of the temperature solver, and where it breaks: calm, thin metal,
little history.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labdata.camera.parameters import Parameter
from simulate.radiance.outdoor.materials import Layer, Slab
from simulate.radiance.outdoor.scene import ConvectionLaw
from simulate.radiance.spectrum import STEFAN_BOLTZMANN
from simulate.thermal.slab import Columns, Exchange, Forcing, march, periodic_start
from simulate.thermal.thresholds import LIMITS

Array = NDArray[np.floating]
FIGURE = Path("docs/pictures/thermal/settings.png")
DAY_S = 86400.0
# Conductivity, density, specific heat, mm, absorptivity, emissivity, heat transfer behind.
MATERIALS = {
    "concrete": (1.4, 2300.0, 880.0, 600.0, 0.6, 0.92, 0.0),
    "asphalt": (0.75, 2120.0, 920.0, 600.0, 0.9, 0.95, 0.0),
    "dry soil": (0.30, 1600.0, 800.0, 600.0, 0.7, 0.94, 0.0),
    "steel, 5 mm": (45.0, 7850.0, 470.0, 5.0, 0.7, 0.90, 8.0),
}
STEPS_S, CELLS = (60.0, 300.0, 900.0, 1800.0, 3600.0), (5, 10, 15, 30, 45)
# The converged solution.
FINE_STEP_S, FINE_CELLS = 30.0, 60


@dataclass(frozen=True, kw_only=True)
class Day:
    """The reference day: latitude 43.16, declination 23.4, Haurwitz sun, air 18 + 6 sin C, sky
    emissivity 0.774.
    """

    step_s: float
    end_h: float = 2.0
    days: float = 1.0
    law: ConvectionLaw = "constant"
    h: float = 13.3
    wind_m_s: float = 0.0

    def forcing(self, slabs: list[tuple[float, ...]]) -> Forcing:
        """Return what acts on slabs, ending at an hour."""
        steps = round(self.days * DAY_S / self.step_s)
        hour = self.end_h - np.arange(steps - 1, -1, -1) * self.step_s / 3600.0
        latitude, declination = np.deg2rad([43.16, 23.4])
        level = np.cos(latitude) * np.cos(declination) * np.cos(2.0 * np.pi * hour / 24.0)
        up = np.maximum(np.sin(latitude) * np.sin(declination) - level, 1e-9)
        sun = 1098.0 * up * np.exp(-0.057 / up)
        air = 291.15 + 6.0 * np.sin(2.0 * np.pi * (hour - 9.0) / 24.0)
        absorptivity, emissivity = (np.array([slab[n] for slab in slabs]) for n in (4, 5))
        column = np.ones((steps, 1))
        return Forcing(
            flux_w_m2=absorptivity * sun[:, None]
            + emissivity * 0.7743 * STEFAN_BOLTZMANN * air[:, None] ** 4,
            air_k=air[:, None],
            wind_m_s=self.wind_m_s * column,
            vapour_pa=0.0 * column,
            pressure_hpa=1013.0 * column,
            emissivity=emissivity,
            exchange=Exchange(
                law=self.law,
                constant_w_m2_k=self.h,
                wind_coefficient=np.full(len(slabs), 3.0),
                upward=np.ones(len(slabs)),
            ),
        )


def columns_of(slabs: list[tuple[float, ...]], cells: int = LIMITS.cells) -> Columns:
    """Return the cells of slabs."""
    names = ("conductivity_w_m_k", "density_kg_m3", "specific_heat_j_kg_k", "thickness_mm")
    layers = [
        {name: Parameter(value=value) for name, value in zip(names, slab[:4], strict=True)}
        for slab in slabs
    ]
    pairs = zip(layers, slabs, strict=True)
    return Columns.of(
        [Slab(layer=(Layer(**layer),), back_w_m2_k=Parameter(value=s[6])) for layer, s in pairs],
        cells,
    )


def last_k(slabs: list[tuple[float, ...]], day: Day, cells: int = LIMITS.cells) -> Array:
    """Return the temperatures of faces at the end of the periodic day, shape (slab,), K."""
    return periodic_start(columns_of(slabs, cells), day.forcing(slabs), day.step_s)[0][-1]


def main() -> None:
    """Print the table of settings and the sweeps, and draw the figure."""
    slabs = list(MATERIALS.values())
    exact = last_k(slabs, Day(step_s=FINE_STEP_S), FINE_CELLS)
    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    settings, calm, thin, history = figure.subplots(2, 2).ravel()
    print(f"{'step, s':>8} {'cells':>6} {'ms':>7}  errors at 02:00, mK: {', '.join(MATERIALS)}")
    for step_s in STEPS_S:
        points = []
        for cells in CELLS:
            began = time.process_time()
            error = 1e3 * (last_k(slabs, Day(step_s=step_s), cells) - exact)
            points.append((1e3 * (time.process_time() - began), np.abs(error).max()))
            print(
                f"{step_s:8g} {cells:6} {points[-1][0]:7.1f}  "
                f"{' '.join(f'{one:+8.1f}' for one in error)}"
            )
        settings.plot(*np.transpose(points), "o-", label=f"{step_s:g} s", lw=1.2)
    settings.axhline(1e3 * 0.05, color="grey", ls=":")
    settings.set(
        xscale="log",
        yscale="log",
        xlabel="processor time of the start, ms",
        ylabel="largest error, mK",
    )
    settings.legend(title="step", fontsize=8)
    settings.set_title(f"four materials at 02:00, {', '.join(map(str, CELLS))} cells", fontsize=9)
    winds = np.array([0.0, 0.1, 0.3, 1.0, 3.0, 10.0])
    metal = {
        f"steel, {mm:g} mm": (45.0, 7850.0, 470.0, mm, 0.7, 0.9, 0.0) for mm in (0.1, 1.0, 30.0)
    }
    sweep(calm, winds, metal, lambda wind: {"law": "buoyant", "wind_m_s": wind}, "wind, m/s")
    thick = np.geomspace(0.01, 30.0, 8)
    by_step(
        thin,
        thick,
        lambda mm: (45.0, 7850.0, 470.0, mm, 0.7, 0.9, 0.0),
        "thickness of steel at h = 2 W/m2K, mm",
    )
    start_up(history, slabs, exact)
    figure.savefig(FIGURE, dpi=100, pil_kwargs={"optimize": True})


def sweep(
    axes: Any, values: Array, slabs: dict[str, tuple[float, ...]], settings: Any, label: str
) -> None:
    """Draw the error of the step that ships and of an hour's along an axis."""
    for step_s, style in ((LIMITS.step_s, "o-"), (3600.0, "s--")):
        error = []
        for value in values:
            table = list(slabs.values())
            fine = last_k(table, Day(step_s=FINE_STEP_S, **settings(value)))
            error.append(np.abs(last_k(table, Day(step_s=step_s, **settings(value))) - fine).max())
        axes.plot(values, 1e3 * np.array(error), style, label=f"{step_s:g} s")
        _report(f"{label}, step {step_s:g} s", values, error)
    axes.set(xlabel=label, ylabel="largest error, mK", yscale="log")
    axes.set_title(", ".join(slabs), fontsize=9)
    axes.legend(title="step", fontsize=8)


def by_step(axes: Any, values: Array, slab: Any, label: str) -> None:
    """Draw the error at sunrise, when thin metal changes fastest, along a property of a slab."""
    for step_s, style in ((LIMITS.step_s, "o-"), (3600.0, "s--")):
        error = []
        for value in values:
            days = [Day(step_s=step, end_h=6.0, h=2.0) for step in (FINE_STEP_S, step_s)]
            fine, found = (last_k([slab(value)], day)[0] for day in days)
            error.append(abs(found - fine))
        axes.plot(values, 1e3 * np.array(error), style, label=f"{step_s:g} s")
        _report(f"{label}, step {step_s:g} s", values, error)
    axes.set(xlabel=label, ylabel="error at 06:00, mK", xscale="log", yscale="log")
    axes.legend(title="step", fontsize=8)


def _report(label: str, values: Array, error_k: list[float]) -> None:
    print(
        f"{label}:",
        ", ".join(f"{v:.2g}: {1e3 * e:.1f} mK" for v, e in zip(values, error_k, strict=True)),
    )


def start_up(axes: Any, slabs: list[tuple[float, ...]], exact: Array) -> None:
    """Draw the error against the hours of history, from a uniform slab and from the periodic
    state.
    """
    columns, hours = columns_of(slabs), np.array([0.0, 6.0, 12.0, 24.0, 48.0, 120.0, 240.0])
    for name, style in (("uniform, at the air's temperature", "s--"), ("periodic", "o-")):
        error = []
        for length in hours:
            day = Day(step_s=LIMITS.step_s, days=max(length / 24.0, LIMITS.step_s / DAY_S))
            forcing = day.forcing(slabs)
            if name == "periodic":
                before = Day(step_s=LIMITS.step_s, end_h=2.0 - 24.0 * day.days).forcing(slabs)
                start = periodic_start(columns, before)[1]
            else:
                start = np.full((LIMITS.cells, len(slabs)), forcing.air_k[0, 0])
            error.append(np.abs(march(columns, forcing, start)[0][-1] - exact).max())
        axes.plot(hours, error, style, label=name)
        _report(f"history, h, {name}", hours, error)
    axes.axhline(0.05, color="grey", ls=":")
    axes.set(xlabel="hours of weather before 02:00", ylabel="largest error, K", yscale="log")
    axes.legend(title="start", fontsize=8)


if __name__ == "__main__":
    main()
