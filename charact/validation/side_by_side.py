"""The validation of a session: the fitted sensor alone is simulated, draw by draw, and laid beside the frames."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import Stopwatch
from charact.validation.frame_features import FrameFeatures, portrait_of, statistics
from charact.validation.frames import MatchedStacks, choose, simulate_frames
from charact.validation.overlay import overlays, pairs
from charact.validation.validation_result import Statistic, Validation, ValidationControl
from labdata.errors import BadInput
from labdata.sensor import Sensor
from labdata.session import Session

Progress = Callable[[str, float], None]

DRAWS = 12
# Of the tube's blur, what is left behind the gain in the negative control: the noise is then hardly correlated, while
# the MTF stays what it was.
REMOVED_SHARE = 1e-6
NULL = "Frames of one more posterior draw in place of the measured ones: must pass"
NEGATIVE = "Frames of the sensor with the blur behind the gain moved before it: must fail"
NO_DRAWS = "the sensor has no posterior draws: simulated at its values"


def validate(
    session: Session, sensor: Sensor, *, seed: int = 0, progress: Progress = lambda sentence, share: None
) -> Validation:
    """Lay a session beside frames simulated from a sensor description alone.

    Parameters
    ----------
    session
        The session: darks, flats and, for the MTF, an edge.
    sensor
        The fitted sensor; each simulated set is one of its joint posterior draws. One without draws is simulated at
        its values, and a note says so.
    seed
        Seed of draws and frames.
    progress
        Called with a sentence and the share done.

    Returns
    -------
    Validation
        Statistics with their verdicts, a null control (frames of one more draw, which must pass) and a negative one
        (the blur behind the gain moved before it, which must fail), overlays and pictures.

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
    run = _Run(session, sensor, chosen, seed)
    measured = run.portrait(chosen.measured)
    many, first = [], {}
    for index in range(DRAWS):
        progress(f"simulating draw {index + 1} of {DRAWS}", (index + 0.5) / (DRAWS + 3))
        frames = run.frames(run.drawn(), others=index == 0)
        first = first or frames
        many.append(run.portrait(frames))
    progress("null control", (DRAWS + 1) / (DRAWS + 3))
    null = run.portrait(run.frames(run.drawn()))
    progress("negative control", (DRAWS + 2) / (DRAWS + 3))
    removed = run.drawn().with_values({"tube.post_gain_share": REMOVED_SHARE})
    negative = run.portrait(run.frames(removed))
    progress("validated", 1.0)
    return Validation(
        session=session.name,
        sensor=sensor.name,
        seed=seed,
        draws=DRAWS,
        seconds=watch.seconds(),
        statistics=run.statistics(measured, many),
        controls=(
            ValidationControl(name="null", title=NULL, statistics=run.statistics(null, many)),
            ValidationControl(name="negative", title=NEGATIVE, statistics=run.statistics(negative, many)),
        ),
        overlays=overlays(measured, many, chosen),
        pairs=pairs(chosen, first),
        notes=chosen.notes if sensor.draws.values else (*chosen.notes, NO_DRAWS),
    )


class _Run:
    """The random numbers of one validation, in the order in which they are used."""

    def __init__(self, session: Session, sensor: Sensor, chosen: MatchedStacks, seed: int) -> None:
        self._sensor, self._chosen = sensor, chosen
        self._rng = np.random.default_rng([seed, 7])
        full = float(2 ** (session.bit_depth or sensor.video.bit_depth) - 1)
        self._context = Context(
            seed=seed, quick=True, sensor=session.sensor, interlaced=session.is_interlaced, full_scale_dn=full
        )

    def drawn(self) -> Sensor:
        """Return the sensor of one posterior draw; a name of its own gives it fixed patterns of its own."""
        drawn = self._sensor.draw(self._rng) if self._sensor.draws.values else self._sensor
        return replace(drawn, name=f"{self._sensor.name}, draw {int(self._rng.integers(2**31))}")

    def frames(self, sensor: Sensor, *, others: bool = False) -> dict[str, NDArray]:
        """Return simulated frames of the chosen stacks."""
        chosen = self._chosen
        shots = (chosen.dark, *chosen.flats, *((chosen.edge,) if chosen.edge else ()))
        shown = tuple(replace(shot, frames=1) for shot in chosen.others) if others else ()
        return simulate_frames(sensor, (*shots, *shown), seed=int(self._rng.integers(2**31)))

    def portrait(self, frames: dict[str, NDArray]) -> FrameFeatures:
        """Return the numbers of frames."""
        return portrait_of(frames, self._chosen, context=self._context, rng=self._rng)

    def statistics(self, one: FrameFeatures, many: list[FrameFeatures]) -> tuple[Statistic, ...]:
        """Return the statistics of one portrait against many."""
        return statistics(one, many, self._chosen, rng=self._rng)
