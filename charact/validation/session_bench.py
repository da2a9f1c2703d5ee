"""Bench of a session as its frames show it: places and angles of targets, and light of unknown
colour or amount. They are not the camera's.

The noiseless simulated frame S of a target is laid on the measured mean frame M by least squares,

    M = b + a S - d . grad S + t dS/dt,

with background b, contrast a, displacement d and turn t, until d and t vanish (Lucas and Kanade,
Proc. IJCAI 1981): a blur other than the camera's hardly moves them. A point lies where the centres
of gravity of both agree. Where it clips, its centre hardly moves with it, and M and S are arsinh of
the level above the background over its noise, on which scale its flanks change evenly with d.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from charact.validation.frames import MatchedFrames, MatchedStacks
from charact.validation.simulated_frames import (
    bench_of,
    light_of,
    mean_of,
    signal_dn,
    slow_enough,
)
from charact.validation.target_features import spot_centre, target_centre
from charact.validation.thresholds import VALIDATION
from labdata import Camera, Conditions

if TYPE_CHECKING:
    from simulate.lab import LabBench

# Side of the window about a point in which its place is measured, px, and margin about bars.
WINDOW_PX, MARGIN_PX = 32, 16
# Steps of the registration, the last step's length, px, and the way from the first guess that a
# registration may take: beyond it, it is of something else.
STEPS, LAST_PX, LONGEST_PX = 8, 0.004, 1.5
# Displacement to both sides that gives the gradient of a point, px, and the least contrast of a
# target over that simulated.
HALF_PX, LEAST_CONTRAST = 0.1, 0.1
# Fraction of the pixels below the background's level, and least noise, DN.
BACKGROUND, ROUNDING_DN = 0.05, 0.3


def measured_bench(chosen: MatchedStacks, camera: Camera) -> MatchedStacks:
    """Return the stacks on the bench that their frames show: each target at its place and angle,
    and light of unknown colour or amount, or that drifts, at its level; with notes on all that is
    not as stated.

    Parameters
    ----------
    chosen
        Stacks of a validation with their measured frames.
    camera
        Description whose simulated frames are laid on the measured ones.
    """
    camera = slow_enough(camera, chosen.compared)
    notes, fitted = list(chosen.notes), set[str]()
    dark_dn = float(chosen.measured[chosen.dark.label].mean(dtype=float))
    lit: dict[str, Conditions] = {}

    def is_known(conditions: Conditions) -> bool:
        of_colour = conditions.wavelength_nm is not None and not camera.has_tube
        return conditions.illuminance_lux is not None or bool(
            conditions.photons_per_px and of_colour
        )

    of_one_colour = [
        flat.label
        for flat in chosen.flats
        if flat.conditions.photons_per_px and not is_known(flat.conditions)
    ]

    def in_light(shot: MatchedFrames) -> MatchedFrames:
        frames = chosen.measured[shot.label]
        shot, drift_note = _with_course(shot, frames, dark_dn)
        if drift_note:
            notes.append(drift_note)
            fitted.add(f"drift of {shot.label}, DN a frame")
        in_photons = bool(shot.conditions.photons_per_px)
        if is_known(shot.conditions):
            return shot
        if in_photons and of_one_colour and shot.label != of_one_colour[-1]:
            return replace(shot, like=of_one_colour[-1])
        unknown = "colour" if in_photons else "amount"
        notes.append(
            f"the light of {shot.label} is of unknown {unknown}: it is simulated at the level that "
            f"it shows, which is not compared"
        )
        fitted.add(f"ln signal of {shot.label}")
        if not in_photons:
            *dimmer, brightest = (flat.label for flat in chosen.flats)
            fitted.update(
                f"signal of {label} over {brightest}"
                for label in dimmer
                if shot.label in (label, brightest)
            )
        return replace(shot, level_dn=signal_dn(shot, frames.mean(axis=0, dtype=float), dark_dn))

    def placed(shot: MatchedFrames) -> MatchedFrames:
        shot = in_light(shot)
        at_place = _placed(shot, chosen.measured[shot.label], camera, lit)
        if at_place is None:
            notes.append(f"{shot.label} shows no {shot.kind}: simulated at the centre of its crop")
            return shot
        stated, measured = shot.target.angle_deg, at_place.target.angle_deg
        if stated is not None and measured is not None:
            difference_deg = (measured - stated + 90.0) % 180.0 - 90.0
            if abs(difference_deg) > VALIDATION.angle_deg:
                notes.append(
                    f"{shot.label} is stated at {stated:g} deg and measured at "
                    f"{stated + difference_deg:.2f} deg: simulated at the measured angle"
                )
        return at_place

    flats = tuple(in_light(flat) for flat in chosen.flats)
    lit |= {
        flat.label: light_of(bench_of(camera, flat), flat, {}) for flat in flats if flat.level_dn
    }
    return replace(
        chosen,
        flats=flats,
        edge=chosen.edge and placed(chosen.edge),
        point=chosen.point and placed(chosen.point),
        display_only=tuple(placed(shot) for shot in chosen.display_only),
        notes=tuple(notes),
        fitted=frozenset(fitted),
    )


def _with_course(shot: MatchedFrames, frames: NDArray, dark_dn: float) -> tuple[MatchedFrames, str]:
    """Return a stack with the light of each frame and a note, where it drifts: else as it is.

    Notes
    -----
    The course is a straight line through the means of the frames. It counts from
    `VALIDATION.drift_sd` standard errors on, by the scatter about it.
    """
    signal = frames.mean(axis=(1, 2), dtype=float) - dark_dn
    if len(signal) < VALIDATION.drift_frames or not signal.mean() > 0.0:
        return shot, ""
    at = np.linspace(-1.0, 1.0, len(signal))
    slope = float(at @ signal / (at @ at))
    scatter = np.sum((signal - signal.mean() - slope * at) ** 2) / (len(signal) - 2.0)
    if abs(slope) <= VALIDATION.drift_sd * np.sqrt(scatter / (at @ at)):
        return shot, ""
    relative = slope / float(signal.mean())
    note = (
        f"the light of {shot.label}, or the gain, drifts by {200.0 * relative:+.2g} % from its "
        f"first to its last frame: simulated light follows it"
    )
    return replace(shot, course=tuple((1.0 + relative * at).tolist())), note


def _placed(
    shot: MatchedFrames, frames: NDArray, camera: Camera, lit: Mapping[str, Conditions]
) -> MatchedFrames | None:
    """Return a stack with its target at the place and angle that its frames show; None where they
    show none.
    """
    guess = target_centre(shot.kind, frames.mean(axis=0, dtype=float))
    if guess is None:
        return None
    row, col, angle_deg = guess
    clips = bool((frames >= 2.0**camera.video.bit_depth - 1.0).any())
    top, left, *shape = _window(shot, row, col, clips)
    measured = frames[:, top : top + shape[0], left : left + shape[1]]
    middle = np.array(shape) / 2.0
    offset = np.array([row + 0.5 - top, col + 0.5 - left]) - middle
    part = replace(
        shot,
        corner=(shot.corner[0] + top, shot.corner[1] + left),
        shape=(shape[0], shape[1]),
        offset_px=(offset[0], offset[1]),
        target=replace(shot.target, angle_deg=angle_deg),
    )
    bench = bench_of(camera, part)
    part = replace(part, conditions=light_of(bench, part, lit))
    start = part
    for _ in range(STEPS):
        step = _registration(measured, bench, part)
        part = _moved(part, **step)
        if not np.hypot(*np.subtract(part.offset_px, offset)) < LONGEST_PX:
            part = start
            break
        if max(abs(length_px) for length_px in step.values()) < LAST_PX:
            break
    to_crop = middle - np.array(shot.shape) / 2.0
    row_px, col_px = (float(length) for length in to_crop + part.offset_px)
    return replace(shot, target=part.target, offset_px=(top + row_px, left + col_px))


def _moved(
    shot: MatchedFrames, *, row: float = 0.0, col: float = 0.0, turn: float = 0.0
) -> MatchedFrames:
    """Return a stack with its target displaced, px, and turned so that its ends move by `turn`,
    px.
    """
    turn_deg, angle_deg = np.rad2deg(2.0 * turn / max(shot.shape)), shot.target.angle_deg
    angle_deg = None if angle_deg is None else float(angle_deg + turn_deg)
    offset = shot.offset_px[0] + row, shot.offset_px[1] + col
    return replace(shot, offset_px=offset, target=replace(shot.target, angle_deg=angle_deg))


def _window(shot: MatchedFrames, row: float, col: float, clips: bool) -> tuple[int, int, int, int]:
    """Return the first row and column of the window about a target, and its shape, px."""
    if shot.kind == "edge":
        return 0, 0, *shot.shape
    side = WINDOW_PX
    if shot.target.frequency_cy_per_px is not None:
        # A bar is seven half periods long.
        side = 2 * round(1.75 / shot.target.frequency_cy_per_px) + 2 * MARGIN_PX
    # The smear of a clipped point is as its column is long.
    shape = shot.shape[0] if clips else min(side, shot.shape[0]), min(side, shot.shape[1])
    # An even row keeps the field parity.
    top = int(np.clip(row - shape[0] / 2.0, 0, shot.shape[0] - shape[0])) // 2 * 2
    return top, int(np.clip(col - shape[1] / 2.0, 0, shot.shape[1] - shape[1])), *shape


def _registration(frames: NDArray, bench: "LabBench", shot: MatchedFrames) -> Mapping[str, float]:
    """Return the displacement of a target from where it is simulated, and the turn of its ends,
    px.
    """
    measured, simulated = frames.mean(axis=0, dtype=float), mean_of(bench, shot)
    full_dn = 2.0**bench.camera.description.video.bit_depth - 1.0
    if shot.kind == "point" and max(measured.max(), simulated.max()) < full_dn:
        shown, expected = (spot_centre(frame - np.median(frame)) for frame in (measured, simulated))
        step = np.full(2, np.nan)
        if shown is not None and expected is not None:
            step = np.subtract(shown, expected)
        return dict(zip(("row", "col"), step.tolist(), strict=True))
    noise_dn = np.median(frames.std(axis=0, dtype=float)) + ROUNDING_DN

    def level(frame: NDArray) -> NDArray:
        signal = (frame - np.quantile(frame, BACKGROUND)) / noise_dn
        return np.arcsinh(signal) if shot.kind == "point" else signal

    lit = level(simulated)
    if shot.kind == "point":
        # Of a spot as narrow as a pixel differences of pixels are no gradient.
        # Shot noise: its variance is as the level.
        contrast, weight = np.tanh(lit), np.sqrt(np.cosh(lit))
        terms = {
            name: np.subtract(
                *(level(mean_of(bench, _moved(shot, **{name: way}))) for way in (HALF_PX, -HALF_PX))
            )
            / (2.0 * HALF_PX)
            for name in ("row", "col")
        }
    else:
        contrast, weight, (down, right) = lit, np.ones_like(lit), np.gradient(lit)
        cells = bench.camera.scene_cells
        ratio, centre = cells.pitch_y_mm / cells.pitch_x_mm, np.array(shot.shape) / 2.0 - 0.5
        y, x = np.ogrid[: lit.shape[0], : lit.shape[1]]
        y, x = y - centre[0] - shot.offset_px[0], x - centre[1] - shot.offset_px[1]
        turn = (ratio * y * right - x * down / ratio) * 2.0 / max(shot.shape)
        terms = {"row": -down, "col": -right, "turn": turn}
        if shot.kind == "edge":
            # Along itself an edge has no place.
            del terms["row" if (right**2).sum() > (down**2).sum() else "col"]
    # The mean of a pixel that clips now and then is too low.
    usable = (frames < full_dn).all(axis=0) & (simulated < full_dn)
    # Differences of the outermost pixels are one-sided.
    usable[[0, -1]] = usable[:, [0, -1]] = False
    design = (np.stack([np.ones_like(lit), contrast, *terms.values()]) * weight)[:, usable]
    scale = np.abs(design).max(axis=1, keepdims=True) + 1e-12
    difference = ((level(measured) - lit) * weight)[usable]
    amounts = np.linalg.lstsq((design / scale).T, difference, rcond=None)[0] / scale[:, 0]
    # A factor of the contrast is one of the gradient too; of its arsinh it is a shift.
    factor = 1.0 if shot.kind == "point" else max(1.0 + amounts[1], LEAST_CONTRAST)
    return dict(zip(terms, (amounts[2:] / factor).tolist(), strict=True))
