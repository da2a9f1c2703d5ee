"""All statistics of a validation: each group of numbers against its simulated ensemble, at one
family-wise level.
"""

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from charact.observables import Numbers
from charact.observables.size import Size, Tolerance, size_of, tolerance_of
from charact.validation.ensemble import Ensemble, ensemble_of, holm_levels
from charact.validation.frame_features import GROUPS
from charact.validation.parameter_scores import ParameterScores, parameter_scores
from charact.validation.statistic import Statistic, with_departure
from charact.validation.thresholds import TOLERANCES, VALIDATION
from charact.validation.validation_result import DetectableError
from labdata import Array

Groups = Mapping[str, Numbers]

# Sets of numbers by which the power is known to .02.
DRAWN_SETS = 400
# Least relative change of a parameter: none is below 0.
LARGEST_FALL = -0.98
SCORES = "parameters"
SCORES_TITLE = "Relative errors of parameters, each as if only it were wrong"
SCORES_CAUSE = "the named parameter, or one that changes the frames alike"
# Largest relative error that a tolerance may have.
FARTHEST_ERROR = 99.0
SCORES_MATTER = "predictions under other conditions"


@dataclass(frozen=True, kw_only=True)
class ParameterChange:
    """Change of all numbers of a set of frames by that of one parameter, with the same random
    numbers.

    `plain`, `changed`: numbers by group without and with the change; `change`: relative change of
    the parameter; `power`: that of the parameter which the numbers follow, 0 its logarithm;
    `least_error`: least relative error that can be stated.
    """

    title: str
    plain: Groups
    changed: Groups
    change: float
    power: int = 1
    least_error: float = 0.0

    @property
    def amount(self) -> float:
        """Change in the unit in which the numbers are linear."""
        return self.amount_of(self.change)

    @property
    def largest_error(self) -> float:
        """Largest relative error looked for: 1, or 2 of a noise."""
        return max(1.0, self.power)

    def amount_of(self, error: float) -> float:
        """Return the amount ((1 + e)^n - 1) / n of a relative error e, or ln(1 + e): e if small."""
        if self.power:
            return ((1.0 + error) ** self.power - 1.0) / self.power
        return float(np.log1p(error))

    def relative(self, amount: float) -> float:
        """Return the relative error of the parameter of an amount."""
        if self.power:
            return float((1.0 + self.power * amount) ** (1.0 / self.power) - 1.0)
        return float(np.expm1(amount))

    @property
    def size(self) -> Size:
        """What its errors are measured in."""
        # No parameter is below 0: amounts are cut where one would be.
        least = -0.98 / self.power if self.power else -np.inf
        relative = np.vectorize(self.relative, otypes=[float])
        return Size(
            unit="% of the parameter", of=lambda amount: relative(np.maximum(amount, least))
        )

    def shift(self, group: str, labels: Sequence[str]) -> Array:
        """Return the shift of numbers of a group by an amount of 1, shape (number,)."""
        changed, plain = self.changed.get(group, {}), self.plain.get(group, {})
        return (
            np.array([changed.get(k, np.nan) - plain.get(k, np.nan) for k in labels]) / self.amount
        )


