"""All statistics of a validation: each group of numbers against its simulated ensemble, at one family-wise level."""

from collections.abc import Mapping, Sequence

import numpy as np

from charact.validation.ensemble import ensemble_of, holm_levels
from charact.validation.frame_features import GROUPS, Numbers
from charact.validation.thresholds import VALIDATION
from charact.validation.validation_result import DetectableError, Statistic


class ValidationTest:
    """Ensembles of simulated numbers, against which sets of numbers are held.

    Parameters
    ----------
    sets
        Numbers of each simulated set by group. A group that one set lacks is not compared.
    seed
        Seed of the repetitions.
    """

    def __init__(self, sets: Sequence[Mapping[str, Numbers]], *, seed: int) -> None:
        self._ensembles = {}
        for index, (name, group) in enumerate(GROUPS.items()):
            if all(one.get(name) for one in sets):
                labels, ensemble = ensemble_of([one[name] for one in sets], group.least_sd, seed + index)
                if labels:
                    self._ensembles[name] = labels, ensemble

    def statistics(self, numbers: Mapping[str, Numbers]) -> tuple[Statistic, ...]:
        """Return the statistics of a set of numbers; one that it lacks, or that is not finite, fails."""
        found = []
        least = 1.0 / (VALIDATION.replicates + 1)
        for name, (labels, ensemble) in self._ensembles.items():
            own = numbers.get(name, {})
            measured = np.array([own.get(label, np.nan) for label in labels])
            known = bool(np.isfinite(measured).all())
            distance = ensemble.distance(measured) if known else np.inf
            worst = labels[int(np.argmax(np.abs(ensemble.z_scores(measured))))] if known else "not measurable"
            p_value = ensemble.p_value(measured) if known else least
            found.append((name, labels, ensemble, measured, distance, p_value, worst))
        levels = holm_levels([one[5] for one in found], VALIDATION.level)
        return tuple(
            Statistic(
                name=name, title=GROUPS[name].title, distance=float(min(distance, 1e6)), p_value=p_value, level=level,
                least_p=least, labels=labels, measured=tuple(np.nan_to_num(measured).tolist()),
                low95=tuple((ensemble.values.mean(axis=0) - 1.96 * ensemble.sd).tolist()),
                high95=tuple((ensemble.values.mean(axis=0) + 1.96 * ensemble.sd).tolist()),
                worst=worst, cause=GROUPS[name].cause,
            )
            for (name, labels, ensemble, measured, distance, p_value, worst), level in zip(found, levels, strict=True)
        )  # fmt: skip

    def detectable(
        self, title: str, plain: Mapping[str, Numbers], changed: Mapping[str, Numbers], change: float
    ) -> DetectableError:
        """Return the error of a parameter that is found with `VALIDATION.power`.

        Parameters
        ----------
        title
            Name of the parameter.
        plain, changed
            Numbers of one draw with the same random numbers, without and with a relative change of the parameter.

        Notes
        -----
        Numbers are taken as linear in the parameter. The statistic that finds the least error counts, at the level that
        holds where it alone fails.
        """
        level = VALIDATION.level / max(1, len(self._ensembles))
        best, finder = np.inf, ""
        for name, (labels, ensemble) in self._ensembles.items():
            shift = np.array([changed[name].get(k, np.nan) - plain[name].get(k, np.nan) for k in labels]) / change
            if not np.isfinite(shift).all() or not shift.any():
                continue
            low, high = 0.0, min(best, 1.0)
            if ensemble.detects(shift * high, level) < VALIDATION.power:
                continue
            for _ in range(10):
                middle = (low + high) / 2.0
                enough = ensemble.detects(shift * middle, level) >= VALIDATION.power
                low, high = (low, middle) if enough else (middle, high)
            best, finder = high, name
        return DetectableError(
            title=title, relative_error=float(best) if finder else float("nan"), probability=VALIDATION.power,
            statistic=finder,
        )  # fmt: skip
