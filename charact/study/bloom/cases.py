"""The cases of the bloom methods: what they must cope with, and each way they break, past its breaking point."""

from dataclasses import replace
from typing import Any

import numpy as np

from charact.study.bloom.scene import BloomScene
from charact.study.bloom.series import BloomSeries, halo_overload, levels_in_scope, scene_in_scope, series_in_scope
from charact.study.harness import Case
from charact.study.sweep_axes import Axes, AxisPosition, cases_along_axes, cases_in_scope

AXES: Axes = {
    "halo's share of the light": ("1", (0.001, 0.003, 0.01, 0.02, 0.1, 0.3), (0.02, 0.3)),
    "halo diameter": ("px", (14, 20, 25, 45, 70, 90), (25, 70)),
    "elastic share": ("1", (0, 0.03, 0.1, 0.3, 1), (0.1, 1)),
    "core": ("px, Gaussian sigma", (1, 1.7, 2.5, 4, 6), (1, 2.5)),
    "share of the core in its wing": ("1", (0, 0.1, 0.2, 0.4, 0.7), (0, 0.1)),
    "levels": ("1", (1, 2, 3, 5, 8), (5, 8)),
    "faintest level": ("halo's plateau over full scale", (0.001, 0.01, 0.1, 1, 10), (0.01, 0.01)),
    "frames": ("a stack", (1, 2, 4, 16), (4, 16)),
    "photoelectron": ("DN", (1, 3, 10, 30, 100), (1, 3)),
    "blur after the gain": ("px", (0, 0.7, 1.2, 2), (0, 0.7)),
    "offset of the source": ("% of the frame's width", (0, 10, 25, 40, 50), (0, 0)),
    "second source, at 20 px": ("% of the first", (0, 0.3, 3, 30, 100), (0, 0)),
    "motion": ("px a frame", (0, 0.1, 0.5, 2, 8), (0, 0)),
    "automatic gain": ("1 = on", (0, 1), (0, 0)),
    "full well": ("over full scale", (1e6, 10, 3, 1.1), (1e6, 1e6)),
    "smear": ("share of the column's light", (0, 1e-4, 1e-3, 1e-2, 0.1), (0, 0)),
    "plate saturation": ("its level over full scale", (1e6, 100, 10, 3, 1, 0.3), (1e6, 1e6)),
    "glare": ("% of the light", (0, 5, 20, 60), (0, 5)),
}


def _base(rng: np.random.Generator) -> BloomScene:
    """A scene whose knobs are all inside the scope, of eight bits and without a wing."""
    scene = scene_in_scope(rng, widest_px=50.0, most_frames=8)
    plain = BloomScene()
    names = ("dark_dn", "background_dn", "full_scale_dn", "bits", "photoelectron_dn", "read_noise_dn")
    fraction = float(rng.uniform(0.05, 0.2))
    return replace(scene, wing_share=0.0, halo_fraction=fraction, **{name: getattr(plain, name) for name in names})


def _series(axis: str, position: float, rng: np.random.Generator) -> BloomSeries:
    """The series of an axis at a position, all other knobs at harmless values."""
    base = _base(rng)
    scene = replace(base, **_knobs(position, base).get(axis, {}))
    if axis == "levels":
        overloads = halo_overload(scene) * np.geomspace(0.02, 0.6, int(position))
    elif axis == "faintest level":
        overloads = position * halo_overload(scene) * np.geomspace(1.0, 100.0, 5)
    else:
        overloads = levels_in_scope(scene, rng)
    return BloomSeries(scene=scene, overloads=tuple(float(one) for one in overloads))


def _knobs(position: float, base: BloomScene) -> dict[str, dict[str, Any]]:
    side = int(position) + 48
    return {
        "halo's share of the light": {"halo_fraction": position},
        "halo diameter": {"halo_diameter_px": position, "rows": side, "cols": side, "row": None, "col": None},
        "elastic share": {"halo_elastic_share": position},
        "core": {"core_sigma_px": position},
        "share of the core in its wing": {"wing_share": position},
        "frames": {"frames": int(position)},
        "photoelectron": {"photoelectron_dn": position},
        "blur after the gain": {"post_gain_sigma_px": position, "core_sigma_px": max(base.core_sigma_px, 2.2)},
        "offset of the source": {"col": (0.5 - position / 100) * (base.cols - 1)},
        "second source, at 20 px": {"second_distance_px": 20.0, "second_ratio": position / 100},
        "motion": {"motion_px": position},
        "automatic gain": {"agc": bool(position)},
        "full well": {"full_well_dn": position * base.span_dn},
        "plate saturation": {"plate_saturation_dn": position * base.span_dn},
        "smear": {"smear_fraction": position},
        "glare": {"glare_fraction": position / 100},
    }


def _case(at: AxisPosition, series: BloomSeries, rng: np.random.Generator) -> Case:
    return at.case(
        rng,
        kind="bloom",
        quantity="halo_diameter",
        truth=series.truth("halo_diameter", None),
        draw=series.session_drawn,
        context={"full_scale_dn": series.scene.full_scale_dn},
    )


def stability_cases(seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)) -> tuple[Case, ...]:
    """Every axis at every position, drawn several times with another source and camera, and sources without a halo.

    `seed`: seed of the draws; `repeats`: draws at each position; `axes`: names of `AXES`.
    """
    rng = np.random.default_rng([seed, 31])
    cases = cases_along_axes(AXES, axes, repeats, lambda at, _: _case(at, _series(at.axis, at.position, rng), rng))
    return (*cases, *(_bare(rng) for _ in range(2 * repeats)))


def _bare(rng: np.random.Generator) -> Case:
    """A source without a halo: nothing to measure."""
    series = series_in_scope(rng, widest_px=50.0, most_frames=8)
    bare = replace(series, scene=replace(series.scene, halo_fraction=0.0))
    return _case(AxisPosition(axis="no halo", position=0.0, unit="", in_scope=False), bare, rng)


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Cases inside the scope, drawn at random (`charact.study.bloom.series`)."""
    rng = np.random.default_rng([seed, 32])
    return cases_in_scope(count, lambda at, _: _case(at, series_in_scope(rng), rng))