class ValidationTest:
    """Ensembles of simulated numbers, with which sets of numbers are compared.

    Parameters
    ----------
    sets
        Numbers of each simulated set by group. A group that one set lacks is not compared.
    seed
        Seed of the repetitions.
    changes
        Changes of parameters, whose errors are estimated and tested as one more statistic,
        `parameters`; none: without.

    Attributes
    ----------
    ensembles
        Labels and ensemble of each group of numbers that is compared.
    """

    def __init__(
        self, sets: Sequence[Groups], *, seed: int, changes: Sequence[ParameterChange] = ()
    ) -> None:
        self.ensembles: dict[str, tuple[tuple[str, ...], Ensemble]] = {}
        for index, (name, group) in enumerate(GROUPS.items()):
            if all(groups.get(name) for groups in sets):
                labels, ensemble = ensemble_of(
                    [groups[name] for groups in sets], group.least_sd, seed + index
                )
                if labels:
                    self.ensembles[name] = labels, ensemble
        self._compared, self._sets = dict(self.ensembles), sets
        self._changes, self._seed = changes, seed
        self._scores = self._scores_of(changes)
        self._count = len(self.ensembles) + (self._scores is not None)

    def statistics(
        self,
        numbers: Groups,
        elsewhere: Mapping[str, Groups] | None = None,
        *,
        level: float = VALIDATION.level,
        sizes: Mapping[str, Mapping[str, Size]] | None = None,
        tolerances: tuple[Tolerance, ...] = TOLERANCES,
    ) -> tuple[Statistic, ...]:
        """Return the statistics of a set of numbers; one that it lacks, or that is not finite,
        fails.

        `elsewhere` are numbers of some groups from other parts of the same frames by place; of such
        a group the most deviating part counts. `level`: of all statistics together; `sizes`: what
        departures are measured in by group and beginning of the label, none: without departures;
        `tolerances`: of them, the last one counts.
        """
        least = level / max(1, self._count)
        fields = list(self._compare(numbers, elsewhere or {}, least))
        if self._scores is not None:
            fields.append(self._score(self._scores, numbers))
        levels = holm_levels([statistic["p_value"] for statistic in fields], level)
        statistics = tuple(
            Statistic(**statistic, level=level)
            for statistic, level in zip(fields, levels, strict=True)
        )
        scales = self._scales(sizes or {}, tolerances)
        return tuple(
            with_departure(
                statistic, scales.get(statistic.name, {}), self._draws_of(statistic.name)
            )
            for statistic in statistics
        )

    def with_further(self, further: Mapping[str, Sequence[Numbers]]) -> Self:
        """Return the same test with further simulated sets of the numbers of some groups.

        Estimates of parameters and their power stay those of the sets of all groups.
        """
        enlarged = copy(self)
        enlarged._compared = dict(self.ensembles)
        for index, (name, group) in enumerate(GROUPS.items()):
            if name in further and name in self.ensembles:
                # A method may refuse the frames of a draw.
                numbers = [*(groups[name] for groups in self._sets), *filter(None, further[name])]
                labels, ensemble = ensemble_of(numbers, group.least_sd, self._seed + index)
                if labels:
                    enlarged._compared[name] = labels, ensemble
        return enlarged

    def unsure(self, statistics: Sequence[Statistic]) -> tuple[str, ...]:
        """Return the names of the groups whose verdict further sets may change."""
        return tuple(
            statistic.name
            for statistic in statistics
            if statistic.name in self._compared
            and not statistic.is_sure(self._draws_of(statistic.name))
        )

    def _draws_of(self, name: str) -> int:
        """Return the number of simulated sets of a statistic."""
        return len(self._compared[name][1].values) if name in self._compared else len(self._sets)

    def detectable(self, change: ParameterChange) -> DetectableError:
        """Return the error of a parameter that is found with `VALIDATION.power`.

        Notes
        -----
        Numbers are taken as linear in a power of the parameter. Sets with the error are drawn from
        the covariance of the simulated ones, with all correlations, and compared with the same
        ensembles: an error is found where one statistic fails at the level that applies if it alone
        does, half of them upwards and half downwards: the error of a noise changes a variance less
        downwards. The statistic that fails most often is named.

        Draws of the camera vary all its parameters: an error below a third of the width of the
        parameter's own posterior shows only if the others are known. `least_error` says so.
        """
        level = VALIDATION.level / max(1, self._count)
        tests = list(self._shifts(change))
        upwards = np.arange(DRAWN_SETS)[:, None] % 2 == 0

        def finds(error: float) -> NDArray[np.bool_]:
            down = change.amount_of(max(-error, LARGEST_FALL))
            # No parameter falls by more than itself.
            amounts = np.where(upwards | (error >= 1.0), change.amount_of(error), down)
            return np.array(
                [
                    test.finds(self._drawn_noise[:, columns], amounts * shift, level)
                    for _, test, columns, shift in tests
                ]
            )

        low, high = 0.0, change.largest_error
        if not tests or finds(high).any(axis=0).mean() < VALIDATION.power:
            return DetectableError(
                title=change.title,
                relative_error=np.nan,
                probability=VALIDATION.power,
                statistic="",
            )
        for _ in range(12):
            middle = (low + high) / 2.0
            enough = finds(middle).any(axis=0).mean() >= VALIDATION.power
            low, high = (low, middle) if enough else (middle, high)
        return DetectableError(
            title=change.title,
            relative_error=max(high, change.least_error),
            probability=VALIDATION.power,
            statistic=tests[int(np.argmax(finds(high).mean(axis=1)))][0],
        )

    def _compare(
        self, numbers: Groups, elsewhere: Mapping[str, Groups], least: float
    ) -> Iterator[dict]:
        """Yield the fields of the statistic of each group."""
        for name, (labels, ensemble) in self._compared.items():
            groups_by_place = {"": numbers.get(name, {})} | {
                at: groups[name] for at, groups in elsewhere.items() if groups.get(name)
            }
            rows = np.array(
                [
                    [numbers_of_part.get(label, np.nan) for label in labels]
                    for numbers_of_part in groups_by_place.values()
                ]
            )
            known = bool(np.isfinite(rows).all())
            distances = [ensemble.distance(row) if known else np.inf for row in rows]
            at = int(np.argmax(distances))
            measured, worst = rows[at], "not measurable"
            if known:
                worst = labels[int(np.argmax(np.abs(ensemble.z_scores(measured))))]
                worst += f", {list(groups_by_place)[at]}" if at else ""
            centre = ensemble.values.mean(axis=0)
            yield {
                "name": name,
                "title": GROUPS[name].title,
                "cause": GROUPS[name].cause,
                "matters": GROUPS[name].matters,
                "worst": worst,
                "part": list(groups_by_place)[at],
                "distance": float(min(distances[at], 1e6)),
                "p_value": ensemble.p_value(rows, least) if known else 0.0,
                "least_p": 1.0 / (VALIDATION.most_replicates(least) + 1),
                "labels": labels,
                "measured": tuple(np.nan_to_num(measured).tolist()),
                "low95": tuple((centre - 1.96 * ensemble.sd).tolist()),
                "high95": tuple((centre + 1.96 * ensemble.sd).tolist()),
            }

    @cached_property
    def _stacked(self) -> tuple[Array, Array]:
        """Numbers of all statistics of the simulated sets, shape (set, number), and their least
        standard deviations.
        """
        values, least_sd = (
            np.concatenate(
                [getattr(ensemble, field) for _, ensemble in self.ensembles.values()], axis=-1
            )
            for field in ("values", "least_sd")
        )
        return values, least_sd

    @cached_property
    def _drawn_noise(self) -> Array:
        """Deviations of all numbers of further draws from the centre, shape (set, number)."""
        values, least_sd = self._stacked
        count, rng = len(values), np.random.default_rng([self._seed, 2])
        spread = (values - values.mean(axis=0)) / np.sqrt(count - 1.0)
        least = np.sqrt(np.maximum(least_sd**2 - (spread**2).sum(axis=0), 0.0))
        drawn = rng.standard_normal((DRAWN_SETS, count)) @ spread
        drawn += rng.standard_normal(drawn.shape) * least
        # The centre of the ensemble has an error of its own.
        return drawn * np.sqrt(1.0 + 1.0 / count)

    def _scores_of(self, changes: Sequence[ParameterChange]) -> ParameterScores | None:
        """Return the estimates of parameters, or None where no change moves a number."""
        shifts = [
            (
                change,
                np.concatenate(
                    [change.shift(name, labels) for name, (labels, _) in self.ensembles.items()]
                ),
            )
            for change in changes
        ]
        shifts = [
            (change, shift) for change, shift in shifts if np.isfinite(shift).all() and shift.any()
        ]
        if not shifts:
            return None
        scores = parameter_scores(
            [change.title for change, _ in shifts],
            np.array([shift for _, shift in shifts]),
            *self._stacked,
        )
        # One whose largest error moves no number by more than chance, as the sensitivity in light
        # of a free level, is not estimated.
        known = scores.sd < [change.amount_of(change.largest_error) for change, _ in shifts]
        return scores.of(known) if known.any() else None

    def _score(self, scores: ParameterScores, numbers: Groups) -> dict:
        """Return the fields of the statistic of the estimated parameters."""
        measured = np.array(
            [
                numbers.get(name, {}).get(label, np.nan)
                for name, (labels, _) in self.ensembles.items()
                for label in labels
            ]
        )
        known = bool(np.isfinite(measured).all())
        estimates = scores.estimates(measured) if known else np.full(len(scores.titles), np.inf)
        pulls = np.abs(estimates) / scores.sd
        return {
            "name": SCORES,
            "title": SCORES_TITLE,
            "cause": SCORES_CAUSE,
            "matters": SCORES_MATTER,
            "worst": scores.titles[int(np.argmax(pulls))] if known else "not measurable",
            "distance": float(min(np.sqrt(np.mean(pulls**2)), 1e6)),
            "p_value": scores.p_value(measured) if known else 0.0,
            "labels": scores.titles,
            "measured": tuple(np.nan_to_num(estimates, posinf=0.0).tolist()),
            "low95": tuple((-1.96 * scores.sd).tolist()),
            "high95": tuple((1.96 * scores.sd).tolist()),
        }

    def _scales(
        self, sizes: Mapping[str, Mapping[str, Size]], tolerances: tuple[Tolerance, ...]
    ) -> dict[str, dict[str, tuple[Size, float]]]:
        """Return size and tolerance of the numbers of each statistic by label.

        That of a parameter, unless it is stated, is the error by which the first number departs by
        its own tolerance.
        """
        scales: dict[str, dict[str, tuple[Size, float]]] = {}
        for name, (labels, _) in self.ensembles.items():
            known = {label: size_of(label, sizes.get(name, {})) for label in labels}
            scales[name] = {
                label: (size, largest)
                for label, size in known.items()
                if size and (largest := tolerance_of(name, size.unit, tolerances))
            }
        if not any(scales.values()):
            return {}
        stated = tolerance_of(SCORES, "% of the parameter", tolerances)
        scales[SCORES] = {
            change.title: (
                change.size,
                stated or 100.0 * change.relative(self._tolerated(change, scales)),
            )
            for change in self._changes
        }
        return scales

    def _tolerated(
        self, change: ParameterChange, scales: Mapping[str, Mapping[str, tuple[Size, float]]]
    ) -> float:
        """Return the amount of a change by which the first number departs by its tolerance."""
        # A parameter that moves no number, such as a dark current of short exposures, may err far.
        amounts = [change.amount_of(FARTHEST_ERROR)]
        for name, (labels, ensemble) in self.ensembles.items():
            shifts, centre = change.shift(name, labels), ensemble.values.mean(axis=0)
            for label, shift, predicted in zip(labels, shifts, centre, strict=True):
                if label in scales[name] and np.isfinite(shift):
                    size, largest = scales[name][label]
                    # Linear: by the shift of a hundredth of the change that was tried.
                    small = 0.01 * change.amount
                    moved = abs(float(size.departure(predicted + small * shift, predicted)))
                    amounts.append(largest * abs(small) / max(moved, 1e-12))
        return min(amounts)

    def _shifts(
        self, parameter_change: ParameterChange
    ) -> Iterator[tuple[str, Ensemble | ParameterScores, slice, Array]]:
        """Yield the name and test of each statistic that a change moves, the columns of its numbers
        among all, and their shift by an amount of 1.
        """
        start, shifts = 0, []
        for name, (labels, ensemble) in self.ensembles.items():
            shift = parameter_change.shift(name, labels)
            if np.isfinite(shift).all() and shift.any():
                yield name, ensemble, slice(start, start + len(labels)), shift
            start += len(labels)
            shifts.append(shift)
        all_shifts = np.concatenate(shifts) if shifts else np.zeros(0)
        if self._scores is not None and np.isfinite(all_shifts).all() and all_shifts.any():
            yield SCORES, self._scores, slice(0, start), all_shifts
