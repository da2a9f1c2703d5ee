"""Validation of a session: comparison with frames simulated from the fitted sensor, and its
controls.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import Stopwatch
from charact.observables import Numbers
from charact.observables.size import Tolerance, size_of
from charact.validation.controls import (
    PARAMETERS,
    ParameterControl,
    alternative_of,
    change_parameter,
    detectable_error,
    null_control,
)
from charact.validation.faults import FAULTS
from charact.validation.figure_data import FigureCurves, curves_of, figures_of
from charact.validation.frame_features import (
    GROUPS,
    FrameFeatures,
    features_of,
    features_of_parts,
    stacks_for,
)
from charact.validation.frames import (
    MatchedFrames,
    MatchedStacks,
    choose,
    point_levels,
)
from charact.validation.likely_causes import CauseTest, alternatives_of, likely_causes
from charact.validation.session_bench import measured_bench
from charact.validation.simulated_frames import simulate_frames
from charact.validation.statistic import Statistic
from charact.validation.thresholds import TOLERANCES, VALIDATION
from charact.validation.validation_result import Validation, ValidationControl
from charact.validation.validation_test import SCORES, Groups, ParameterChange, ValidationTest
from labdata import BadInput, Camera, Session

Frames = Mapping[str, NDArray]
Progress = Callable[[str, float], None]

NULL = "Frames of further posterior draws in place of the measured ones"
HALVES = "Every second measured frame against the others"
NO_DRAWS = "the camera has no posterior draws: simulated at its values"
QUICK = (
    "a quick validation draws one level of the point source, and changes some parameters only, "
    "each once, for its negative controls"
)


def validate(
    session: Session,
    sensor: Camera,
    *,
    tolerances: tuple[Tolerance, ...] = (),
    quick: bool = False,
    seed: int = 0,
    progress: Progress = lambda sentence, fraction: None,
) -> Validation:
    """Compare a session with frames simulated from a camera description.

    Parameters
    ----------
    session
        Session with darks, flats and, for MTF and halo, an edge and a point source.
    sensor
        Fitted camera; each simulated set is one of its joint posterior draws. One without draws is
        simulated at its values, with a note.
    tolerances
        Departures that do not matter, in place of those of `TOLERANCES`.
    quick
        Whether only some parameters are changed for negative controls, whose detectable errors
        follow from that one change, and figures have one level of the point source, with a note;
        the statistics are the same.
    seed
        Seed of draws and frames.
    progress
        Called with a sentence and the fraction done.

    Returns
    -------
    Validation
        Statistics at a family-wise level (Holm), each with the size of its departure; null
        controls, which must pass; negative controls, one parameter or fault each, which must fail;
        the error of each parameter that would have been found; figure data and pictures.

    Raises
    ------
    BadInput
        If the session lacks darks or flats, or names no camera of visible light, or a tolerance
        names no statistic.
    """
    _require_statistics(tolerances)
    watch = Stopwatch()
    progress("measured frames", 0.0)
    chosen = measured_bench(choose(session, sensor.maps), sensor)
    levels, frames_of_levels = ((), {}) if quick else point_levels(session, chosen)
    known_changes = [control for control in PARAMETERS if control.path_in(sensor) is not None]
    changes = [control for control in known_changes if control.quick or not quick]
    bench = _Bench(
        session,
        chosen,
        sensor,
        seed=seed,
        steps=VALIDATION.draws + (1 if quick else 2) * len(changes) + 1,
        progress=progress,
    )
    sets = _simulate_sets(bench, levels)
    parameters = tuple(_change_of(bench, sets, control, control.change) for control in changes)
    test = ValidationTest(
        [numbers.groups for numbers in sets.features], seed=seed, changes=parameters
    )
    measured = bench.features(chosen.measured)
    known = (*TOLERANCES, *tolerances)
    nulls = _null_controls(bench, test, sets, known)
    altered_groups = {
        f"{change.title} {100.0 * change.change:+.0f} %": change.changed for change in parameters
    } | {
        name: bench.numbers(fault.put_into(sets.first, chosen, fault.stacks[0], bench.full_dn))
        for name, fault in FAULTS.items()
    }
    negatives = (
        ValidationControl(name="negative", title=title, statistics=test.statistics(groups))
        for title, groups in altered_groups.items()
    )
    controls = (*nulls, *negatives)
    parts = features_of_parts(chosen, [(sets.drawn[0][0], sets.first)], context=bench.context)
    statistics = _settled_statistics(bench, test, (measured, parts), known)
    changes_by = [
        (control, change, partial(_change_of, bench, sets, control))
        for control, change in zip(changes, parameters, strict=True)
    ]
    causes = ()
    if not all(statistic.passed for statistic in statistics):
        faults = alternatives_of(sets.first, chosen, bench.numbers, bench.full_dn)
        errors = (alternative_of(*change_by) for change_by in changes_by)
        plain = sets.features[0].groups
        causes = likely_causes(
            CauseTest(test.ensembles, plain, measured.groups), (*faults, *errors)
        )
    progress("validated", 1.0)
    measured_set = {**chosen.measured, **frames_of_levels}, measured
    figures = figures_of(
        chosen, levels, measured_set, (sets.first, sets.features, sets.curves), seed=seed
    )
    return Validation(
        session=session.name,
        sensor=sensor.name,
        seed=seed,
        draws=VALIDATION.draws,
        seconds=watch.seconds(),
        statistics=statistics,
        controls=controls,
        power=tuple(
            test.detectable(change)
            if quick
            else detectable_error(test, change, partial(change_by, number=1))
            for _, change, change_by in changes_by
        ),
        causes=causes,
        figures=figures,
        notes=(
            *chosen.notes,
            *[NO_DRAWS] * (not bench.fitted),
            *[f"{QUICK}: {len(changes)} of {len(known_changes)}"] * quick,
        ),
        # A finding of the fit stands in the notes of the camera, its flag first.
        converged="not-converged" not in {note.partition(":")[0] for note in sensor.notes},
    )


def _require_statistics(tolerances: tuple[Tolerance, ...]) -> None:
    """Raise BadInput for a tolerance of an unknown statistic."""
    known = (*GROUPS, SCORES)
    for tolerance in tolerances:
        if tolerance.statistic not in (None, *known):
            raise BadInput(
                f"statistic of a tolerance must be one of {', '.join(known)}, got "
                f"{tolerance.statistic!r}"
            )


class _Bench:
    """Simulates sets of frames under the conditions of the chosen stacks, by one generator, and
    takes their numbers.
    """

    def __init__(
        self,
        session: Session,
        chosen: MatchedStacks,
        sensor: Camera,
        *,
        seed: int,
        steps: int,
        progress: Progress,
    ) -> None:
        self.full_dn = float(2 ** (session.bit_depth or sensor.video.bit_depth) - 1)
        self.context = Context(
            seed=seed,
            quick=True,
            camera=session.camera,
            interlaced=session.is_interlaced,
            full_scale_dn=self.full_dn,
        )
        self.rng = np.random.default_rng([seed, 7])
        self.fitted = bool(sensor.draws.values)
        self.chosen, self.sensor = chosen, sensor
        self._progress, self._steps, self._done = progress, steps, 0

    def draw_camera(self) -> Camera:
        """Return the camera of one posterior draw; a name of its own gives it fixed patterns of its
        own.
        """
        drawn = self.sensor.draw(self.rng) if self.fitted else self.sensor
        return replace(drawn, name=f"{self.sensor.name}, draw {self.draw_seed()}")

    def draw_seed(self) -> int:
        """Return the seed of a set of frames."""
        return int(self.rng.integers(2**31))

    def simulate(
        self, camera: Camera, seed: int, further: tuple[MatchedFrames, ...] = ()
    ) -> Frames:
        """Return a simulated set of frames by label; `further` are stacks besides the compared
        ones.
        """
        self._progress("simulating sets of frames", min(1.0, self._done / self._steps))
        self._done += 1
        return simulate_frames(
            camera, (*self.chosen.compared, *further), seed=seed, like=self.sensor
        )

    def features(self, frames: Frames) -> FrameFeatures:
        """Return the numbers of a set of frames."""
        return features_of(frames, self.chosen, context=self.context)

    def numbers(self, frames: Frames) -> Groups:
        """Return the numbers of a set of frames by group."""
        return self.features(frames).groups

    def numbers_of_next_draw(self, names: Sequence[str]) -> Groups:
        """Return the numbers of some groups of frames of a further posterior draw."""
        chosen = stacks_for(names, self.chosen)
        frames = simulate_frames(
            self.draw_camera(), chosen.compared, seed=self.draw_seed(), like=self.sensor
        )
        return features_of(frames, chosen, context=self.context, names=names).groups

    def difference_of_halves(self, frames: Frames) -> dict[str, dict[str, float]]:
        """Return the numbers of every second frame less those of the others; empty where stacks are
        too short.
        """
        stacks = (self.chosen.dark, *self.chosen.flats)
        if min(len(frames[shot.label]) for shot in stacks) < 2 * VALIDATION.fewest_frames:
            return {}
        alone = replace(self.chosen, edge=None, point=None)
        first_half, second_half = (
            features_of(
                {
                    shot.label: frames[shot.label][start::2][: VALIDATION.frames // 2]
                    for shot in stacks
                },
                alone,
                context=self.context,
            ).groups
            for start in (0, 1)
        )
        return {
            name: {
                label: value - second_half[name].get(label, np.nan)
                for label, value in group.items()
            }
            for name, group in first_half.items()
        }


@dataclass(frozen=True, kw_only=True)
class _SimulatedSets:
    """Cameras, seeds, numbers and curves of the simulated sets, and frames of the first."""

    drawn: tuple[tuple[Camera, int], ...]
    first: Frames
    features: tuple[FrameFeatures, ...]
    halves: tuple[Mapping[str, Numbers], ...]
    curves: tuple[FigureCurves, ...]


def _simulate_sets(bench: _Bench, levels: tuple[MatchedFrames, ...]) -> _SimulatedSets:
    """Simulate the ensemble, a posterior draw a set; of the levels of a point source only the
    curves are taken.
    """
    drawn = []
    pictured = tuple(replace(shot, frames=1) for shot in bench.chosen.display_only)
    first: Frames = {}
    features, halves, curves = [], [], []
    for index in range(VALIDATION.draws):
        camera, seed = bench.draw_camera(), bench.draw_seed()
        drawn.append((camera, seed))
        frames = bench.simulate(camera, seed, levels if index else (*pictured, *levels))
        first = first or frames
        features.append(bench.features(frames))
        halves.append(bench.difference_of_halves(frames))
        curves.append(curves_of(frames, bench.chosen, levels))
    return _SimulatedSets(
        drawn=tuple(drawn),
        first=first,
        features=tuple(features),
        halves=tuple(halves),
        curves=tuple(curves),
    )


def _settled_statistics(
    bench: _Bench,
    test: ValidationTest,
    measured: tuple[FrameFeatures, Mapping[str, Groups]],
    tolerances: tuple[Tolerance, ...],
) -> tuple[Statistic, ...]:
    """Return the statistics of the measured numbers, of crop and parts, with as many simulated sets
    as settle their verdicts.
    """
    features, parts = measured
    further: dict[str, list[Numbers]] = {}
    simulated = 0
    while True:
        statistics = test.statistics(
            features.groups, parts, sizes=features.sizes, tolerances=tolerances
        )
        names = test.unsure(statistics)
        simulated += VALIDATION.draws * len(stacks_for(names, bench.chosen).compared)
        if not names or simulated > VALIDATION.most_further:
            return statistics
        for _ in range(VALIDATION.draws):
            for name, numbers in bench.numbers_of_next_draw(names).items():
                further.setdefault(name, []).append(numbers)
        test = test.with_further(further)


def _null_controls(
    bench: _Bench,
    test: ValidationTest,
    sets: _SimulatedSets,
    tolerances: tuple[Tolerance, ...],
) -> tuple[ValidationControl, ...]:
    """Return the controls that must pass: further draws, and the halves of long stacks against each
    other.
    """

    def of_next_draw() -> tuple[Statistic, ...]:
        features = bench.features(bench.simulate(bench.draw_camera(), bench.draw_seed()))
        return test.statistics(features.groups, sizes=features.sizes, tolerances=tolerances)

    controls = [null_control(NULL, of_next_draw)]
    if sets.halves[0]:
        first = sets.features[0]
        sizes = {
            name: {
                label: size.about(value)
                for label, value in numbers.items()
                if (size := size_of(label, first.sizes[name]))
            }
            for name, numbers in first.groups.items()
        }
        halves_test = ValidationTest(list(sets.halves), seed=bench.context.seed)
        statistics = halves_test.statistics(
            bench.difference_of_halves(bench.chosen.measured),
            level=VALIDATION.halves_level,
            sizes=sizes,
            tolerances=tolerances,
        )
        controls.append(ValidationControl(name="null", title=HALVES, statistics=statistics))
    return tuple(controls)


def _change_of(
    bench: _Bench,
    sets: _SimulatedSets,
    control: ParameterControl,
    change: float,
    number: int = 0,
) -> ParameterChange:
    """Return the change of a set of a number, its draw and seed, by that of a parameter."""
    # The same random numbers: the difference has little noise.
    drawn, seed = sets.drawn[number]
    altered = change_parameter(drawn, control, change)
    assert altered is not None
    camera, change = altered
    return ParameterChange(
        title=control.title,
        plain=sets.features[number].groups,
        changed=bench.features(bench.simulate(camera, seed)).groups,
        change=change,
        power=control.power,
        least_error=control.least_error(bench.sensor),
    )
