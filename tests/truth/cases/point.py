"""The cases of the point methods: what they must cope with, and each way they break, past its
breaking point.
"""

from typing import Any

import numpy as np

from tests.truth import PointScene, TrueBlur
from tests.truth.cases.case import Axes, AxisPosition, Case, cases_along_axes, cases_in_scope

# Axis: unit, positions, and the first and last position inside the scope that point methods
# declare.
AXES: Axes = {
    "light": ("photoelectrons a frame", (30000, 3000, 1000, 300, 100, 30, 10, 3), (300, 30000)),
    "light, ordinary camera": (
        "photoelectrons a frame",
        (100000, 10000, 1000, 300, 100, 30),
        (1000, 100000),
    ),
    "read noise": ("DN, peak 150 DN", (0.3, 1, 3, 10, 30, 60), (0.3, 3)),
    "blur": ("px, Gaussian sigma", (0.3, 0.5, 0.8, 1.2, 2, 3, 5), (0.8, 2)),
    "cut-off of a tube": ("cy/px", (0.06, 0.1, 0.15, 0.2, 0.3, 0.5), (0.2, 0.5)),
    "pulse": ("px, Gaussian sigma", (0, 0.3, 0.5, 0.8, 1.2), (0.3, 0.8)),
    "peak over full scale": ("%", (60, 90, 100, 120, 200, 500), (60, 60)),
    "gamma": ("1", (0.45, 0.6, 0.8, 0.9, 1, 1.1, 1.25, 1.6, 2.2), (1, 1)),
    "background gradient": ("% over the frame", (0, 30, 100, 300), (0, 0)),
    "interlace motion": ("px a field", (0, 0.1, 0.25, 0.5, 1, 2, 4), (0, 0)),
    "drift through the stack": ("px", (0, 0.25, 0.5, 1, 2, 4), (0, 0)),
    "frames": ("1", (1, 2, 3, 4, 8, 32), (4, 32)),
    "region": ("px square", (96, 64, 40, 30, 20, 14, 10), (64, 96)),
    "offset of the source": ("px", (0, 10, 20, 30, 40, 46), (0, 10)),
    "neighbour of half the light": ("px", (1, 2, 3, 5, 8, 12, 16, 24, 36), (36, 36)),
    "neighbour's light, at 10 px": ("% of the source's", (0, 1, 3, 10, 30), (0, 0)),
    "pinhole, its size told": ("px", (0, 1, 2, 3, 5), (0, 2)),
    "stuck pixels": ("%", (0, 0.01, 0.1, 1), (0, 0)),
    "sharpening": ("of detail finer than 2 px", (0, 0.1, 0.2, 0.3, 0.5, 1, 3), (0, 0)),
    "motion from frame to frame": ("px rms, 8 frames", (0, 0.05, 0.1, 0.2, 0.4, 0.8, 2), (0, 0)),
}


def _scene(axis: str, position: float, common: dict[str, Any]) -> PointScene:
    """The scene of an axis at a position, all other knobs at harmless values."""
    knob: dict[str, Any] = {
        "light": {"photoelectrons": position},
        "light, ordinary camera": {"photoelectrons": position, "pulse_px": 0.0, "gain_spread": 0.0},
        "read noise": {"read_dn": position},
        "blur": {
            "blur": TrueBlur(sigma_px=float(np.sqrt(max(position**2 - 0.25, 0.04)))),
            "pulse_px": 0.5,
        },
        "cut-off of a tube": {"blur": TrueBlur(form="exponential", frequency_cy_per_px=position)},
        "pulse": {"pulse_px": position},
        "peak over full scale": {"peak_dn": 243.0 * position / 100},
        "gamma": {"gamma": position},
        "background gradient": {"gradient": position / 100, "background": 0.5},
        "interlace motion": {"motion_px": position},
        "drift through the stack": {"drift_px": position},
        "frames": {"frames": int(position)},
        "region": {"rows": int(position), "cols": int(position)},
        "offset of the source": {"col_px": position},
        "neighbour of half the light": {"neighbour_px": position},
        "neighbour's light, at 10 px": {"neighbour_px": 10.0, "neighbour_share": position / 100},
        "pinhole, its size told": {"pinhole_px": position},
        "stuck pixels": {"hot_share": position / 100},
        "sharpening": {"sharpening": position},
        "motion from frame to frame": {"jitter_px": position, "frames": 8},
    }[axis]
    return PointScene(**{**common, **knob})


