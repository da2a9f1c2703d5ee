"""Validation of a session: comparison with frames simulated from the fitted sensor, and figure data."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import Stopwatch
from charact.validation.controls import FAULTS, PARAMETERS, change_parameter, put_fault
from charact.validation.frame_features import GROUPS, FrameFeatures, features_of
from charact.validation.frames import MatchedFrames, MatchedStacks, VisibleCamera, choose, simulate_frames
from charact.validation.stack_features import LAGS
from charact.validation.target_features import FREQUENCY_CY_PER_PX, RADII_PX
from charact.validation.thresholds import VALIDATION
from charact.validation.validation_result import FramePair, Validation, ValidationControl
from charact.validation.validation_test import ValidationTest
from labdata.session import Session

Array = NDArray[np.float64]


def overlays(
    measured: FrameFeatures, simulated: list[FrameFeatures], chosen: MatchedStacks
) -> dict[str, dict[str, Any]]:
    """Return the overlays by name, JSON-ready."""
    out = {
        **{
            name: {
                "title": title,
                "x_title": "signal, DN",
                "y_title": title,
                "x": list(measured.mean_dn),
                "x_simulated": np.mean([one.mean_dn for one in simulated], axis=0).tolist(),
                **_band(np.array(getattr(measured, field)), np.array([getattr(one, field) for one in simulated])),
            }
            for name, field, title in (
                ("photon-transfer", "variance_dn2", "Temporal variance, DN²"),
                ("covariance", "covariance_dn2", "Covariance sum within 6 px, DN²"),
            )
        },
    }
    flat = chosen.flats[-1].label
    lags = [f"correlation at {row},{col} px of {flat}" for row, col in LAGS]
    rings = [f"level at {low:g} to {high:g} px of the point" for low, high in pairwise(RADII_PX)]
    frequencies = [f"MTF at {at:.2f} cy/px" for at in FREQUENCY_CY_PER_PX]
    for name, x, labels, x_title, y_title in (
        ("autocorrelation", [f"{row},{col}" for row, col in LAGS], lags, "lag (row, column), px", "correlation"),
        ("mtf", FREQUENCY_CY_PER_PX.tolist(), frequencies, "frequency, cy/px", "MTF"),
        ("point", _middles(RADII_PX), rings, "radius, px", "asinh(level above dark / 1 DN)"),
    ):
        group = measured.groups.get(name, {})
        rows = np.array([[one.groups.get(name, {}).get(label, np.nan) for label in labels] for one in simulated])
        values = np.array([group.get(label, np.nan) for label in labels])
        if np.isfinite(values).all() and np.isfinite(rows).all():
            out[name] = {"title": GROUPS[name].title, "x_title": x_title, "y_title": y_title, "x": x,
                         **_band(values, rows)}  # fmt: skip
    return out


def pairs(chosen: MatchedStacks, simulated: dict[str, NDArray]) -> tuple[FramePair, ...]:
    """Return the first frame of each stack, measured and simulated, with a common display range."""
    targets = chosen.compared[1 + len(chosen.flats) :]
    shots = {shot.label: shot for shot in (chosen.dark, chosen.flats[0], chosen.flats[-1], *targets, *chosen.others)}
    out = []
    for shot in shots.values():
        both = [np.asarray(frames[shot.label][0], float) for frames in (chosen.measured, simulated)]
        low, high = np.quantile(np.concatenate([one.ravel() for one in both]), (0.002, 0.998))
        high = max(high, low + 1.0)
        shown = [np.rint(255 * np.clip((one - low) / (high - low), 0, 1)).astype(np.uint8) for one in both]
        out.append(FramePair(
            kind=shot.kind, label=shot.label, measured=shown[0], simulated=shown[1], low_dn=float(low),
            high_dn=float(high),
        ))  # fmt: skip
    return tuple(out)


def _middles(edges: tuple[float, ...]) -> list[float]:
    return [(low + high) / 2.0 for low, high in pairwise(edges)]


def _band(measured: Array, simulated: Array) -> dict[str, list[float]]:
    """Return measured values with the mean and the 95 % band of simulated ones (draw, k)."""
    centre, sd = simulated.mean(axis=0), simulated.std(axis=0, ddof=1)
    return {
        "measured": measured.tolist(),
        "simulated": centre.tolist(),
        "low95": (centre - 1.96 * sd).tolist(),
        "high95": (centre + 1.96 * sd).tolist(),
    }


Progress = Callable[[str, float], None]

NULL = "Frames of one more posterior draw in place of the measured ones"
HALVES = "Every second measured frame against the others"
NO_DRAWS = "the camera has no posterior draws: simulated at its values"
SAME_SESSION = (
    "the camera was fitted to frames of this session: its fitted numbers agree by construction; a second session, as "
    "in charact validate DAY2 --sensor DAY1/fitted.toml, tests them"
)


def validate(
    session: Session, sensor: VisibleCamera, *, seed: int = 0, progress: Progress = lambda sentence, share: None
) -> Validation:
    """Compare a session with frames simulated from a camera description.

    Parameters
    ----------
    session
        Session with darks, flats and, for MTF and halo, an edge and a point source.
    sensor
        Fitted camera; each simulated set is one of its joint posterior draws. One without draws is simulated at its
        values, with a note.
    seed
        Seed of draws and frames.
    progress
        Called with a sentence and the fraction done.

    Returns
    -------
    Validation
        Statistics at a family-wise level (Holm); null controls, which must pass; negative controls, one parameter or
        fault each, which must fail; the error of each parameter that would have been found; overlays and frame pairs.

    Raises
    ------
    BadInput
        If the session lacks darks or flats, or names no camera of visible light.
    """
    watch = Stopwatch()
    progress("measured frames", 0.0)
    chosen = choose(session)
    rng = np.random.default_rng([seed, 7])
    full = float(2 ** (session.bit_depth or sensor.video.bit_depth) - 1)
    context = Context(
        seed=seed, quick=True, sensor=session.sensor, interlaced=session.is_interlaced, full_scale_dn=full
    )
    fitted = bool(sensor.draws.values)
    controls = [one for one in PARAMETERS if change_parameter(sensor, one, 0.1) is not None]
    steps, done = VALIDATION.draws + len(controls) + 1, 0

    def draw_camera() -> VisibleCamera:
        """Return the camera of one posterior draw; a name of its own gives it fixed patterns of its own."""
        drawn = sensor.draw(rng) if fitted else sensor
        return replace(drawn, name=f"{sensor.name}, draw {int(rng.integers(2**31))}")

    def simulate(drawn: VisibleCamera, others: tuple[MatchedFrames, ...] = (), seed: int | None = None):
        nonlocal done
        progress("simulating sets of frames", done / steps)
        done += 1
        own = int(rng.integers(2**31)) if seed is None else seed
        return simulate_frames(drawn, (*chosen.compared, *others), seed=own, like=sensor)

    def features(frames: Mapping[str, NDArray]) -> FrameFeatures:
        return features_of(frames, chosen, context=context)

    measured, many, first = features(chosen.measured), [], {}
    shown = tuple(replace(shot, frames=1) for shot in chosen.others)
    halves = []
    base, base_seed = draw_camera(), int(rng.integers(2**31))
    for index in range(VALIDATION.draws):
        frames = simulate(draw_camera()) if index else simulate(base, shown, seed=base_seed)
        first = first or frames
        many.append(features(frames))
        halves.append(_difference_of_halves(frames, chosen, context))
    test = ValidationTest([one.groups for one in many], seed=seed)
    again = test.statistics(features(simulate(draw_camera())).groups)
    found = [ValidationControl(name="null", title=NULL, statistics=again)]
    if halves[0]:
        own = ValidationTest(list(halves), seed=seed)
        statistics = own.statistics(_difference_of_halves(chosen.measured, chosen, context))
        found.append(ValidationControl(name="null", title=HALVES, statistics=statistics))
    power = []
    for control in controls:
        # The draw and seed of the first set, with the change: their difference has hardly any noise.
        altered = change_parameter(base, control, VALIDATION.control_change)
        assert altered is not None
        changed, change = altered
        other = features(simulate(changed, seed=base_seed)).groups
        title = f"{control.title} {100.0 * change:+.0f} %"
        found.append(ValidationControl(name="negative", title=title, statistics=test.statistics(other)))
        power.append(test.detectable(control.title, many[0].groups, other, change))
    for name in FAULTS:
        frames = put_fault(first, chosen, name, rng)
        statistics = test.statistics(features(frames).groups)
        found.append(ValidationControl(name="negative", title=name, statistics=statistics))
    progress("validated", 1.0)
    notes = chosen.notes if fitted else (*chosen.notes, NO_DRAWS)
    return Validation(
        session=session.name,
        sensor=sensor.name,
        seed=seed,
        draws=VALIDATION.draws,
        seconds=watch.seconds(),
        statistics=test.statistics(measured.groups),
        controls=tuple(found),
        power=tuple(power),
        overlays=overlays(measured, many, chosen),
        pairs=pairs(chosen, first),
        notes=notes,
    )


def _difference_of_halves(frames: Mapping[str, NDArray], chosen: MatchedStacks, context: Context) -> dict[str, Any]:
    """Return the numbers of every second frame less those of the others; empty where stacks are too short."""
    stacks = (chosen.dark, *chosen.flats)
    if min(len(frames[shot.label]) for shot in stacks) < 2 * VALIDATION.fewest_frames:
        return {}
    alone = replace(chosen, edge=None, point=None)
    one, other = (
        features_of({shot.label: frames[shot.label][start::2][: VALIDATION.frames // 2] for shot in stacks}, alone,
                    context=context).groups
        for start in (0, 1)
    )  # fmt: skip
    return {
        name: {label: value - other[name].get(label, np.nan) for label, value in group.items()}
        for name, group in one.items()
    }
