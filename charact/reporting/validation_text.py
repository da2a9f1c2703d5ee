"""Sentences of a validation, made of its values: what agrees, what differs by how much, and what
could not have been seen.
"""

from collections.abc import Iterator

from charact.validation import Statistic, Validation
from charact.validation.statistic import Agreement
from labdata.number_format import plus_minus_of, short_text

# Parameters that the sentence of power names at each end.
NAMED = 3


def size_text(statistic: Statistic) -> str:
    """Return the departure of a statistic with its 95 % interval and unit; empty without a size."""
    if statistic.departure is None or statistic.departure95 is None:
        return ""
    return (
        f"{plus_minus_of(statistic.departure, *statistic.departure95)} {statistic.departure_unit}"
    )


def tolerance_text(statistic: Statistic) -> str:
    """Return the tolerance of a statistic with its unit; empty without a size."""
    if statistic.tolerance is None:
        return ""
    return f"{short_text(float(f'{statistic.tolerance:.3g}'))} {statistic.departure_unit}"


def agreement_text(statistic: Statistic) -> str:
    """Return the verdict on a statistic, its size and its tolerance."""
    size, tolerance = size_text(statistic), tolerance_text(statistic).partition(" ")[0]
    if not size:
        words = "CANNOT BE MEASURED" if statistic.p_value == 0.0 else "DIFFERS"
        return words if statistic.verdict == "differs" else "agrees"
    sentences: dict[Agreement, str] = {
        "agrees": f"agrees, {size} (tolerance {tolerance})",
        "within": f"differs by {size}, within its tolerance of {tolerance}",
        "differs": f"DIFFERS by {size}, beyond its tolerance of {tolerance}",
        "unseen": f"COULD NOT HAVE SEEN its tolerance of {tolerance}: {size}",
    }
    return sentences[statistic.verdict]


def difference_sentence(statistic: Statistic) -> str:
    """Return by how much of what a statistic differs, for what it matters and what may cause it."""
    size = size_text(statistic)
    by = f"by {size} in" if size else "most in"
    tolerance = tolerance_text(statistic).partition(" ")[0]
    beyond = f", tolerance {tolerance}" if tolerance else ""
    matters = f" matters for {statistic.matters} and" if statistic.matters else ""
    return (
        f"It differs {by} {statistic.worst} ({statistic.name}{beyond}), which{matters} may come "
        f"from {statistic.cause}"
    )


def doubts_of(validation: Validation) -> tuple[str, ...]:
    """Return why a validation says less than its statistics: first the fit, then its controls."""
    fit = (
        "the posterior of the fit did not converge (not-converged): its draws are not those of the "
        "camera"
    )
    nulls = (
        f"a null control did not hold in {', '.join(control.noticed_by)}: {control.title}"
        for control in validation.failed_nulls
    )
    unnoticed = "no negative control was noticed"
    return (
        *((fit,) * (not validation.converged)),
        *nulls,
        *((unnoticed,) * (not validation.noticed)),
    )


def unseen_sentences(validation: Validation) -> tuple[str, ...]:
    """Return what could not have been seen, a sentence a statistic."""
    return tuple(
        f"{statistic.name} could not have seen {tolerance_text(statistic)} in {statistic.worst}: "
        f"{size_text(statistic)}; more frames, or a fit to more stacks, settle it"
        for statistic in validation.of("unseen")
    )


def headline_of(validation: Validation) -> str:
    """Return the verdict, the number of statistics that agree and the state of the controls."""
    differing, unseen = validation.of("differs"), validation.of("unseen")
    negatives = [control for control in validation.controls if control.name == "negative"]
    verdict = {"agrees": "agrees", "differs": "does not agree", "undecided": "is undecided"}
    count = len(validation.statistics)
    return (
        f"Simulation {verdict[validation.verdict]}: {count - len(differing) - len(unseen)} of "
        f"{count} statistics agree within their tolerances; null controls "
        f"{'do not hold' if validation.failed_nulls else 'hold'}; "
        f"{sum(control.passed for control in negatives)} of {len(negatives)} negative controls "
        "noticed"
    )


