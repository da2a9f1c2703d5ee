"""The cases of the edge methods: what they must cope with, and each way they break, past its
breaking point.
"""

import numpy as np

from tests.truth import EdgeScene, TrueBlur
from tests.truth.cases.case import (
    Axes,
    AxisPosition,
    Case,
    cases_along_axes,
    cases_in_scope,
    scene_at,
)

# Bounds of the scope follow the failure table of the slanted edge: biases under a percent or two.
AXES: Axes = {
    "edge SNR": (
        "step / noise",
        (100, 50, 30, 20, 10, 5, 3, 2, 1),
        (20, 100),
        lambda x, _: {"snr": x},
    ),
    "edge SNR, 16 frames": (
        "step / noise",
        (100, 30, 10, 5, 2, 1, 0.5),
        (10, 100),
        lambda x, _: {"snr": x, "frames": 16},
    ),
    "tilt": (
        "deg",
        (0, 0.3, 1, 2, 3, 5, 10, 20, 30, 40, 45),
        (3, 15),
        lambda x, _: {"angle_deg": x},
    ),
    "blur": (
        "px, Gaussian sigma",
        (0.1, 0.3, 0.5, 1, 2, 4, 8),
        (0.5, 2),
        lambda x, _: {"blur": TrueBlur(sigma_px=x)},
    ),
    "gamma": (
        "1",
        (0.45, 0.6, 0.8, 0.9, 1, 1.1, 1.25, 1.6, 2.2),
        (1, 1),
        lambda x, _: {"gamma": x},
    ),
    "gamma, low contrast": (
        "1",
        (0.45, 1, 2.2),
        (1, 1),
        lambda x, _: {"gamma": x, "dark_dn": 110.0, "bright_dn": 150.0, "snr": 25.0},
    ),
    "clipped share of the step": (
        "%",
        (0, 1, 3, 5, 10, 20, 40),
        (0, 0),
        lambda x, _: {"clip_share": x / 100},
    ),
    "illumination gradient": (
        "% over the frame",
        (-60, -30, -10, -3, 0, 3, 10, 30, 60),
        (0, 0),
        lambda x, _: {"gradient": x / 100},
    ),
    "noise blur after the gain": (
        "px, Gaussian sigma",
        (0, 0.3, 0.5, 0.8, 1.2, 2),
        (0, 1.2),
        lambda x, _: {"noise_blur_px": x, "snr": 25.0},
    ),
    "interlace motion": (
        "px a field",
        (0, 0.1, 0.25, 0.5, 1, 2, 4),
        (0, 0),
        lambda x, _: {"motion_px": x},
    ),
    "frames": (
        "1",
        (1, 2, 4, 16),
        (1, 16),
        lambda x, _: {"frames": int(x), "snr": 25.0, "noise_blur_px": 0.7},
    ),
    "region": (
        "px square",
        (200, 100, 60, 40, 24, 16, 10),
        (60, 200),
        lambda x, _: {"rows": int(x), "cols": int(x)},
    ),
    "offset of the edge": ("px", (0, 10, 25, 40, 47, 60), (0, 10), lambda x, _: {"offset_px": x}),
    "bow of the edge": ("px", (0, 0.25, 0.5, 1, 2, 5), (0, 0), lambda x, _: {"sagitta_px": x}),
    "stuck pixels": ("%", (0, 0.01, 0.1, 1, 5), (0, 0), lambda x, _: {"hot_share": x / 100}),
    "sharpening": (
        "of detail finer than 2 px",
        (0, 0.1, 0.2, 0.3, 0.5, 1, 3),
        (0, 0),
        lambda x, _: {"sharpening": x},
    ),
    "contrast": (
        "DN of step, noise 0.6 DN",
        (200, 100, 30, 10, 4, 2),
        (100, 200),
        lambda x, _: {"bright_dn": 40.0 + x, "snr": x / 0.6},
    ),
    "noise under a code": (
        "DN of noise, step 30 DN",
        (1, 0.5, 0.3, 0.2, 0.1, 0.05),
        (1, 1),
        lambda x, _: {"dark_dn": 60.3, "bright_dn": 90.7, "snr": 30.4 / max(x, 1e-3)},
    ),
    "motion from frame to frame": (
        "px rms, 8 frames",
        (0, 0.05, 0.1, 0.2, 0.4, 0.8, 2),
        (0, 0),
        lambda x, _: {"jitter_px": x, "frames": 8},
    ),
    "roughness of the edge": (
        "px rms",
        (0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.5),
        (0, 0),
        lambda x, _: {"roughness_px": x},
    ),
    "lowest code over the dark side": (
        "DN, noise 2 DN",
        (-20, -4, -2, 0, 2, 5, 10, 30),
        (-20, -20),
        lambda x, _: {"floor_dn": 40.0 + x},
    ),
}


