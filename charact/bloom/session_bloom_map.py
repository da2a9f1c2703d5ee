"""The bloom map of a session's stack, from what the session's point series told of the camera."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.bloom_map import BloomMap, bloom_map
from charact.bloom.posterior_psf import PosteriorPsf, spread_of
from charact.method import Context
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Result
from labdata.session import Session, StackEntry

# Share of the frames at the highest code from which on the mean of a pixel says less than its light.
CLIPPED_FRAMES = 0.02


def spread_from(result: Result, *, area_px: float, pitch_ratio: float = 1.0, rng: np.random.Generator) -> PosteriorPsf:
    """Return the spread that the measurements of a point series describe.

    Parameters
    ----------
    result
        Of `charact.bloom.measure`.
    area_px
        Pixels of a frame, over which the veiling glare is spread.
    pitch_ratio
        Row pitch over column pitch.
    rng
        Generator of the glare's draws.

    Raises
    ------
    BadInput
        If no method gave the posterior of core and halo.
    """
    posterior = _posterior(result)
    found = [m for m in result.find("veiling_glare") if m.value is not None and m.interval68 is not None]
    glare = np.zeros(len(posterior.draws))
    if found and found[0].value is not None and found[0].interval68 is not None:
        low, high = found[0].interval68
        glare = 0.01 * np.clip(rng.normal(found[0].value, 0.5 * (high - low), len(glare)), 0.0, 99.0)
    return spread_of(posterior, pitch_ratio=pitch_ratio, glare_fraction=glare, glare_area_px=area_px)


def _posterior(result: Result) -> Posterior:
    """The posterior of core and halo."""
    for one in result.find("halo_fraction") + result.find("halo_diameter"):
        if one.posterior is not None and "halo_fraction" in one.posterior.names:
            return one.posterior
    reasons = [str(m.reason) for m in result.find("halo_diameter") if m.reason]
    raise BadInput(f"a bloom map needs the halo of a point series: {'; '.join(reasons) or 'none was measured'}")


def map_of(session: Session, result: Result, *, label: str | None = None, context: Context) -> tuple[BloomMap, NDArray]:
    """Return the bloom map of a stack's mean frame, and that frame over dark, shape (row, col), DN.

    Parameters
    ----------
    session
        Session with the stack, a point series and, better, darks.
    result
        What `charact.bloom.measure` found in it.
    label
        Stack; None: the scene, else the point source with most light.
    context
        Seed, full scale and pitches.

    Raises
    ------
    BadInput
        If there is no such stack, or the session told no halo.
    """
    entry = _entry(session, label)
    stack = entry.read()
    full = _full_scale(stack, context)
    dark = _dark_dn(session, entry, stack)
    rng = np.random.default_rng(context.seed)
    signal = stack.data.mean(axis=0, dtype=np.float64) - dark
    spread = spread_from(result, area_px=float(signal.size), pitch_ratio=context.pitch_ratio, rng=rng)
    clipped = (stack.data >= full).mean(axis=0) > CLIPPED_FRAMES
    found = bloom_map(signal, spread, clip_dn=full - dark, clipped=clipped, pitch_ratio=context.pitch_ratio, rng=rng)
    return found, signal


def _entry(session: Session, label: str | None) -> StackEntry:
    """The stack that is asked for, or the one worth a map."""
    if label is not None:
        found = [entry for entry in session.stacks if entry.label == label]
        if not found:
            names = ", ".join(entry.label for entry in session.stacks)
            raise BadInput(f"the stack of a map must be one of {names}, got {label!r}")
        return found[0]
    scenes = session.of_kind("scene")
    found = scenes or session.of_kind("point")
    if not found:
        raise BadInput("a bloom map needs a stack of kind scene or point")
    return max(found, key=lambda entry: (entry.conditions.illuminance_lux or 0.0) * (entry.conditions.gate_ns or 1.0))


def _full_scale(stack: FrameStack, context: Context) -> float:
    told = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    return float(told if told is not None else stack.data.max())


def _dark_dn(session: Session, entry: StackEntry, stack: FrameStack) -> float:
    """Level without light: that of the darks of like settings, as recorded, else the lowest percent of the frame."""
    dark = session.dark_like(entry.conditions)
    if dark is not None:
        return dark.read().mean_dn
    if stack.black_level_dn is not None:
        return float(stack.black_level_dn)
    return float(np.percentile(stack.data, 1.0))


def evidence_of(found: BloomMap, signal: NDArray) -> dict[str, Any]:
    """What a figure of a map reads: `charact.report.bloom_images.plot_bloom_map`."""
    return {
        "figure": "bloom-map",
        "signal_dn": signal,
        "fraction": found.fraction,
        "sd": found.sd,
        "clipped": found.clipped,
        "near_px": found.near_px,
        "sources": [
            {"row": s.row, "col": s.col, "shape": s.shape, "known": s.known, "reason": s.reason,
             "light_dn_px": float(np.median(s.light_dn_px))}
            for s in found.sources
        ],
    }  # fmt: skip
