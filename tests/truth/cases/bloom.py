"""Cases of the bloom methods: series inside their scope, and each way they break, past its breaking
point.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from labdata import Session
from tests.truth.bloom import bloom_session
from tests.truth.bloom_extents import plateau_per_px2, truth
from tests.truth.bloom_light import BloomScene
from tests.truth.cases.case import (
    Axes,
    AxisPosition,
    Case,
    cases_along_axes,
    cases_in_scope,
    scene_at,
)

# Levels that show the halo: its plateau over full scale, from the faintest to the brightest, two
# decades apart.
SHOWN = (0.008, 0.8)
BRIGHTEST = 1e6


@dataclass(frozen=True, kw_only=True)
class BloomSeries:
    """A point source, its levels as overloads, the faintest first, and whether a dark stack was
    taken.
    """

    scene: BloomScene
    overloads: tuple[float, ...]
    darks: bool = True

    def session_drawn(self, rng: np.random.Generator) -> Session:
        """Draw its frames."""
        return bloom_session(self.scene, self.overloads, rng, darks=self.darks)

    def truth(self, quantity: str, stack: str | None) -> float | None:
        """Return what should be found of the session, or of the stack of a label; None: nothing is
        known of it.
        """
        overload = self.overloads[0 if stack is None else int(stack.removeprefix("point-"))]
        known = _truth(self.scene, overload, self.overloads[0]).get(quantity)
        return known if known is not None and np.isfinite(known) else None


@lru_cache(maxsize=32)
def _truth(scene: BloomScene, overload: float, faintest: float) -> dict[str, float]:
    return truth(scene, overload, faintest=faintest)


def halo_overload(scene: BloomScene) -> float:
    """Return the overload at which the plateau of the halo meets full scale."""
    plateau = scene.row_pitch * scene.halo_fraction * plateau_per_px2(scene)
    return scene.span_dn / (plateau * scene.source_dn(1.0))


def scene_in_scope(
    rng: np.random.Generator, *, widest_px: float = 70.0, most_frames: int = 16
) -> BloomScene:
    """Return a source inside the scope: every other core has a wing; one camera in four has 12
    bits.
    """
    diameter = float(rng.uniform(25.0, widest_px))
    # Frames reach this far beyond the halo on every side, px.
    side = int(np.ceil(diameter + 2 * 22 + rng.uniform(0.0, 20.0)))
    fine = rng.random() < 0.25
    scale = 16.0 if fine else 1.0
    return BloomScene(
        rows=side,
        cols=side + 10,
        frames=int(rng.integers(4, most_frames + 1)),
        row=float((side - 1) / 2 + rng.uniform(-3.0, 3.0)),
        col=float((side + 9) / 2 + rng.uniform(-3.0, 3.0)),
        core_sigma_px=float(rng.uniform(1.0, 2.5)),
        wing_share=float(rng.uniform(0.02, 0.15)) if rng.random() < 0.5 else 0.0,
        wing_radius_px=float(rng.uniform(2.0, 4.0)),
        wing_exponent=float(rng.uniform(2.0, 3.0)),
        halo_diameter_px=diameter,
        halo_fraction=float(np.exp(rng.uniform(np.log(0.02), np.log(0.3)))),
        halo_elastic_share=float(rng.uniform(0.1, 1.0)),
        glare_fraction=float(rng.uniform(0.005, 0.05)),
        dark_dn=scale * float(rng.uniform(8.0, 20.0)),
        background_dn=scale * float(rng.uniform(2.0, 6.0)),
        full_scale_dn=4095.0 if fine else 255.0,
        bits=12 if fine else 8,
        photoelectron_dn=scale * float(rng.uniform(2.0, 4.0)),
        excess=float(rng.uniform(1.4, 2.0)),
        post_gain_sigma_px=float(rng.uniform(0.5, 0.8)),
        read_noise_dn=scale * float(rng.uniform(0.4, 0.8)),
        light_sd=0.02,
    )


def _levels_in_scope(scene: BloomScene, rng: np.random.Generator) -> tuple[float, ...]:
    """Overloads: two decades that show the halo, one where the core just clips, and one or two
    beyond.
    """
    meets = halo_overload(scene)
    low, high = (meets * plateau for plateau in SHOWN)
    showing = np.geomspace(low, high, 5) * np.exp(rng.uniform(-0.1, 0.1, 5))
    faint = float(np.exp(rng.uniform(np.log(0.5), np.log(max(0.6, min(20.0, 0.3 * low))))))
    saturating = min(BRIGHTEST, meets * float(np.exp(rng.uniform(np.log(2.0), np.log(50.0)))))
    levels = [faint, *showing, saturating]
    if rng.random() < 0.2 and saturating < BRIGHTEST:
        levels.append(BRIGHTEST)
    return tuple(sorted(float(level) for level in levels))


def series_in_scope(rng: np.random.Generator, **limits: Any) -> BloomSeries:
    """Return a series inside the scope; `limits` are those of `scene_in_scope`."""
    scene = scene_in_scope(rng, **limits)
    return BloomSeries(scene=scene, overloads=_levels_in_scope(scene, rng))


AXES: Axes = {
    "halo's share of the light": (
        "1",
        (0.001, 0.003, 0.01, 0.02, 0.1, 0.3),
        (0.02, 0.3),
        lambda x, _: {"halo_fraction": x},
    ),
    "halo diameter": (
        "px",
        (14, 20, 25, 45, 70, 90),
        (25, 70),
        lambda x, _: {
            "halo_diameter_px": x,
            "rows": int(x) + 48,
            "cols": int(x) + 48,
            "row": None,
            "col": None,
        },
    ),
    "elastic share": (
        "1",
        (0, 0.03, 0.1, 0.3, 1),
        (0.1, 1),
        lambda x, _: {"halo_elastic_share": x},
    ),
    "core": (
        "px, Gaussian sigma",
        (1, 1.7, 2.5, 4, 6),
        (1, 2.5),
        lambda x, _: {"core_sigma_px": x},
    ),
    "share of the core in its wing": (
        "1",
        (0, 0.1, 0.2, 0.4, 0.7),
        (0, 0.1),
        lambda x, _: {"wing_share": x},
    ),
    "levels": ("1", (1, 2, 3, 5, 8), (5, 8), lambda x, _: {}),
    "faintest level": (
        "halo's plateau over full scale",
        (0.001, 0.01, 0.1, 1, 10),
        (0.01, 0.01),
        lambda x, _: {},
    ),
    "frames": ("a stack", (1, 2, 4, 16), (4, 16), lambda x, _: {"frames": int(x)}),
    "photoelectron": ("DN", (1, 3, 10, 30, 100), (1, 3), lambda x, _: {"photoelectron_dn": x}),
    "blur after the gain": (
        "px",
        (0, 0.7, 1.2, 2),
        (0, 0.7),
        lambda x, base: {"post_gain_sigma_px": x, "core_sigma_px": max(base.core_sigma_px, 2.2)},
    ),
    "offset of the source": (
        "% of the frame's width",
        (0, 10, 25, 40, 50),
        (0, 0),
        lambda x, base: {"col": (0.5 - x / 100) * (base.cols - 1)},
    ),
    "second source, at 20 px": (
        "% of the first",
        (0, 0.3, 3, 30, 100),
        (0, 0),
        lambda x, _: {"second_distance_px": 20.0, "second_ratio": x / 100},
    ),
    "motion": ("px a frame", (0, 0.1, 0.5, 2, 8), (0, 0), lambda x, _: {"motion_px": x}),
    "automatic gain": ("1 = on", (0, 1), (0, 0), lambda x, _: {"agc": bool(x)}),
    "full well": (
        "over full scale",
        (1e6, 10, 3, 1.1),
        (1e6, 1e6),
        lambda x, base: {"full_well_dn": x * base.span_dn},
    ),
    "smear": (
        "share of the column's light",
        (0, 1e-4, 1e-3, 1e-2, 0.1),
        (0, 0),
        lambda x, _: {"smear_fraction": x},
    ),
    "plate saturation": (
        "its level over full scale",
        (1e6, 100, 10, 3, 1, 0.3),
        (1e6, 1e6),
        lambda x, base: {"plate_saturation_dn": x * base.span_dn},
    ),
    "glare": ("% of the light", (0, 5, 20, 60), (0, 5), lambda x, _: {"glare_fraction": x / 100}),
}


def _series(at: AxisPosition, rng: np.random.Generator) -> BloomSeries:
    """The series at a position, all other knobs inside the scope, of eight bits and without a
    wing.
    """
    scene, plain = scene_in_scope(rng, widest_px=50.0, most_frames=8), BloomScene()
    names = (
        "dark_dn",
        "background_dn",
        "full_scale_dn",
        "bits",
        "photoelectron_dn",
        "read_noise_dn",
    )
    fraction = float(rng.uniform(0.05, 0.2))
    scene = replace(
        scene,
        wing_share=0.0,
        halo_fraction=fraction,
        **{name: getattr(plain, name) for name in names},
    )
    scene = scene_at(AXES, at, scene)
    if at.axis == "levels":
        overloads = halo_overload(scene) * np.geomspace(0.02, 0.6, int(at.position))
    elif at.axis == "faintest level":
        overloads = at.position * halo_overload(scene) * np.geomspace(1.0, 100.0, 5)
    else:
        overloads = _levels_in_scope(scene, rng)
    return BloomSeries(scene=scene, overloads=tuple(float(overload) for overload in overloads))


def _case(at: AxisPosition, series: BloomSeries, rng: np.random.Generator) -> Case:
    return at.case(
        rng,
        kind="bloom",
        quantity="halo_diameter",
        truth=series.truth("halo_diameter", None),
        draw=series.session_drawn,
        context={"full_scale_dn": series.scene.full_scale_dn},
    )


def stability_cases(
    seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)
) -> tuple[Case, ...]:
    """Every axis at every position, drawn several times with another source and camera, and sources
    without a halo.
    """
    rng = np.random.default_rng([seed, 31])
    cases = cases_along_axes(AXES, axes, repeats, lambda at, _: _case(at, _series(at, rng), rng))
    bare = AxisPosition(axis="no halo", position=0.0, unit="", in_scope=False)
    return (*cases, *(_case(bare, _without_halo(rng), rng) for _ in range(2 * repeats)))


def _without_halo(rng: np.random.Generator) -> BloomSeries:
    """A source without a halo: nothing to measure."""
    series = series_in_scope(rng, widest_px=50.0, most_frames=8)
    return replace(series, scene=replace(series.scene, halo_fraction=0.0))


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Cases inside the scope, drawn at random."""
    rng = np.random.default_rng([seed, 32])
    return cases_in_scope(count, lambda at, _: _case(at, series_in_scope(rng), rng))
