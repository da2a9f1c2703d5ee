"""Choice of the sampler that generates the frames of a static scene."""

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput
from simulate.iiccd.automatic_controls import AutomaticState
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.stage_image import StageImage

Tier = Literal["by-cell", "streamed", "normal"]
Frames = Iterator[NDArray[np.unsignedinteger]]
# Treatment of a pulse by each sampler.
TIERS: dict[Tier, str] = {
    "by-cell": "every pulse counted and drawn on cells of half a pixel; blurs by Fourier transform, field by field",
    "streamed": "exact law of each cell's charge by table; noise spread by a kernel with the covariance of the blur; "
    "below 0.8 photoelectrons a pixel every pulse at a place and a moment of its own",
    "normal": "as streamed, with a normal law of the same mean and variance in place of the exact one",
}


def generate_frames(
    camera: IntensifiedCamera,
    at_mcp: StageImage,
    conditions: Conditions,
    *,
    seed: int,
    first_frame: int = 0,
    tier: Tier | None = None,
    threads: int = 1,
) -> Frames:
    """Yield the frames of a static scene, shape (row, col), DN; never ends.

    Parameters
    ----------
    camera
        The camera.
    at_mcp
        Expected photoelectrons at the MCP input per cell and exposure, on the camera's cells.
    conditions
        Gate, voltage, temperature, and which automatic controls were on.
    seed
        Seed of the run. A frame depends on it and on its own number alone.
    first_frame
        Number of the first frame.
    tier
        How pulses are drawn, see `TIERS`; None: "normal" where the camera leaves the pulse-height law out, else
        "streamed".
    threads
        Threads that share a frame of the faster tiers; frames do not depend on their number.
    """
    if tier is None:
        tier = "normal" if "pulse-height law" in camera.left_out else "streamed"
    if tier not in TIERS:
        raise BadInput(f"a tier must be one of {', '.join(TIERS)}, got {tier!r}")
    if not np.isfinite(at_mcp.values).all():
        raise BadInput("photoelectrons at the plate must be finite, got some that are not")
    if tier == "by-cell":
        from simulate.iiccd.reference_sampler import steady_frames

        return steady_frames(camera, at_mcp, conditions, seed=seed, first_frame=first_frame)
    from simulate.iiccd.fast_sampler.frame_generator import FrameGenerator
    from simulate.iiccd.fast_sampler.prepare import CameraStages, prepare_static_scene, readout_of

    stages = CameraStages.of(camera.chain(conditions), camera.fields_per_frame)
    scene = prepare_static_scene(stages, at_mcp, normal=tier == "normal")
    states = _effective(camera, at_mcp, conditions)
    return FrameGenerator(scene, readout_of(stages, scene), states, seed=seed, threads=threads).frames(first_frame)


def most_exact_tier(camera: IntensifiedCamera, at_mcp: StageImage) -> Tier:
    """Return the tier that draws every pulse of this light: the fast sampler does so for sparse events."""
    from simulate.iiccd.fast_sampler.prepare import is_sparse

    return "streamed" if is_sparse(at_mcp, camera.fields_per_frame) else "by-cell"


def _effective(
    camera: IntensifiedCamera, at_mcp: StageImage, conditions: Conditions
) -> Callable[[int], AutomaticState]:
    """Control states by frame, brightness as the factor of the saturated MCP output."""
    state_of = camera.automatic_state_of(at_mcp, conditions)

    @lru_cache(maxsize=256)
    def output(brightness: float) -> float:
        plate = camera.mcp_to_pixels(conditions, AutomaticState(brightness=brightness)).stages[0]
        return float(plate.mean(at_mcp).values.sum(dtype=float))

    def effective(frame: int) -> AutomaticState:
        state = state_of(frame)
        if state.brightness == 1.0:
            return state
        return AutomaticState(brightness=output(state.brightness) / output(1.0), gain=state.gain)

    return effective