def _case(
    at: AxisPosition, scene: EdgeScene, seeds: np.random.Generator, *, edge: bool = True
) -> Case:
    return at.case(
        seeds,
        kind="edge",
        quantity="mtf50",
        truth=scene.truth_mtf50 if edge else None,
        draw=scene.frames_drawn,
        context={"interlaced": at.axis == "interlace motion", "full_scale_dn": scene.full_scale_dn},
    )


def stability_cases(
    seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)
) -> tuple[Case, ...]:
    """Every axis at every position, drawn several times with another blur, angle and phase, and
    frames of noise alone.

    `seed`: seed of the draws; `repeats`: draws at each position; `axes`: names of `AXES`.
    """
    seeds, rng = np.random.default_rng(seed), np.random.default_rng([seed, 1])

    def make_case(at: AxisPosition, repeat: int) -> Case:
        tube = TrueBlur(form="exponential", frequency_cy_per_px=float(rng.uniform(0.2, 0.35)))
        blur = tube if repeat % 2 else TrueBlur(sigma_px=float(rng.uniform(0.7, 1.3)))
        base = EdgeScene(blur=blur, angle_deg=rng.uniform(4, 8), offset_px=rng.uniform(-1, 1))
        return _case(at, scene_at(AXES, at, base), seeds)

    cases = cases_along_axes(AXES, axes, repeats, make_case)
    return (
        *cases,
        *(_noise_case(kind, seeds) for kind in ("white", "correlated") for _ in range(repeats)),
    )


def _noise_case(kind: str, seeds: np.random.Generator) -> Case:
    """A frame without an edge: nothing to measure."""
    flat = EdgeScene(
        dark_dn=100.0,
        bright_dn=100.0001,
        snr=1e-5,
        noise_blur_px=1.0 if kind == "correlated" else 0.0,
    )
    at = AxisPosition(
        axis="noise alone",
        position=float(kind == "correlated"),
        unit="1 = correlated",
        in_scope=False,
    )
    return _case(at, flat, seeds, edge=False)


def _blur(number: int, rng: np.random.Generator) -> TrueBlur:
    """Return a lens, a tube, wings of a power law or a lens with a halo, in turn."""
    sigma, cut = float(rng.uniform(0.5, 1.8)), float(rng.uniform(0.15, 0.4))
    halo_share, diameter = float(rng.uniform(0.05, 0.25)), float(rng.uniform(15.0, 35.0))
    return (
        TrueBlur(sigma_px=sigma),
        TrueBlur(form="exponential", frequency_cy_per_px=cut),
        TrueBlur(
            form="moffat", moffat_px=sigma + 0.8, moffat_exponent=float(rng.uniform(1.8, 4.0))
        ),
        TrueBlur(sigma_px=sigma, halo_share=halo_share, halo_px=diameter),
    )[number % 4]


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Cases inside the scope, drawn at random: blur, direction, phase, polarity, size, noise and
    its correlation.
    """
    seeds, rng = np.random.default_rng(seed), np.random.default_rng([seed, 2])

    def make_case(at: AxisPosition, number: int) -> Case:
        blur = _blur(number, rng)
        side = int(rng.integers(80, 129))
        scene = EdgeScene(
            blur=blur,
            rows=side,
            cols=int(rng.integers(80, 129)),
            frames=int(rng.choice([1, 4, 8])),
            angle_deg=float(
                rng.choice([0, 90, 180, 270]) + rng.choice([-1, 1]) * rng.uniform(3, 10)
            ),
            offset_px=float(rng.uniform(-3, 3)),
            dark_dn=float(rng.uniform(25, 60)),
            bright_dn=float(rng.uniform(150, 210)),
            snr=float(np.exp(rng.uniform(np.log(20), np.log(100)))),
            noise_blur_px=float(rng.choice([0.0, 0.5, 0.9])),
        )
        return _case(at, scene, seeds)

    return cases_in_scope(count, make_case)
