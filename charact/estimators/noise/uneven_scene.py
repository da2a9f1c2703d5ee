"""Photon transfer from unevenly lit frames: many small flats of one scene.

Pixels of one signal, wherever they lie, are a flat: of the N pixels of a bin, whose values y_f
have the mean m_f over the bin in frame f, mean and variance are

    mu = <y_f>,  s^2 = N / (N - 1) <var_f (y_f - m_f)>

and s^2 = s_d^2 + K (mu - mu_d) over the bins (EMVA 1288 Release 4.0, section 2.2). A mixture of
signals in a bin lies on the same line. Where pixels are full, s^2 falls: as in the standard, the
line is fitted up to 70 % of the signal of its peak, in any part of the picture.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from charact.estimators.noise.findings import fields_of, finding, judged
from charact.estimators.noise.gain.series import (
    has_intensifier,
    read_levels,
    series_of,
    series_of_one_gain,
)
from charact.estimators.noise.gain.stack_agreement import as_single_frames
from charact.estimators.noise.pixel_survey import PixelSurvey
from charact.estimators.noise.thresholds import SCENE
from charact.estimators.noise.variance import white_noise
from charact.frames.clipping import ceiling_of
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context, register
from charact.verdict import Finding, judge
from labdata import Result, Session, make_refusal, open_lazy_stack

METHOD = "uneven-scene"
# Quantities of the pixel's full well: noise takes the peak of the variance below it.
CAPACITIES = ("saturation_capacity", "snr_max", "dynamic_range")


@register("flats", METHOD)
def uneven_scene(session: Session, *, context: Context) -> Result:
    """Measure gain, noise and range of a camera with white noise from frames of uneven light.

    Parameters
    ----------
    session
        Session with at least one flat of two frames, of any still scene; darks give the noise.
    context
        Seed and settings.
    """
    darks, flats, single = read_levels(session, context=context, spectra=False)
    darks, _ = as_single_frames(darks, flats)
    binned = [levels_of(flat, session, context) for flat in flats]
    bins = [level for levels, _ in binned for level in levels]
    fields = fields_of(METHOD, context)
    series = series_of(bins, darks, single) if bins else None
    if series is not None and np.any(series.fitted):
        signal_dn = series.signal_dn[series.fitted]
        if signal_dn.max() < SCENE.least_span * signal_dn.min():
            reason = (
                f"the light of a scene must span a factor of {SCENE.least_span:g} below "
                f"saturation, got {signal_dn.min():.4g} to {signal_dn.max():.4g} DN; `method` "
                "variance measures even flats"
            )
            return Result(measurements=(make_refusal("system_gain", "DN/e-", reason, **fields),))
    result = white_noise(darks, flats, single, series, context, fields)
    if series is None or series.peak is None:
        return result
    full_dn = max(brightest_dn for _, brightest_dn in binned)
    excess = (full_dn - series.darks[0].mean_dn) / float(series.signal_dn[series.peak]) - 1.0
    seen = f"pixels are full at about {full_dn:.4g} DN"
    effect = f"{seen}, and noise moves the peak of the variance below that"
    return replace(
        result,
        measurements=tuple(
            judge(m, [_full(effect, max(excess, 0.0) * m.value)])
            if m.quantity in CAPACITIES and m.value is not None
            else judged(m, [f"{seen}; levels above 70 % of the peak of the variance are left out"])
            if m.quantity == "system_gain"
            else m
            for m in result.measurements
        ),
    )


def _full(effect: str, bound: float) -> Finding:
    """Return the finding of full pixels that are brighter than the peak of the variance."""
    return finding("saturated", effect, "even flats up to saturation", bound=bound, sign=-1)


def levels_of(
    flat: StackStatistics, session: Session, context: Context
) -> tuple[list[StackStatistics], float]:
    """Return the bins of a flat's pixels by signal, as flats of their own, from dim to bright, and
    the level of the brightest pixels, DN.
    """
    import cv2

    stack = open_lazy_stack(session.stack(flat.label))
    data = stack.frames(0, len(stack))
    full_dn = stack.full_scale_dn if context.full_scale_dn is None else context.full_scale_dn
    ceiling_dn = ceiling_of(data, full_dn)
    # The neighbours' signal sorts the pixels, so that a pixel's own noise does not.
    signal = cv2.blur(data.mean(axis=0, dtype=np.float64), (SCENE.smoothing_px,) * 2).ravel()
    pixels = data.reshape(len(data), -1)
    low, high = np.quantile(signal, SCENE.range)
    edges = np.linspace(low, high, SCENE.steps + 1)[1:-1]
    number = np.searchsorted(edges, signal)
    counts = np.bincount(number, minlength=SCENE.steps)
    needed = SCENE.differences / (len(data) - 1)
    levels, members = [], np.zeros(signal.size, bool)
    for step in range(SCENE.steps):
        members |= number == step
        remaining = counts[step + 1 :].sum()
        if members.sum() < needed or 0 < remaining < needed:
            continue
        values = pixels[:, members].astype(np.float64)
        means = values.mean(axis=1)
        variances = (values - means[:, None]).var(axis=0, ddof=1)
        size = variances.size
        levels.append(
            replace(
                flat,
                label=f"{flat.label} at {means.mean():.4g} DN",
                # The light of a bin is not that of the stack.
                conditions=replace(flat.conditions, illuminance_lux=None, photons_per_px=None),
                pixels=size,
                mean_dn=float(means.mean()),
                frame_mean_dn=means,
                variance_dn2=float(variances.mean()) * size / (size - 1),
                variance_sd_dn2=float(variances.std() / np.sqrt(size)),
                spatial_variance_dn2=0.0,
                high_fraction=0.0 if ceiling_dn is None else float(np.mean(values >= ceiling_dn)),
            )
        )
        members[:] = False
    return levels, float(high)


def suits(session: Session, surveys: Sequence[PixelSurvey], context: Context) -> bool:
    """Return whether unevenly lit flats of a camera without an intensifier show their gain only by
    bins: a single flat, or flats in which some of the pixels are full.
    """
    entries = session.of_kind("flat")
    black_dn = min((survey.level_dn for survey in surveys if survey.kind == "dark"), default=None)
    uneven = [
        survey
        for survey in surveys
        if survey.kind == "flat"
        and black_dn is not None
        and survey.profiles is not None
        and _span(survey, black_dn) > SCENE.least_span
    ]
    if not uneven or has_intensifier([entry.conditions for entry in entries], context):
        return False
    if len(entries) == 1:
        return True
    brightest = max(uneven, key=lambda survey: survey.level_dn)
    chosen = replace(session, stacks=(*session.of_kind("dark"), session.stack(brightest.label)))
    darks, flats, _ = read_levels(chosen, context=context, spectra=False)
    return any(
        series_of_one_gain(levels_of(flat, session, context)[0], darks).peak is not None
        for flat in flats
    )


def _span(survey: PixelSurvey, black_dn: float) -> float:
    """Return the ratio of bright to dim parts of a mean frame above black."""
    assert survey.profiles is not None
    signal = np.concatenate([part.ravel() for part in survey.profiles]) - black_dn
    dim, bright = np.quantile(signal, (0.05, 0.95))
    return float(bright / max(dim, 1e-12 * abs(bright)))
