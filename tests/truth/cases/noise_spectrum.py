"""The cases of the noise spectrum: flats of known MTF after the gain, and each way they break."""

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
from tests.truth.scintillating_flats import ScintillatingFlats

AXES: Axes = {
    "half frequency after the gain": (
        "cy/px",
        (0.04, 0.08, 0.15, 0.25, 0.4, 0.6, 1.0),
        (0.08, 0.4),
        lambda x, _: {"half_frequency_cy_per_px": x},
    ),
    "exponent": ("1", (1.0, 1.2, 1.5, 2.0, 2.5), (1.2, 2.0), lambda x, _: {"exponent": x}),
    "frames": ("a stack", (2, 3, 4, 8, 24), (4, 24), lambda x, _: {"frames": int(x)}),
    "size": (
        "px square",
        (40, 64, 96, 192),
        (96, 192),
        lambda x, _: {"rows": int(x), "cols": int(x)},
    ),
    "light": (
        "photoelectrons a pixel",
        (0.01, 0.1, 1, 10, 50),
        (0.1, 10),
        lambda x, _: {"photoelectrons": (0.3 * x, x)},
    ),
    "read noise": ("DN", (0.5, 3, 30, 100, 300), (0.5, 30), lambda x, _: _noisy(x)),
    "coloured read noise": (
        "DN",
        (3, 30, 100),
        (3, 30),
        lambda x, _: _noisy(x) | {"read_smoothing_px": 1.0},
    ),
    "coloured read noise, no darks": (
        "DN",
        (3, 30, 100),
        (0, 0),
        lambda x, _: _noisy(x) | {"read_smoothing_px": 1.0, "darks": False},
    ),
    "no darks": ("1 = none", (0, 1), (0, 0), lambda x, _: {"darks": x == 0}),
    "no intensifier": (
        "1 = none",
        (0, 1),
        (0, 0),
        lambda x, base: {"gain_dn": 0.0 if x else base.gain_dn},
    ),
    "lag": ("share an exposure", (0, 0.1, 0.3, 0.5), (0, 0.3), lambda x, _: {"lag": x}),
    "lag between fields": (
        "share a field",
        (0, 0.1, 0.3, 0.5),
        (0, 0.3),
        lambda x, base: {"lag": x, "interlaced": True, "rows": 2 * base.rows},
    ),
    "gamma": ("1", (0.45, 0.7, 1, 1.4, 2.2), (1, 1), lambda x, _: {"gamma": x}),
    "gamma, one level": (
        "1",
        (0.45, 0.7, 1, 1.4, 2.2),
        (1, 1),
        lambda x, _: {"gamma": x, "photoelectrons": (8.0,)},
    ),
    "saturated": (
        "% of full scale at the brighter level",
        (20, 60, 90, 120),
        (20, 60),
        lambda x, base: {"gain_dn": 4035.0 * x / 100 / max(base.photoelectrons)},
    ),
    "veil after the gain": (
        "% of the light",
        (0, 2, 5, 15),
        (0, 0),
        lambda x, _: {"halo_fraction": x / 100},
    ),
    "anisotropy": ("1", (0.6, 0.8, 1, 1.25, 1.6), (0.8, 1.25), lambda x, _: {"anisotropy": x}),
}


def _noisy(read_noise_dn: float) -> dict[str, float]:
    return {"read_noise_dn": read_noise_dn, "black_dn": 60.0 + 5.0 * read_noise_dn}


def _case(at: AxisPosition, scene: ScintillatingFlats, rng: np.random.Generator) -> Case:
    return at.case(
        rng,
        kind="post-gain",
        quantity="post_gain_mtf50",
        truth=scene.mtf50() if scene.gain_dn > 0 else None,
        draw=scene.session_drawn,
        context={"full_scale_dn": scene.full_scale_dn, "interlaced": scene.interlaced},
    )


def _base(rng: np.random.Generator) -> ScintillatingFlats:
    return ScintillatingFlats(
        half_frequency_cy_per_px=float(np.exp(rng.uniform(np.log(0.12), np.log(0.35)))),
        exponent=float(rng.choice([2.0, rng.uniform(1.2, 1.8)])),
        read_noise_dn=float(rng.uniform(1.0, 10.0)),
    )


def stability_cases(
    seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)
) -> tuple[Case, ...]:
    """Every axis at every position, drawn several times with another blur and read noise."""
    rng = np.random.default_rng([seed, 8])
    return cases_along_axes(
        AXES, axes, repeats, lambda at, _: _case(at, scene_at(AXES, at, _base(rng)), rng)
    )


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Cases inside the scope, drawn at random: blur, light, read noise, size and number of
    frames.
    """
    rng = np.random.default_rng([seed, 9])

    def make_case(at: AxisPosition, _: int) -> Case:
        light = float(np.exp(rng.uniform(np.log(0.5), np.log(10.0))))
        side = int(rng.integers(96, 161))
        scene = replace(
            _base(rng),
            photoelectrons=(0.3 * light, light),
            frames=int(rng.integers(4, 17)),
            rows=side,
            cols=side,
        )
        return _case(at, scene, rng)

    return cases_in_scope(count, make_case)
