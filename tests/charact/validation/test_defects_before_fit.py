"""Defects that all frames of a session have before its camera is fitted are named by the fit or by
the validation.

The fit may absorb such a defect: what the fitted camera then predicts agrees with the frames, and
only numbers that no parameter moves tell.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from charact.fitting import fit_sensor
from charact.reporting.validation import sentence_of
from charact.session_measurement import measure
from charact.validation import FAULTS, PARAMETERS, VALIDATION, Statistic, Validation, as_json
from charact.validation import side_by_side as command
from charact.validation.likely_causes import LikelyCause
from labdata import FLAGS, BadInput, FrameStack, LoadedStackEntry, Result, Session
from tests.charact.cli.runner import charact
from tests.charact.validation import defects
from tests.charact.validation.defects import Digitiser, Frames
from tests.truth.specimens import draw_specimen, session_of

Put = Callable[[Frames, Digitiser, np.random.Generator], Frames]
LIT = ("flat", "edge", "point")


@dataclass(frozen=True, kw_only=True)
class DefectBeforeFit:
    """A defect of all stacks of some kinds, and the flags of which one names its cause."""

    put: Put
    flags: tuple[str, ...]
    kinds: tuple[str, ...] = ("dark", *LIT)


BEFORE_FIT = {
    "bend of 10 %": DefectBeforeFit(put=defects.bend, flags=("nonlinear", "gamma")),
    "mean of two frames": DefectBeforeFit(put=defects.average_pairs, flags=("processed",)),
    "blur off axis": DefectBeforeFit(put=defects.blur_off_axis, flags=("correlated-noise",)),
    "lens blur off axis": DefectBeforeFit(
        put=defects.blur_lens_off_axis, flags=("model-misfit",), kinds=("edge",)
    ),
    "sharpening": DefectBeforeFit(put=defects.sharpen, flags=("processed",)),
    "8 bits": DefectBeforeFit(put=defects.keep_eight_bits, flags=("quantised",)),
    "gamma of 0.8": DefectBeforeFit(put=defects.gamma_of_codes, flags=("nonlinear", "gamma")),
}
NAMES = ("machine-vision", "pulnix-ag5745ef3")
# A tube costs three times the processor time: it has those that any grabber may put into frames.
CASES = [
    *(("machine-vision", defect) for defect in BEFORE_FIT),
    *(
        ("pulnix-ag5745ef3", x)
        for x in ("bend of 10 %", "mean of two frames", "blur off axis", "sharpening")
    ),
]


@cache
def specimen_session(name: str, seed: int) -> tuple[Session, float]:
    """Return the session of a specimen, which no test changes, and the specimen's black level,
    DN.
    """
    return session_of(name, seed)[0], float(draw_specimen(name, seed)[0].video.black_level_dn)


def put_into(
    session: Session, black_dn: float, put: Put, kinds: tuple[str, ...], seed: int
) -> Session:
    """Return a session whose stacks of some kinds have a defect, in whole DN within the digitiser's
    range.
    """
    assert session.bit_depth is not None
    top, stacks = 2.0**session.bit_depth - 1.0, []
    for index, entry in enumerate(session.stacks):
        assert isinstance(entry, LoadedStackEntry)
        if entry.kind not in kinds:
            stacks.append(entry)
            continue
        before = entry.kept.data
        adc = Digitiser(black=black_dn, top=top, noise=float(before.std(axis=0).mean()))
        changed = put(before.astype(float), adc, np.random.default_rng([seed, index]))
        whole = np.clip(np.rint(changed), 0.0, top).astype(before.dtype)
        stacks.append(replace(entry, kept=replace(entry.kept, data=whole)))
    return replace(session, stacks=tuple(stacks))


@pytest.fixture(autouse=True)
def few_controls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "VALIDATION", replace(VALIDATION, draws=10))
    monkeypatch.setattr(command, "PARAMETERS", PARAMETERS[-1:])
    monkeypatch.setattr(command, "FAULTS", {"a repeated frame": FAULTS["a repeated frame"]})


def examine(session: Session, seed: int) -> tuple[set[str], Validation]:
    """Return the flags of the findings of the fit, and the validation of the fitted camera."""
    assert session.camera is not None
    fitted = fit_sensor(session, measure(session, quick=True), seed=seed)
    new = fitted.notes[len(session.camera.notes) :]
    for note in new:
        print(note)
    validation = command.validate(session, fitted, seed=seed)
    for one in validation.likely_causes:
        print(f"likely cause: {one.note}")
    print("failing:", [one.name for one in validation.statistics if not one.passed])
    return {note.partition(":")[0] for note in new} & set(FLAGS), validation


@pytest.mark.parametrize(("name", "defect"), CASES)
def test_a_defect_before_the_fit_is_named(name: str, defect: str, seed: int) -> None:
    session, black_dn = specimen_session(name, seed)
    one = BEFORE_FIT[defect]
    try:
        found, validation = examine(put_into(session, black_dn, one.put, one.kinds, seed), seed)
    except BadInput as refusal:
        # A specimen of less noise than a step of 8 bits has darks that repeat each other.
        assert defect == "8 bits" and "needs noise" in str(refusal) and "fewer bits" in str(refusal)
        return
    causes = {cause.flag for cause in validation.likely_causes}
    assert set(one.flags) & (found | causes)
    # A misfit of the fit names no cause of its own.
    assert found - {"model-misfit"} or not all(
        statistic.passed for statistic in validation.statistics
    )


@pytest.mark.parametrize("name", NAMES)
def test_a_session_without_defects_passes_and_has_no_finding(name: str, seed: int) -> None:
    found, validation = examine(specimen_session(name, seed)[0], seed)
    assert found == set()
    # Chance alone refuses a right camera once in 100 runs: seeds that nobody chose are held to less
    # than that.
    failing = [one for one in validation.statistics if not one.passed]
    assert len(failing) <= 1
    assert len(validation.likely_causes) <= len(failing)


def test_a_step_of_gain_in_the_middle_of_the_flats_is_drift_of_the_fit_and_of_the_validation(
    seed: int,
) -> None:
    session, black_dn = specimen_session("machine-vision", seed)
    short = replace(
        session,
        stacks=tuple(
            replace(entry, kept=FrameStack(data=entry.kept.data[: VALIDATION.frames]))
            for entry in session.stacks
            if isinstance(entry, LoadedStackEntry)
        ),
    )
    found, validation = examine(put_into(short, black_dn, defects.step_gain, ("flat",), seed), seed)
    failing = {one.name for one in validation.statistics if not one.passed}
    assert "drift" in found
    assert failing & {"time", "rows-and-columns"}
    assert validation.likely_causes[0].flag == "drift"


def with_automatic_gain(session: Session, labels: tuple[str, ...]) -> Session:
    """Return a session that says that automatic gain was on in some stacks."""
    return replace(
        session,
        stacks=tuple(
            replace(entry, conditions=replace(entry.conditions, automatic_gain=True))
            if entry.label in labels
            else entry
            for entry in session.stacks
        ),
    )


def test_stacks_of_automatic_gain_take_no_part_in_a_fit_and_are_named(seed: int) -> None:
    session, _ = specimen_session("machine-vision", seed)
    changed = with_automatic_gain(session, ("flat 4",))
    fitted = fit_sensor(changed, measure(changed, quick=True), seed=seed)
    alone = replace(
        session, stacks=tuple(entry for entry in session.stacks if entry.label != "flat 4")
    )
    expected = fit_sensor(alone, measure(changed, quick=True), seed=seed)
    assert fitted.draws == expected.draws
    assert any(note.startswith("agc: ") and "flat 4" in note for note in fitted.notes)
    assert not any(note.startswith("agc: ") and "flat 4" in note for note in expected.notes)
    with pytest.raises(BadInput, match="needs a flat of fixed gain"):
        fit_sensor(
            with_automatic_gain(session, tuple(f"flat {i}" for i in range(5))), Result(), seed=seed
        )
    with pytest.raises(BadInput, match="automatic controls must be off"):
        command.validate(with_automatic_gain(session, ("flat 4",)), expected, seed=seed)


def statistic_of(name: str, label: str, measured: float, *, p_value: float = 1e-4) -> Statistic:
    """Return a statistic of one number that is predicted as 0 with a standard deviation of 1."""
    return Statistic(
        name=name,
        title=name,
        distance=1.0,
        p_value=p_value,
        level=1e-3,
        labels=(label,),
        measured=(measured,),
        low95=(-1.96,),
        high95=(1.96,),
        worst=label,
    )


def validation_of(*statistics: Statistic) -> Validation:
    return Validation(
        session="s", sensor="c", seed=0, draws=20, seconds=0.0, controls=(), statistics=statistics
    )


def test_likely_causes_are_part_of_the_document_of_the_page_and_of_the_printed_lines(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bend = LikelyCause(
        name="bend of the response",
        stacks="all lit stacks",
        stage="a nonlinear amplifier",
        remedy="a gamma of 1",
        flag="nonlinear",
        size=2.04,
        unit="%",
        explained=0.913,
        probability=0.99,
    )
    validation = replace(
        validation_of(statistic_of("linearity", "signal of low over high", 5.0)), causes=(bend,)
    )
    assert "bend of the response of 2 % in all lit stacks explains 91 %" in bend.finding.effect
    assert as_json(validation)["causes"][0]["size"] == 2.04
    assert [one["flag"] for one in as_json(validation)["likely_causes"]] == ["nonlinear"]
    cause = validation.likely_causes[0].note
    assert sentence_of(validation).startswith(f"Likely cause: {cause}. It differs most in ")
    monkeypatch.setattr("charact.cli.sessions.validate_and_save", lambda *_, **__: validation)
    assert f"likely cause: {cause}" in charact("validate", tmp_path).stdout.splitlines()
