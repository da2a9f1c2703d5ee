"""The cases of the covariance gain: flat series inside the scope, and each way they break."""

from dataclasses import replace

import numpy as np

from tests.truth.cases.case import (
    Axes,
    AxisPosition,
    Case,
    cases_along_axes,
    cases_in_scope,
    scene_at,
)
from tests.truth.flats import FlatScene

AXES: Axes = {
    "blur after the gain": (
        "px, Gaussian sigma",
        (0, 0.3, 0.6, 1, 1.5, 2.5),
        (0, 1),
        lambda x, _: {"blur_px": x},
    ),
    "frames": ("a stack", (2, 4, 8, 24, 48), (24, 48), lambda x, _: {"frames": int(x)}),
    "levels": (
        "flat stacks",
        (1, 2, 3, 5),
        (3, 5),
        lambda x, base: {"photoelectrons": base.photoelectrons[-int(x) :]},
    ),
    "brightest level": (
        "photoelectrons a pixel",
        (0.05, 0.3, 2, 32, 100),
        (2, 32),
        lambda x, _: {"photoelectrons": tuple(x * np.array([0.1, 0.25, 0.5, 0.75, 1.0]))},
    ),
    "saturated": (
        "% of full scale at the brightest",
        (70, 100, 130, 300),
        (70, 70),
        lambda x, base: {
            "full_scale_dn": float(round(base.black_dn + 3200 * base.photoelectron_gain_dn / x))
        },
    ),
    "lag": ("share a frame", (0, 0.05, 0.1, 0.2, 0.4), (0, 0), lambda x, _: {"lag": x}),
    "flicker": ("% rms", (0, 0.5, 2, 5, 10), (0, 0), lambda x, _: {"flicker": x / 100}),
    "automatic gain": ("1 = on", (0, 1), (0, 0), lambda x, _: {"agc": bool(x)}),
    "steps of the digitiser": (
        "DN a photoelectron",
        (20, 3, 1, 0.3, 0.1),
        (3, 20),
        lambda x, _: {
            "photoelectron_gain_dn": x,
            "electron_gain_dn": x / 400,
            "read_noise_dn": x / 13,
        },
    ),
}


def flat_case(quantity: str, at: AxisPosition, scene: FlatScene, rng: np.random.Generator) -> Case:
    """Return a case of a flat series whose covariance gain or, without an intensifier, system gain
    is known.
    """
    truth = scene.truth_covariance_gain if quantity == "covariance_gain" else scene.electron_gain_dn
    return at.case(
        rng,
        kind="flats",
        quantity=quantity,
        truth=truth,
        draw=scene.session_drawn,
        context={"full_scale_dn": scene.full_scale_dn},
    )


def _base(rng: np.random.Generator) -> FlatScene:
    return FlatScene(
        photoelectron_gain_dn=float(rng.uniform(15, 30)),
        excess_noise_factor=float(rng.uniform(1.5, 3.0)),
        blur_px=float(rng.uniform(0.4, 0.8)),
    )


def stability_cases(
    seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)
) -> tuple[Case, ...]:
    """Every axis at every position, drawn several times with another gain, pulse height and
    blur.
    """
    rng = np.random.default_rng([seed, 3])

    def make_case(at: AxisPosition, _: int) -> Case:
        return flat_case("covariance_gain", at, scene_at(AXES, at, _base(rng)), rng)

    return cases_along_axes(AXES, axes, repeats, make_case)


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Cases inside the scope, drawn at random: gain, pulse heights, blur, every other with wings,
    number of frames.
    """
    rng = np.random.default_rng([seed, 4])
    scenes = [
        replace(
            _base(rng),
            frames=int(rng.integers(24, 49)),
            wings_cy_per_px=float(rng.uniform(0.2, 0.5)) if number % 2 else np.inf,
        )
        for number in range(count)
    ]
    return cases_in_scope(
        count, lambda at, number: flat_case("covariance_gain", at, scenes[number], rng)
    )
