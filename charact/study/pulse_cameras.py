"""Random intensified cameras for maps of where methods break, and what goes wrong with any of them."""

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from charact.study.cell_map import Breaking
from charact.study.edge.scene import Blur
from charact.study.pulses import PulsedTarget

Target = TypeVar("Target", bound=PulsedTarget)

# What breaks any target, from where it hardly matters to where nothing is left, and whether steps are even in ln.
BREAKING: Breaking = {
    "photoelectrons": (0.001, 0.1, True),
    "pulse_peak_dn": (40.0, 2000.0, True),
    "gain_spread": (1.0, 10.0, True),
    "ion_share": (1e-4, 0.03, True),
    "bright_dn": (200.0, 1500.0, True),
    "codes": (2.0, 40.0, True),
    "black_dn": (-20.0, 6.0, False),
    "read_dn": (2.0, 60.0, True),
    "row_noise_dn": (0.3, 30.0, True),
    "pattern": (0.003, 0.3, True),
    "lag": (0.01, 0.7, True),
    "flicker": (0.01, 0.5, True),
    "jitter_px": (0.03, 3.0, True),
    "drift_px": (0.1, 6.0, True),
    "motion_px": (0.05, 3.0, True),
    "motion_untold_px": (0.05, 3.0, True),
    "gradient": (0.05, 0.8, True),
    "vignetting": (0.05, 0.95, False),
    "gamma": (0.45, 2.2, True),
    "sharpening": (0.05, 2.0, True),
    "hot_share": (1e-4, 0.05, True),
    "frames": (1.0, 4.0, False),
    "blur_px": (3.0, 20.0, True),
}
LABELS = {
    "photoelectrons": "faint light (photoelectrons/px)",
    "pulse_peak_dn": "peak of a pulse (DN of 8 bits)",
    "gain_spread": "relative variance of heights (1)",
    "ion_share": "share of ions' pulses (1)",
    "bright_dn": "bright side (DN of 8 bits)",
    "codes": "faint bright side (DN)",
    "black_dn": "code at no light (DN of 8 bits)",
    "read_dn": "read noise (DN of 8 bits)",
    "row_noise_dn": "noise of whole rows (DN of 8 bits)",
    "pattern": "fixed pattern of gains (1)",
    "lag": "lag (share of an exposure)",
    "flicker": "flicker (1)",
    "jitter_px": "motion from frame to frame (px rms)",
    "drift_px": "drift through the stack (px)",
    "motion_px": "motion between fields, told (px)",
    "motion_untold_px": "the same, fields not told (px)",
    "gradient": "light, right over left less 1 (1)",
    "vignetting": "light that corners lose (1)",
    "gamma": "exponent of the response (1)",
    "sharpening": "sharpening (1)",
    "hot_share": "share of stuck pixels (1)",
    "frames": "frames (1)",
    "blur_px": "sd of a wide blur (px)",
}
# Those in codes of eight bits: they grow with full scale.
_OF_FULL_SCALE = ("pulse_peak_dn", "bright_dn", "black_dn", "read_dn", "row_noise_dn")
# What of full scale five of a pixel's standard deviations must leave inside the scope.
_SPARED_SD = 5.0
# Mean light of scenes whose pulses are too bright for the scale, DN of eight bits: far below full scale itself.
_DIM_DN = 60.0


def camera_drawn(rng: np.random.Generator) -> dict[str, Any]:
    """Return what a random camera and its light are: one in three has twelve bits, one in three fields.

    A photoelectron's pulse is a few to fifty codes of eight bits: what gains of intensified cameras make of it.
    """
    full_scale_dn = float(rng.choice([255.0, 255.0, 4095.0]))
    scale = full_scale_dn / 255.0
    bright_dn = float(rng.uniform(30.0, 190.0)) * scale
    return {
        "pulse_px": float(rng.uniform(0.4, 0.9)),
        "photoelectrons": bright_dn / (scale * float(np.exp(rng.uniform(np.log(3.0), np.log(150.0))))),
        "bright_dn": bright_dn,
        "dark_share": float(rng.uniform(0.02, 0.5)),
        "gain_spread": float(rng.uniform(0.3, 1.0)),
        "read_dn": float(rng.uniform(0.5, 2.0) * np.sqrt(scale)),
        "frames": int(rng.choice([1, 4, 8, 16, 32])),
        "interlaced": bool(rng.random() < 1.0 / 3.0),
        "black_dn": 12.0 * scale,
        "full_scale_dn": full_scale_dn,
    }


def unclipped(target: PulsedTarget) -> bool:
    """Tell whether the noise of the brightest pixels stays below full scale."""
    one_frame_sd = target.bright_dn * (1.0 - target.dark_share) / target.snr * np.sqrt(target.frames)
    return target.black_dn + target.bright_dn + _SPARED_SD * one_frame_sd < target.full_scale_dn


def broken(target: Target, axis: str, strength: float) -> Target:
    """Return a target with one thing wrong: an axis of `BREAKING`, or any other parameter by its name."""
    scale = target.full_scale_dn / 255.0
    if axis in _OF_FULL_SCALE:
        strength *= scale
    dim_dn = _DIM_DN * scale
    changed: dict[str, Any] = {
        "photoelectrons": {"photoelectrons": strength, "bright_dn": strength * target.gain_dn},
        "pulse_peak_dn": {
            "bright_dn": dim_dn, "photoelectrons": target.photoelectrons * dim_dn / target.bright_dn
            * target.pulse_peak_dn / strength,
        },
        "bright_dn": {"bright_dn": strength, "photoelectrons": target.photoelectrons * strength / target.bright_dn},
        "codes": {"bright_dn": strength, "read_dn": 0.3},
        "motion_px": {"motion_px": strength, "interlaced": True},
        "motion_untold_px": {"motion_px": strength, "interlaced": False},
        "angle_deg": {"angle_deg": round(target.angle_deg / 90.0) * 90.0 + strength},
        "rows": {"rows": round(strength), "cols": round(strength)},
        "frames": {"frames": round(strength)},
        "blur_px": {"blur": Blur(sigma_px=strength)},
    }.get(axis, {axis: strength})  # fmt: skip
    return replace(target, **changed)
