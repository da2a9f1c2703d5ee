"""Validation of a session: comparison with frames simulated from the fitted sensor, and figure data."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import Stopwatch
from charact.validation import frame_features
from charact.validation.frame_features import FrameFeatures, portrait_of, statistics
from charact.validation.frames import MatchedFrames, MatchedStacks, choose, simulate_frames
from charact.validation.validation_result import FramePair, Validation, ValidationControl
from labdata.errors import BadInput
from labdata.sensor import Sensor
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
                "x": measured.mean_dn.tolist(),
                "x_simulated": np.mean([one.mean_dn for one in simulated], axis=0).tolist(),
                **_band(getattr(measured, field), np.array([getattr(one, field) for one in simulated])),
            }
            for name, field, title in (
                ("photon-transfer", "variance_dn2", "Temporal variance, DN²"),
                ("covariance", "covariance_dn2", "Covariance sum within 6 px, DN²"),
            )
        },
        "autocorrelation": {
            "title": "Correlation of neighbouring pixels",
            "x_title": "lag, px",
            "y_title": "correlation",
            "x": list(frame_features.LAG_NAMES),
            **_band(measured.correlation.value, np.array([one.correlation.value for one in simulated])),
        },
        "histogram": _histogram(measured, simulated, chosen),
    }
    curves = [one.mtf.value for one in simulated if one.mtf is not None]
    if measured.mtf is not None and curves:
        out["mtf"] = {
            "title": "MTF of the edge, both by the same method",
            "x_title": "frequency, cy/px",
            "y_title": "MTF",
            "x": frame_features.FREQUENCY_CY_PER_PX.tolist(),
            **_band(measured.mtf.value, np.array(curves)),
            "measured_sd": np.sqrt(np.diag(measured.mtf.covariance)).tolist(),
        }
    return out


def pairs(chosen: MatchedStacks, simulated: dict[str, NDArray]) -> tuple[FramePair, ...]:
    """Return the first frame of each stack, measured and simulated, with a common display range."""
    shots = (chosen.flats[-1], *chosen.compared[1 + len(chosen.flats) :], *chosen.others)
    out = []
    for shot in shots:
        both = [np.asarray(frames[shot.label][0], float) for frames in (chosen.measured, simulated)]
        low, high = np.quantile(np.concatenate([one.ravel() for one in both]), (0.002, 0.998))
        high = max(high, low + 1.0)
        shown = [np.rint(255 * np.clip((one - low) / (high - low), 0, 1)).astype(np.uint8) for one in both]
        out.append(FramePair(
            kind=shot.kind, label=shot.label, measured=shown[0], simulated=shown[1], low_dn=float(low),
            high_dn=float(high),
        ))  # fmt: skip
    return tuple(out)


def _band(measured: Array, simulated: Array) -> dict[str, list[float]]:
    """Return measured values with the mean and the 95 % band of simulated ones (draw, k)."""
    centre, sd = simulated.mean(axis=0), simulated.std(axis=0, ddof=1)
    return {
        "measured": measured.tolist(),
        "simulated": centre.tolist(),
        "low95": (centre - 1.96 * sd).tolist(),
        "high95": (centre + 1.96 * sd).tolist(),
    }


def _histogram(measured: FrameFeatures, simulated: list[FrameFeatures], chosen: MatchedStacks) -> dict[str, Any]:
    top = float(np.abs(measured.grey_dn).max())
    edges = np.linspace(-top, top, 40 + 1)

    def density(sample: Array) -> Array:
        return np.histogram(sample, edges)[0] / (sample.size * np.diff(edges))

    return {
        "title": f"Grey levels of {chosen.flats[-1].label} about their mean",
        "x_title": "grey level less the mean, DN",
        "y_title": "density, 1/DN",
        "x": ((edges[1:] + edges[:-1]) / 2).tolist(),
        **_band(density(measured.grey_dn), np.array([density(one.grey_dn) for one in simulated])),
    }


Progress = Callable[[str, float], None]

DRAWS = 12
NULL = "Frames of one more posterior draw in place of the measured ones: must pass"
NEGATIVE = "Frames of the sensor with the blur after the gain moved before it: must fail"
NO_DRAWS = "the sensor has no posterior draws: simulated at its values"


def validate(
    session: Session, sensor: Sensor, *, seed: int = 0, progress: Progress = lambda sentence, share: None
) -> Validation:
    """Compare a session with frames simulated from a sensor description.

    Parameters
    ----------
    session
        Session with darks, flats and, for the MTF, an edge.
    sensor
        Fitted sensor; each simulated set is one of its joint posterior draws. One without draws is simulated at its
        values, with a note.
    seed
        Seed of draws and frames.
    progress
        Called with a sentence and the fraction done.

    Returns
    -------
    Validation
        Statistics, a null control (frames of one more draw, which must pass) and a negative one (the blur after the
        gain moved before it, which must fail), overlays and frame pairs.

    Raises
    ------
    BadInput
        If the session lacks darks or flats, or was not taken by an image-intensified camera.
    """
    watch = Stopwatch()
    if session.sensor is None:
        raise BadInput(f"a validation needs a session of a described sensor, got none in {session.name!r}")
    progress("measured frames", 0.0)
    chosen = choose(session)
    rng = np.random.default_rng([seed, 7])
    full = float(2 ** (session.bit_depth or sensor.video.bit_depth) - 1)
    context = Context(
        seed=seed, quick=True, sensor=session.sensor, interlaced=session.is_interlaced, full_scale_dn=full
    )

    def draw_sensor() -> Sensor:
        """Return the sensor of one posterior draw; a name of its own gives it fixed patterns of its own."""
        drawn = sensor.draw(rng) if sensor.draws.values else sensor
        return replace(drawn, name=f"{sensor.name}, draw {int(rng.integers(2**31))}")

    def simulate(drawn: Sensor, others: tuple[MatchedFrames, ...] = ()) -> dict[str, NDArray]:
        return simulate_frames(drawn, (*chosen.compared, *others), seed=int(rng.integers(2**31)))

    def portrait(frames: dict[str, NDArray]) -> FrameFeatures:
        return portrait_of(frames, chosen, context=context, rng=rng)

    measured, many, first = portrait(chosen.measured), [], {}
    shown = tuple(replace(shot, frames=1) for shot in chosen.others)
    for index in range(DRAWS):
        progress(f"simulating draw {index + 1} of {DRAWS}", (index + 0.5) / (DRAWS + 3))
        frames = simulate(draw_sensor(), () if first else shown)
        first = first or frames
        many.append(portrait(frames))
    progress("null control", (DRAWS + 1) / (DRAWS + 3))
    null = portrait(simulate(draw_sensor()))
    progress("negative control", (DRAWS + 2) / (DRAWS + 3))
    negative = portrait(simulate(draw_sensor().with_values({"tube.post_gain_share": 1e-6})))
    progress("validated", 1.0)
    found, of_null, of_negative = (statistics(one, many, chosen, rng=rng) for one in (measured, null, negative))
    return Validation(
        session=session.name,
        sensor=sensor.name,
        seed=seed,
        draws=DRAWS,
        seconds=watch.seconds(),
        statistics=found,
        controls=(
            ValidationControl(name="null", title=NULL, statistics=of_null),
            ValidationControl(name="negative", title=NEGATIVE, statistics=of_negative),
        ),
        overlays=overlays(measured, many, chosen),
        pairs=pairs(chosen, first),
        notes=chosen.notes if sensor.draws.values else (*chosen.notes, NO_DRAWS),
    )
