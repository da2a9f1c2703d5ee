"""Checks of a fusion against its frames: noise law, rim of subtracted halos, lamps, and holes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from charact.fusion.bands import Image, Plane
from charact.fusion.pyramid import decompose, map_samples
from charact.fusion.registration import Residual, residual_shift
from charact.fusion.thresholds import FUSION
from charact.verdict import Finding
from labdata import BadInput


def find_problems(
    planes: Sequence[Plane], finest: Sequence[Image] | None = None
) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    """Return what these frames show against their description, and notes on what was left out.

    `finest`: the finest details of each band, sampled by `map_samples`, if they are there already.
    """
    findings, notes = [], []
    for number, plane in enumerate(planes):
        plane_findings = (
            noise_finding(plane, finest[number] if finest else None),
            *rim_findings(plane),
            hole_finding(plane),
        )
        findings += [finding for finding in plane_findings if finding]
    if not any(plane.clipped is not None or plane.restored for plane in planes):
        notes.append("no lamp in view: the bloom step was left out")
    return tuple(findings), tuple(notes)


def registration_finding(planes: Sequence[Plane]) -> tuple[Finding | None, tuple[str, ...]]:
    """Return the finding of a band shifted against the first one, and notes on shifts that cannot
    be measured.

    A shift surely beyond 2 px is BadInput.
    """
    fixed, notes, finding = planes[0], [], None
    for plane in planes[1:]:
        shift = measure_shift(fixed, plane)
        name = f"{plane.band.name} against {fixed.band.name}"
        if not np.isfinite(shift.magnitude_px):
            notes.append(
                f"the shift of {name} could not be measured ({shift.reason}): registration is as "
                "given"
            )
            continue
        across, down = shift.interval_px(0.95)
        text = (
            f"{shift.shift_px[1]:.2f} rows [{down[0]:.2f}, {down[1]:.2f}] and "
            f"{shift.shift_px[0]:.2f} columns [{across[0]:.2f}, {across[1]:.2f}] (95 %)"
        )
        if shift.least_px > FUSION.refused_shift_px:
            rule = f"bands must be registered within {FUSION.refused_shift_px:g} px"
            raise BadInput(f"{rule}, got {name} shifted by {text}")
        if shift.least_px > FUSION.flagged_shift_px:
            effect = f"{name} is shifted by {text}; a shift of 2 px costs a third of d'^2"
            finding = Finding(flag="unregistered", effect=effect, remedy="registration to one grid")
        elif shift.status != "ok":
            notes.append(f"the shift of {name} is not known well: {text}")
    return finding, tuple(notes)


def measure_shift(fixed: Plane, moving: Plane) -> Residual:
    """Return the shift of a band against another of one size, measured on pixels that both know."""
    lost = [plane.hole for plane in (fixed, moving) if plane.hole is not None]
    return residual_shift(fixed.value, moving.value, ~np.logical_or.reduce(lost) if lost else None)


def noise_finding(plane: Plane, detail: Image | None = None) -> Finding | None:
    """Return the finding of an unknown noise law, or of one that the finest details of the frame
    contradict.

    `detail`: finest details of `map_samples`, if they are there already. The median of squares over
    their expectation outside holes is compared: of Gaussian noise, 0.4549 times the variance.
    """
    name = plane.band.name
    if not plane.law.is_known:
        effect = (
            f"noise of {name} was estimated from quiet blocks of the frame: weights and standard "
            "deviations may be off by a factor of 2"
        )
        return Finding(flag="uncalibrated", effect=effect, remedy="`sensor`, or a measured session")
    detail = map_samples(decompose(plane.value, 1)[0]) if detail is None else detail
    relative = detail * detail / np.maximum(plane.variance(0), np.float32(1e-12))
    shown = relative if plane.hole is None else relative[~map_samples(plane.hole)]
    ratio = float(np.median(shown)) / 0.4549 if shown.size else np.inf
    if FUSION.least_noise_ratio <= ratio <= FUSION.most_noise_ratio:
        return None
    effect = f"the finest details of {name} have {ratio:.2g} times the variance of the stated noise"
    remedy = "gain and dark level of this frame, or a sensor fitted to this camera"
    return Finding(flag="model-misfit", effect=effect, remedy=remedy)


def hole_finding(plane: Plane) -> Finding | None:
    """Return the finding of a band with too few pixels that carry information."""
    hole_fraction = 0.0 if plane.hole is None else float(plane.hole.mean())
    if hole_fraction <= FUSION.most_holes:
        return None
    effect = (
        f"{100 * hole_fraction:.2g} % of {plane.band.name} are clipped, occluded or of unknown "
        "blooming; they hold the other bands alone"
    )
    return Finding(flag="clipped", effect=effect, remedy="a shorter exposure or lower gain")


def rim_findings(plane: Plane) -> list[Finding]:
    """Return the findings of halos whose rim is left in the frame after subtraction: radius or
    amount is wrong.
    """
    findings = []
    for source in plane.band.bloom.sources if plane.band.bloom else ():
        position = f"at row {source.row:.0f}, col {source.col:.0f} of {plane.band.name}"
        if not source.has_known_signal:
            effect = f"a lamp {position} has unknown blooming ({source.reason})"
            findings.append(
                Finding(flag="saturated", effect=effect, remedy="a shorter exposure or lower gain")
            )
            continue
        step = rim_step(plane, source.row, source.col)
        if step is not None and abs(step[0]) > max(FUSION.most_rim_share, FUSION.rim_sd * step[1]):
            effect = f"the halo {position} leaves {100 * step[0]:.0f} % of its step at the rim"
            remedy = "halo diameter and fraction of this camera, from a point series"
            findings.append(Finding(flag="model-misfit", effect=effect, remedy=remedy))
    return findings


# Width of the rings inside and outside of a rim, px: a radius 4 px off puts most of the step into
# one of the rings; the largest distance from a lamp; and the number of sectors.
RING_PX, REACH_PX, SECTORS = 5, 100, 24


def rim_step(plane: Plane, row: float, col: float) -> tuple[float, float] | None:
    """Return the largest step left across a circle around a lamp, and its standard error; None if
    no halo is visible.

    Both are relative to the largest such step of the blooming that was subtracted. A step is the
    mean of a ring of 5 px less that of the next one; the median over 24 sectors, so that scene
    structure counts as noise.
    """
    bloom = plane.band.bloom
    assert bloom is not None
    top, left = max(0, int(row) - REACH_PX), max(0, int(col) - REACH_PX)
    window = np.s_[top : int(row) + REACH_PX + 1, left : int(col) + REACH_PX + 1]
    values, amount = plane.value[window], np.asarray(bloom.blooming_dn[window], np.float32)
    rows, cols = np.ogrid[: values.shape[0], : values.shape[1]]
    down, across = (rows + (top - row)).astype(np.float32), (cols + (left - col)).astype(np.float32)
    radius, angle = np.hypot(down, across), np.arctan2(down, across)
    valid = np.isfinite(amount) & (radius < REACH_PX)
    valid &= True if plane.hole is None else ~plane.hole[window]
    sector = np.minimum((angle[valid] + np.pi) * (SECTORS / (2.0 * np.pi)), SECTORS - 1).astype(int)
    cell = radius[valid].astype(int) * SECTORS + sector
    count, left_over, subtracted = (
        np.bincount(cell, weight, REACH_PX * SECTORS).reshape(REACH_PX, SECTORS)
        for weight in (None, values[valid], amount[valid])
    )
    inner = int(np.argmax(count.sum(axis=1) > SECTORS)) + 2
    steps = _ring_steps(left_over, count)[inner + RING_PX :]
    halo_step = np.nanmedian(_ring_steps(subtracted, count)[inner + RING_PX :], axis=1)
    scale = float(np.nanmax(halo_step, initial=0.0)) / (plane.span[1] - plane.span[0])
    if not scale > FUSION.least_rim:
        return None
    middle = np.nanmedian(steps, axis=1)
    number = np.isfinite(steps).sum(axis=1)
    error = 1.25 * np.nanstd(steps, axis=1) / np.sqrt(np.maximum(number, 1))
    # Beyond the rim of the subtracted halo nothing of it is left.
    rim = int(np.nanargmax(halo_step)) + 2 * RING_PX
    usable = (number >= SECTORS // 2) & (np.arange(number.size) <= rim)
    if not usable.any():
        return None
    at = int(np.argmax(np.where(usable, np.abs(middle) - FUSION.rim_sd * error, -np.inf)))
    return float(middle[at]) / scale, float(error[at]) / scale


def _ring_steps(total: NDArray, count: NDArray) -> NDArray:
    """Return the mean of the ring inside less that outside of each radius, shape (radius, sector);
    NaN if unknown.
    """
    sums, numbers = (
        np.cumsum(np.pad(sectors, ((1, 0), (0, 0))), axis=0) for sectors in (total, count)
    )
    ends = (
        np.clip(np.arange(REACH_PX) + RING_PX, 0, REACH_PX),
        np.clip(np.arange(REACH_PX) - RING_PX, 0, REACH_PX),
    )
    at = np.arange(REACH_PX)
    with np.errstate(invalid="ignore", divide="ignore"):
        inner_mean = (sums[at] - sums[ends[1]]) / (numbers[at] - numbers[ends[1]])
        outer_mean = (sums[ends[0]] - sums[at]) / (numbers[ends[0]] - numbers[at])
    return inner_mean - outer_mean
