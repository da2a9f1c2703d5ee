"""The cases of the bar methods: what they must cope with, and each way they break, past its
breaking point.
"""

from typing import Any

import numpy as np

from tests.truth import BarScene, StripScene, TrueBlur
from tests.truth.cases.case import Axes, AxisPosition, Case, cases_along_axes, cases_in_scope

# Axis: unit, positions, and the first and last position inside the scope that bar methods declare.
AXES: Axes = {
    "bar SNR": ("level / pixel noise", (100, 30, 10, 5, 3, 2, 1, 0.5), (3, 100)),
    "one frame, bar SNR": ("level / pixel noise", (100, 30, 10, 5, 2, 1), (10, 100)),
    "frequency": (
        "cy/px",
        (0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.35, 0.4, 0.45, 0.48, 0.5),
        (0.05, 0.35),
    ),
    "frequency, untilted": ("cy/px", (0.08, 0.2, 0.3, 0.4, 0.45, 0.48), (0.08, 0.3)),
    "tilt": ("deg", (0, 0.3, 1, 2, 5, 10, 20, 30, 40, 45), (1, 45)),
    "blur": ("px, Gaussian sigma", (0.2, 0.5, 1, 2, 3, 4), (0.5, 2)),
    "cut-off of a tube": ("cy/px", (0.05, 0.08, 0.12, 0.2, 0.35, 0.6), (0.2, 0.6)),
    "bars": ("1", (2, 3, 4, 5, 8), (3, 5)),
    "bars asked for, of 4": ("1", (2, 3, 4, 5, 6), (4, 4)),
    "frequency asked for": ("% off", (-20, -10, -5, -2, 0, 2, 5, 10, 20), (-2, 2)),
    "clipped share of the level": ("%", (0, 2, 5, 10, 20, 40), (0, 0)),
    "gamma": ("1", (0.45, 0.6, 0.8, 0.9, 1, 1.1, 1.25, 1.6, 2.2), (1, 1)),
    "illumination gradient": ("% over the frame", (-60, -30, -10, -3, 0, 3, 10, 30, 60), (0, 0)),
    "noise blur after the gain": ("px, Gaussian sigma", (0, 0.5, 0.8, 1.2, 2), (0, 1.2)),
    "interlace motion": ("px a field", (0, 0.1, 0.25, 0.5, 1, 2, 4), (0, 0)),
    "frames": ("1", (1, 2, 3, 4, 6, 16), (4, 16)),
    "region": ("px square", (180, 120, 90, 70, 50, 40, 30), (120, 180)),
    "offset of the target": ("px", (0, 10, 20, 30, 40, 60), (0, 20)),
    "gap to a neighbour": ("px", (4, 8, 12, 20, 30, 40), (40, 40)),
    "stuck pixels": ("%", (0, 0.01, 0.1, 1, 5), (0, 0)),
    "sharpening": ("of detail finer than 2 px", (0, 0.1, 0.2, 0.3, 0.5, 1, 3), (0, 0)),
    "strip of 20 rows": ("cy/px", (0.03, 0.05, 0.1, 0.2, 0.3, 0.35, 0.4, 0.45, 0.48), (0.05, 0.3)),
    "strip of 20 rows, SNR": ("level / pixel noise", (100, 30, 10, 5, 2, 1), (10, 100)),
    "motion from frame to frame": ("px rms, 8 frames", (0, 0.1, 0.2, 0.5, 1, 2, 4), (0, 0)),
}
# Deep noise clips on eight bits, which is another axis.
TWELVE_BITS: dict[str, Any] = {"pedestal_dn": 1200.0, "level_dn": 300.0, "full_scale_dn": 4095.0}


Scene = BarScene | StripScene


def _strip(axis: str, position: float, common: dict[str, Any]) -> StripScene:
    """The strip of an axis at a position."""
    swept = {"snr": position} if axis.endswith("SNR") else {"frequency_cy_per_px": position}
    target = {key: common[key] for key in ("blur", "frequency_cy_per_px", "angle_deg")}
    return StripScene(
        **{**target, "phase_px": common["col_px"], "turned": common["row_px"] > 0, **swept}
    )


def _scene(axis: str, position: float, common: dict[str, Any]) -> Scene:
    """The scene of an axis at a position, all other knobs at harmless values."""
    if axis.startswith("strip"):
        return _strip(axis, position, common)
    knob: dict[str, Any] = {
        "bar SNR": {"snr": position, **TWELVE_BITS},
        "one frame, bar SNR": {"snr": position, "frames": 1, **TWELVE_BITS},
        "frequency": {"frequency_cy_per_px": position, "rows": 200, "cols": 220},
        "frequency, untilted": {"frequency_cy_per_px": position, "angle_deg": 0.0},
        "tilt": {"angle_deg": position},
        "blur": {
            "blur": TrueBlur(sigma_px=position),
            "frequency_cy_per_px": float(min(0.12, 0.2 / max(position, 1e-9))),
        },
        "cut-off of a tube": {"blur": TrueBlur(form="exponential", frequency_cy_per_px=position)},
        "bars": {"bars": int(position)},
        "clipped share of the level": {"clip_share": position / 100},
        "gamma": {"gamma": position},
        "illumination gradient": {"gradient": position / 100},
        "noise blur after the gain": {"noise_blur_px": position, "snr": 10.0},
        "interlace motion": {"motion_px": position},
        "frames": {"frames": int(position), "snr": 10.0, "noise_blur_px": 0.7},
        "region": {"rows": int(position), "cols": int(position)},
        "offset of the target": {"col_px": position},
        "gap to a neighbour": {"neighbour_px": position, "rows": 240, "row_px": -45.0},
        "stuck pixels": {"hot_share": position / 100},
        "sharpening": {"sharpening": position},
        "motion from frame to frame": {"jitter_px": position, "frames": 8},
    }.get(axis, {})
    return BarScene(**{**common, **knob})