def sentence_of(validation: Validation) -> str:
    """Return a doubt in the fit, what differs, further doubts, and what an agreement excludes."""
    differing, doubts = validation.of("differs"), doubts_of(validation)
    of_fit = 0 if validation.converged else 1
    within = "; ".join(
        f"{statistic.name} by {size_text(statistic)} in {statistic.worst}"
        for statistic in validation.of("within")
    )
    sentences = (
        *doubts[:of_fit],
        *([_deviation_sentence(validation)] if differing else []),
        *doubts[of_fit:],
        f"within their tolerances differ {within}" if within else "",
        *unseen_sentences(validation),
        *([] if differing else [_power_sentence(validation)]),
    )
    return ". ".join(sentence[0].upper() + sentence[1:] for sentence in sentences if sentence)


def _deviation_sentence(validation: Validation) -> str:
    """Return the likely causes and what differs most over its tolerance."""
    likely = "".join(f"Likely cause: {result.note}. " for result in validation.likely_causes)
    likely = likely or "No named cause explains it. "
    first, *further = validation.of("differs")
    names = ", ".join(statistic.name for statistic in further)
    verb = "differs" if len(further) == 1 else "differ"
    more = f"; beyond its tolerance {verb} also {names}" if further else ""
    return f"{likely}{difference_sentence(first)}{more}"


def _power_sentence(validation: Validation) -> str:
    """Return the least errors that would have been found, and the largest that could have been
    missed.
    """
    detectable = sorted(
        (error for error in validation.power if error.statistic),
        key=lambda error: error.relative_error,
    )
    never = [error.title for error in validation.power if not error.statistic]
    if not validation.power:
        return "How large an error it would have found is not known"
    texts = [f"{error.percent} of {error.title}" for error in detectable]
    detected_text = "; ".join(texts[:NAMED])
    missed = "; ".join(
        [
            *(f"up to {text}" for text in texts[NAMED:][-NAMED:]),
            *(f"any of {title}" for title in never),
        ]
    )
    probability = f"{100.0 * validation.power[0].probability:g} %"
    sentences = (
        f"In {probability} of cases it would have found an error of {detected_text}"
        if detected_text
        else "",
        f"It could have missed one of {missed}" if missed else "",
    )
    return ". ".join(sentence for sentence in sentences if sentence)


def lines_of(validation: Validation) -> Iterator[str]:
    """Yield doubts in the fit, one line per statistic, what the controls noticed and did not,
    detectable errors, and the verdict.
    """
    yield from (f"note: {doubt}" for doubt in doubts_of(validation))
    for statistic in validation.statistics:
        yield f"{statistic.name}: {agreement_text(statistic)}, p {statistic.p_text}"
        if statistic.verdict != "agrees":
            yield f"    in {statistic.worst}"
        if statistic.verdict == "differs":
            yield f"    matters for {statistic.matters}; may come from {statistic.cause}"
    unseen_numbers = [
        f"{statistic.name} {len(statistic.unseen)} of {len(statistic.labels)}"
        for statistic in validation.statistics
        if statistic.unseen
    ]
    if unseen_numbers:
        yield f"numbers that could not have seen their tolerance: {', '.join(unseen_numbers)}"
    for control in validation.controls:
        if control.name == "null":
            failing = "" if control.passed else f": {', '.join(control.noticed_by)}"
            yield (
                f"null control, {control.title}: {'passes' if control.passed else 'FAILS'}{failing}"
            )
    negative = [control for control in validation.controls if control.name == "negative"]
    unseen = [control.title for control in negative if not control.passed]
    yield f"negative controls: {len(negative) - len(unseen)} of {len(negative)} noticed" + (
        f"; not noticed: {', '.join(unseen)}" if unseen else ""
    )
    detectable = [f"{error.title} {error.percent}" for error in validation.power if error.statistic]
    if detectable:
        probability = f"{100.0 * validation.power[0].probability:g} %"
        errors = ", ".join(detectable)
        yield f"smallest errors that are detected in {probability} of cases: {errors}"
    yield from (f"likely cause: {cause.note}" for cause in validation.likely_causes)
    yield from (f"note: {note}" for note in (validation.origin, *validation.notes))
    yield headline_of(validation)
