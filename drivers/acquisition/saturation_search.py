"""The search for the light that saturates: level after level, each a stack of its own, the same again when resumed."""

from drivers.acquisition.run import Run
from drivers.acquisition.run_control import RunControl
from labdata.adaptive import SaturationSearch
from labdata.plan import Step


def search(run: Run, step: Step, wanted: SaturationSearch, requests: RunControl) -> None:
    """Take the levels of a search; those that an earlier run finished are read instead.

    Parameters
    ----------
    run
        The run.
    step
        The step; its light is the first level.
    wanted
        How far and how finely to search.
    requests
        Asked between levels.
    """
    seen: list[tuple[float, bool]] = []
    taken = False
    begin_lux = step.conditions.illuminance_lux or 0.0
    while (lux := wanted.next_lux(begin_lux, seen)) is not None:
        level = step.level(lux, f"{step.label}-{len(seen) + 1}")
        if level.label in run.finished:
            seen.append((lux, run.read_saturated(level)))
            continue
        run.between_steps(requests)
        seen.append((lux, run.take(level)))
        taken = True
    if taken:
        run.remark(f"search {step.label!r}: {wanted.verdict(seen)}")
