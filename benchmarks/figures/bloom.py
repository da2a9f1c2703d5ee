"""Figures of docs/explanation/bloom.md from closed-form scenes; prints the numbers of that page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators import bloom
from charact.estimators.bloom.bloom_map import NEAR_PX, bloom_map, evidence_of, spread_from
from charact.estimators.bloom.lit_edge_halo import measure_lit_edge
from charact.method import Context
from charact.reporting import FIGURES, add_extent_data, white_style
from labdata import Conditions, FrameStack, Result, Session
from tests.truth.bloom import bloom_session
from tests.truth.bloom_extents import truth
from tests.truth.bloom_light import GLARE_SIDE_PX, BloomScene, radial_light
from tests.truth.sessions import session_in_memory, stack_in_memory

FOLDER = Path("docs/pictures/bloom")
SEED = 5
OVERLOADS = tuple(float(f"{one:.3g}") for one in np.geomspace(0.3, 1e5, 12))
SCENE = BloomScene(frames=8, wing_share=0.03, glare_fraction=0.02)
EDGE_LEVELS_DN = (150.0, 700.0, 4000.0)
MARGIN_PX = 75
DPI = 100


def main() -> None:
    """Write all pictures."""
    FOLDER.mkdir(exist_ok=True)
    context = Context(seed=SEED, full_scale_dn=SCENE.full_scale_dn)
    series = bloom_session(SCENE, OVERLOADS, np.random.default_rng(SEED))
    found = bloom.measure(series, method="series-forward", context=context)
    told(
        found,
        {name: value for name, value in truth(SCENE, 1.0).items() if not name.startswith("bloom")},
    )
    evidence = add_extent_data(series, found)
    known = [truth(SCENE, overload) for overload in OVERLOADS]
    extents = {
        name: [one[name] or np.nan for one in known]
        for name in ("bloom_diameter", "bloom_diameter_clip")
    }
    drawn("profiles", evidence["point-profile"])
    drawn("extents", {**evidence["bloom-series"], "truth": extents})
    drawn("frames", evidence["frames of the point series"])
    drawn("map", mapped(found))
    beside = measure_lit_edge(lit_door(), context=context)
    told(beside, {"halo_diameter": SCENE.halo_diameter_px, "halo_fraction": SCENE.halo_fraction})
    drawn("edge", beside.evidence["lit-edge"])


def drawn(name: str, data: Mapping[str, Any]) -> None:
    """Draw one piece of evidence into a file."""
    with white_style():
        FIGURES[str(data["figure"])][1](data).savefig(FOLDER / f"{name}.png", dpi=DPI)


def told(found: Result, true: Mapping[str, float]) -> None:
    """Print what was measured of the whole series beside what is true."""
    for m in found.measurements:
        if m.stack is None and m.value is not None and m.interval95 is not None:
            low, high = m.interval95
            beside = f", true {true[m.quantity]:.4g}" if m.quantity in true else ""
            print(
                f"{m.quantity} {m.value:.4g} [{low:.4g}, {high:.4g}] {m.unit}{beside}, {m.status}"
            )


def through(world: NDArray[np.float64], *, beyond_px: float = -1.0) -> NDArray[np.float64]:
    """A picture through the scene's spread without its glare, or the light that lands farther than
    a distance.
    """
    from scipy.signal import fftconvolve

    down, across = np.mgrid[-MARGIN_PX : MARGIN_PX + 1, -MARGIN_PX : MARGIN_PX + 1]
    distance = np.hypot(down, across)
    table = np.arange(0.0, 120.0, 0.05)
    kernel = np.interp(distance, table, radial_light(SCENE, table)) * (distance > beyond_px)
    wide = fftconvolve(np.pad(world, MARGIN_PX, mode="edge"), kernel, mode="same")
    return np.asarray(wide[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX], np.float64)


def street() -> NDArray[np.float64]:
    """A dark street: a wall in dim light, a lit door and three lamps, DN that each pixel's light
    makes.
    """
    world = np.full((200, 280), 5.0)
    world[60:, 150:] = 22.0
    world[110:180, 180:215] = 700.0
    for row, col, light in ((50, 60, 2e6), (70, 100, 2e5), (140, 60, 4e4)):
        world[row, col] = light
    return world


def mapped(found: Result) -> dict[str, Any]:
    """The bloom map of the street by the spread that the point series told, and the true one."""
    rng = np.random.default_rng(SEED)
    world = street()
    light, far = through(world), through(world, beyond_px=NEAR_PX)
    glare = SCENE.glare_fraction * world.sum() / GLARE_SIDE_PX**2
    noise = np.sqrt(0.4 * SCENE.photoelectron_dn * SCENE.excess * (light + glare) / SCENE.frames)
    signal = np.minimum(light + glare + noise * rng.standard_normal(world.shape), SCENE.span_dn)
    spread = spread_from(found, area_px=float(SCENE.rows * SCENE.cols), rng=rng)
    one = bloom_map(signal, spread, clip_dn=SCENE.span_dn, rng=rng)
    return {**evidence_of(one, signal), "truth": (far + glare) / (light + glare)}


def lit_door() -> Session:
    """A lit area with a straight edge at three levels, the faintest of them not cut."""
    rng = np.random.default_rng(SEED)
    rows, cols = np.indices((160, 220))
    inside = np.asarray(np.clip(90.3 + 0.06 * rows - cols + 0.5, 0.0, 1.0), np.float64)
    entries = []
    for number, level in enumerate(EDGE_LEVELS_DN):
        light = through(4.0 + level * inside)
        noise = np.sqrt(
            0.4 * SCENE.photoelectron_dn * SCENE.excess * light + SCENE.read_noise_dn**2
        )
        data = SCENE.dark_dn + light + noise * rng.standard_normal((SCENE.frames, *light.shape))
        stack = FrameStack(
            data=np.clip(np.rint(data), 0, 255).astype(np.uint8), full_scale_dn=SCENE.full_scale_dn
        )
        entries.append(
            stack_in_memory(
                "edge", stack, Conditions(illuminance_lux=1e-6 * level), label=f"door-{number}"
            )
        )
    dark = FrameStack(
        data=np.full((2, 160, 220), int(SCENE.dark_dn), np.uint8), full_scale_dn=SCENE.full_scale_dn
    )
    entries.append(stack_in_memory("dark", dark))
    return session_in_memory(entries)


if __name__ == "__main__":
    main()
