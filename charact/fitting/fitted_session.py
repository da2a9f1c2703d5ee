"""Inputs of the fit from a session: its camera, its stacks of fixed gain, and frequencies per
pixel.
"""

from dataclasses import replace

import numpy as np

from charact.estimators.noise.findings import AUTOMATIC, step_finding
from charact.fitting.observation import Observation, has_automatic_gain
from charact.fitting.prior import Camera
from charact.verdict import Finding
from labdata import BadInput, Result, Session, open_lazy_stack


def camera_of(session: Session, pitch_px: int) -> Camera:
    """Return the session's camera of the bit depth of its frames, and a size by their samples so
    many pixels apart.
    """
    camera = session.camera
    if camera is None:
        raise BadInput(
            "a fit needs a sensor description with prior ranges, got none in session "
            f"{session.name!r}: name one in its session.toml, sensor = "
            f"{proposed_description(session)!r} fits its stacks"
        )
    if camera.is_thermal:
        raise BadInput(
            f"a fit needs a camera of visible light, got {camera.name!r} of the thermal infrared"
        )
    if not session.stacks:
        return camera
    _, rows, columns = open_lazy_stack(session.stacks[0]).shape
    video = replace(camera.video, bit_depth=session.bit_depth or camera.video.bit_depth)
    if session.bit_depth is None:
        _check_codes(session, 2**video.bit_depth - 1)
    return replace(
        camera,
        ccd=replace(camera.ccd, rows=rows * pitch_px, columns=columns * pitch_px),
        video=video,
    )


def _check_codes(session: Session, highest: int) -> None:
    """Refuse frames of a session without a bit depth whose codes exceed those of the
    description.
    """
    for entry in session.of_kind("dark", "flat"):
        if (largest_code := float(entry.read().data.max())) > highest:
            raise BadInput(
                "bit_depth must be in the session.toml where codes exceed the description's "
                f"{highest}, got none and {largest_code:g} in {entry.label!r}"
            )


def per_pixel(result: Result, pitch_px: int) -> Result:
    """Return measurements whose frequencies count the pixels of the camera instead of samples so
    many pixels apart.

    The transfer at a frequency of a plane is that of the whole camera at the same frequency: its
    samples lie farther apart, its apertures are those of the pixels.
    """
    if pitch_px == 1:
        return result
    curves = {
        name: replace(line, frequency_cy_per_px=np.asarray(line.frequency_cy_per_px) / pitch_px)
        for name, line in result.curves.items()
    }
    measurements = tuple(
        m.with_(frequency_cy_per_px=m.frequency_cy_per_px / pitch_px)
        if m.frequency_cy_per_px
        else m
        for m in result.measurements
    )
    return replace(result, curves=curves, measurements=measurements)


def require_noise(session: Session, observed: tuple[Observation, ...]) -> None:
    """Raise BadInput where frames repeat each other, so that a number of them has no error."""
    silent = [
        observation.name
        for observation in observed
        if not np.all(np.diag(observation.covariance) > 0.0)
    ]
    if silent:
        step = step_finding(session)
        why = "" if step is None else f": {step.effect}"
        raise BadInput(
            f"a fit needs noise in the frames of {session.name!r}, got none in "
            f"{', '.join(silent)}{why}"
        )


def with_fixed_gain(session: Session) -> tuple[Session, Finding | None]:
    """Return the session without darks and flats of an automatic gain or brightness control, and
    the finding of them.

    Their gain is unknown, and another than that of the other stacks; an MTF does not depend on it.
    """
    changed = [
        entry for entry in session.of_kind("dark", "flat") if has_automatic_gain(entry.conditions)
    ]
    fixed = replace(
        session, stacks=tuple(entry for entry in session.stacks if entry not in changed)
    )
    for kind in ("dark", "flat"):
        if session.of_kind(kind) and not fixed.of_kind(kind):
            raise BadInput(
                f"a fit needs a {kind} of fixed gain, but an automatic gain or brightness control "
                f"was on in all of {session.name!r}: record it with both off"
            )
    if not changed:
        return session, None
    labels = ", ".join(entry.label for entry in changed)
    return fixed, AUTOMATIC.finding(
        "agc", f"on in {labels}, left out of the fit as their gain is unknown"
    )


def proposed_description(session: Session) -> str:
    """Return the name of the shipped camera description that fits a session's conditions."""
    conditions = [entry.conditions for entry in session.stacks]
    if any(stack_conditions.em_gain is not None for stack_conditions in conditions):
        return "emccd-512"
    gated = any(
        value is not None
        for stack_conditions in conditions
        for value in (
            stack_conditions.mcp_v,
            stack_conditions.gate_ns,
            stack_conditions.gain_control,
        )
    )
    if session.interlaced or (gated and session.bit_depth == 8):
        return "pulnix-ag5745ef3"
    return "gen3-digital-iccd" if gated else "machine-vision"