def _case(
    at: AxisPosition, scene: PointScene, rng: np.random.Generator, *, lit: bool = True
) -> Case:
    return at.case(
        rng,
        kind="point",
        quantity="mtf50",
        truth=scene.truth_mtf50 if lit else None,
        draw=scene.frames_drawn,
        arguments={"pinhole_px": scene.pinhole_px or None},
        context={"interlaced": False, "full_scale_dn": scene.full_scale_dn},
    )


def _common(rng: np.random.Generator, tube: bool) -> dict[str, Any]:
    """Blur and phase of a draw."""
    tube_blur = TrueBlur(form="exponential", frequency_cy_per_px=float(rng.uniform(0.2, 0.35)))
    return {
        "blur": tube_blur if tube else TrueBlur(sigma_px=float(rng.uniform(0.5, 1.2))),
        "pulse_px": float(rng.uniform(0.4, 0.8)),
        "row_px": float(rng.uniform(-1, 1)),
        "col_px": float(rng.uniform(-1, 1)),
    }


def stability_cases(
    seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)
) -> tuple[Case, ...]:
    """Every axis at every position, drawn several times with another blur and phase, and frames
    without a source.

    `seed`: seed of the draws; `repeats`: draws at each position; `axes`: names of `AXES`.
    """
    rng = np.random.default_rng([seed, 9])

    def make_case(at: AxisPosition, repeat: int) -> Case:
        return _case(at, _scene(at.axis, at.position, _common(rng, tube=repeat % 2 == 1)), rng)

    cases = cases_along_axes(AXES, axes, repeats, make_case)
    return (*cases, *(_noise_case(glow, rng) for glow in (0.02, 0.5) for _ in range(repeats)))


def _noise_case(background: float, rng: np.random.Generator) -> Case:
    """Frames of the background's own pulses: nothing to measure."""
    dark = PointScene(photoelectrons=0.0, background=background, peak_dn=30.0)
    at = AxisPosition(
        axis="noise alone", position=background, unit="photoelectrons a pixel", in_scope=False
    )
    return _case(at, dark, rng, lit=False)


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Cases inside the scope, drawn at random: blur, halo, pulses, light, phase, frames and read
    noise.
    """
    rng = np.random.default_rng([seed, 10])

    def make_case(at: AxisPosition, number: int) -> Case:
        tube = TrueBlur(form="exponential", frequency_cy_per_px=float(rng.uniform(0.2, 0.4)))
        ordinary = number % 3 == 2
        halo_share, halo_px = float(rng.uniform(0.02, 0.2)), float(rng.uniform(8.0, 30.0))
        lens = TrueBlur(
            sigma_px=float(rng.uniform(0.6, 1.5)),
            halo_share=halo_share if number % 4 == 3 else 0.0,
            halo_px=halo_px,
        )
        scene = PointScene(
            blur=lens if number % 2 else tube,
            pulse_px=0.0 if ordinary else float(rng.uniform(0.4, 0.8)),
            gain_spread=0.0 if ordinary else float(rng.uniform(0.3, 1.0)),
            photoelectrons=float(np.exp(rng.uniform(np.log(1000), np.log(30000)))),
            peak_dn=float(rng.uniform(80, 180)),
            frames=int(rng.choice([8, 16, 32])),
            row_px=float(rng.uniform(-3, 3)),
            col_px=float(rng.uniform(-3, 3)),
            read_dn=float(rng.uniform(0.5, 2.0)),
        )
        return _case(at, scene, rng)

    return cases_in_scope(count, make_case)