def _method_arguments(axis: str, position: float, scene: Scene) -> dict[str, Any]:
    """Arguments of the method about the target: the truth, but on the axes of a wrong statement."""
    bars = int(position) if axis == "bars asked for, of 4" else scene.bars
    off = 1 + position / 100 if axis == "frequency asked for" else 1.0
    return {"bars": bars, "frequency_cy_per_px": scene.frequency_cy_per_px * off}


def _case(at: AxisPosition, scene: Scene, rng: np.random.Generator) -> Case:
    return at.case(
        rng,
        kind="bars",
        quantity="mtf",
        truth=scene.truth_mtf,
        draw=scene.frames_drawn,
        arguments=_method_arguments(at.axis, at.position, scene),
        context={"interlaced": at.axis == "interlace motion", "full_scale_dn": scene.full_scale_dn},
    )


def _common(rng: np.random.Generator, tube: bool) -> dict[str, Any]:
    """Blur, tilt, phase and frequency of a draw."""
    tube_blur = TrueBlur(form="exponential", frequency_cy_per_px=float(rng.uniform(0.2, 0.35)))
    return {
        "blur": tube_blur if tube else TrueBlur(sigma_px=float(rng.uniform(0.6, 1.2))),
        "frequency_cy_per_px": float(rng.uniform(0.08, 0.2)),
        "angle_deg": float(rng.uniform(2, 8)),
        "row_px": float(rng.uniform(-1, 1)),
        "col_px": float(rng.uniform(-1, 1)),
    }


def stability_cases(
    seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)
) -> tuple[Case, ...]:
    """Every axis at every position, drawn several times with another blur, tilt and phase, and
    frames of noise alone.

    `seed`: seed of the draws; `repeats`: draws at each position; `axes`: names of `AXES`.
    """
    rng = np.random.default_rng([seed, 7])

    def make_case(at: AxisPosition, repeat: int) -> Case:
        return _case(at, _scene(at.axis, at.position, _common(rng, tube=repeat % 2 == 1)), rng)

    cases = cases_along_axes(AXES, axes, repeats, make_case)
    return (
        *cases,
        *(_noise_case(kind, rng) for kind in ("white", "correlated") for _ in range(repeats)),
    )


def _noise_case(kind: str, rng: np.random.Generator) -> Case:
    """Frames without bars: nothing to measure."""
    flat = BarScene(
        level_dn=1e-3,
        pedestal_dn=100.0,
        snr=1e-4,
        shot_share=1.0,
        noise_blur_px=1.0 if kind == "correlated" else 0.0,
    )
    at = AxisPosition(
        axis="noise alone",
        position=float(kind == "correlated"),
        unit="1 = correlated",
        in_scope=False,
    )
    return at.case(
        rng,
        kind="bars",
        quantity="mtf",
        truth=None,
        draw=flat.frames_drawn,
        arguments={"bars": 4, "frequency_cy_per_px": 0.12},
        context={"full_scale_dn": flat.full_scale_dn},
    )


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Cases inside the scope, drawn at random: blur, frequency, number, direction, phase, noise and
    its correlation.
    """
    rng = np.random.default_rng([seed, 8])

    def make_case(at: AxisPosition, number: int) -> Case:
        tube = TrueBlur(form="exponential", frequency_cy_per_px=float(rng.uniform(0.2, 0.5)))
        scene = BarScene(
            blur=TrueBlur(sigma_px=float(rng.uniform(0.5, 1.2))) if number % 2 else tube,
            frequency_cy_per_px=float(rng.uniform(0.06, 0.25)),
            bars=int(rng.choice([3, 4, 5])),
            frames=int(rng.choice([4, 8, 16])),
            angle_deg=float(rng.choice([0, 90]) + rng.choice([-1, 1]) * rng.uniform(1, 10)),
            row_px=float(rng.uniform(-2, 2)),
            col_px=float(rng.uniform(-2, 2)),
            black_dn=100.0,
            pedestal_dn=300.0,
            level_dn=float(rng.uniform(600, 1800)),
            full_scale_dn=4095.0,
            snr=float(np.exp(rng.uniform(np.log(5), np.log(50)))),
            noise_blur_px=float(rng.choice([0.0, 0.5, 0.9])),
        )
        return _case(at, scene, rng)

    return cases_in_scope(count, make_case)
