"""The cases of the system gain: a camera without an intensifier, whose noise is white, and what
makes it less so.
"""

import numpy as np

from tests.truth.cases.case import (
    Axes,
    AxisPosition,
    Case,
    cases_along_axes,
    cases_in_scope,
    scene_at,
)
from tests.truth.cases.covariance_gain import flat_case
from tests.truth.flats import FlatScene

AXES: Axes = {
    "system gain": (
        "DN an electron",
        (0.01, 0.03, 0.1, 0.3, 1, 5),
        (0.1, 1),
        lambda x, _: {"electron_gain_dn": x},
    ),
    "frames": ("a stack", (2, 3, 4, 8, 16), (8, 16), lambda x, _: {"frames": int(x)}),
    "levels": (
        "flat stacks",
        (1, 2, 3, 5),
        (3, 5),
        lambda x, base: {"photoelectrons": base.photoelectrons[-int(x) :]},
    ),
    "saturated": (
        "% of full scale at the brightest",
        (70, 100, 130, 300),
        (70, 70),
        lambda x, base: {"full_scale_dn": float(round(base.black_dn + WHITE_DN * 100 / x))},
    ),
    "smoothing after the camera": (
        "px, Gaussian sigma",
        (0, 0.2, 0.3, 0.5, 1),
        (0, 0),
        lambda x, _: {"resampling_px": x},
    ),
    "flicker": ("% rms", (0, 0.2, 0.5, 2, 10), (0, 0), lambda x, _: {"flicker": x / 100}),
    "automatic gain": ("1 = on", (0, 1), (0, 0), lambda x, _: {"agc": bool(x)}),
}
WHITE_DN = 2400.0


def _base(rng: np.random.Generator) -> FlatScene:
    return FlatScene(
        excess_noise_factor=0.0,
        electron_gain_dn=float(np.exp(rng.uniform(np.log(0.1), np.log(1.0)))),
        photoelectron_gain_dn=WHITE_DN / 32,
        blur_px=0.0,
        frames=int(rng.integers(8, 17)),
    )


def stability_cases(
    seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)
) -> tuple[Case, ...]:
    """Every axis at every position, drawn several times with another gain."""
    rng = np.random.default_rng([seed, 6])

    def make_case(at: AxisPosition, _: int) -> Case:
        return flat_case("system_gain", at, scene_at(AXES, at, _base(rng)), rng)

    return cases_along_axes(AXES, axes, repeats, make_case)


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Cases inside the scope, drawn at random: gain and number of frames."""
    rng = np.random.default_rng([seed, 5])
    scenes = [_base(rng) for _ in range(count)]
    return cases_in_scope(
        count, lambda at, number: flat_case("system_gain", at, scenes[number], rng)
    )
