"""Defects that all frames of a session have before its camera is fitted are named by the fit or by
the validation.

The fit may absorb such a defect: what the fitted camera then predicts agrees with the frames, and
only numbers that no parameter moves tell.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from charact.cli.sessions import _findings_in as findings_in
from charact.cli.sessions import _lines as lines_of
from charact.fitting import fit_sensor
from charact.observables import Stacks
from charact.observables.frame_view import FrameView
from charact.observables.photon_transfer import Linearity
from charact.observables.temporal_noise import NoiseOverField
from charact.reporting import sentence_of
from charact.session_measurement import measure
from charact.validation import Statistic, Validation, as_json
from charact.validation import side_by_side as command
from charact.validation.controls import FAULTS, PARAMETERS
from charact.validation.likely_causes import SIGNATURES, likely_causes
from charact.validation.thresholds import VALIDATION
from labdata import BadInput, FrameStack, Result, Session
from labdata.flags import FLAGS
from labdata.session import LoadedStackEntry
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
    assert any(note.startswith("agc: ") and "flat 4" in note for note in findings_in(fitted))
    assert not any(note.startswith("agc: ") and "flat 4" in note for note in expected.notes)
    with pytest.raises(BadInput, match="needs a flat of fixed gain"):
        fit_sensor(
            with_automatic_gain(session, tuple(f"flat {i}" for i in range(5))), Result(), seed=seed
        )
    with pytest.raises(BadInput, match="automatic controls must be off"):
        command.validate(with_automatic_gain(session, ("flat 4",)), expected, seed=seed)


def test_a_bend_moves_signal_and_variance_of_a_dim_flat_over_a_bright_one_by_its_closed_form(
    seed: int,
) -> None:
    """The slope of s (1 - a s) is 1 - 2 a s: the variance of photons follows its square."""
    rng, bend = np.random.default_rng(seed), 1e-4
    photons = [rng.poisson(mean, (8, 96, 128)).astype(float) for mean in (200.0, 1000.0)]
    dark = FrameView("dark", 10.0 + rng.standard_normal((8, 96, 128)))
    flats = tuple(
        FrameView(name, 10.0 + s * (1.0 - bend * s))
        for name, s in zip(("low", "high"), photons, strict=True)
    )
    found = Linearity().numbers(Stacks(darks=(dark,), flats=flats))
    # Of s^2 its mean is s^2 + s.
    low, high = (s - bend * (s**2 + s) for s in (200.0, 1000.0))
    assert found["signal of low over high"] == pytest.approx(low / high, rel=2e-3)
    noise_low, noise_high = (
        s * (1.0 - 2.0 * bend * s) ** 2 / signal for s, signal in ((200.0, low), (1000.0, high))
    )
    # Variances of 86,016 values above their mean have a relative standard error of 0.5 %, the
    # dark's is 0.5 % of them.
    assert found["variance/signal of low over high"] == pytest.approx(
        noise_low / noise_high, rel=4.5 * 0.008
    )


def test_columns_averaged_near_the_corners_are_correlated_there_by_half(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dark, flat = (
        10.0 + rng.standard_normal((8, 128, 160)),
        100.0 + 8.0 * rng.standard_normal((8, 128, 160)),
    )
    y, x = (np.linspace(-1.0, 1.0, size) for size in flat.shape[1:])
    outside = y[:, None] ** 2 + x[None, :] ** 2 > 1.0
    mixed = np.where(outside, (flat + np.roll(flat, 1, axis=2)) / 2.0, flat)
    plain, found = (
        NoiseOverField().numbers(
            Stacks(darks=(FrameView("dark", dark),), flats=(FrameView("flat", one),))
        )
        for one in (flat, mixed)
    )
    of = "px near the corners less the centre of flat"
    # A seventh of the picture is near its corners, and its correlation is that of 20,000 pairs.
    error = 4.5 / np.sqrt(0.1 * flat.size)
    assert found[f"correlation at 0,1 {of}"] == pytest.approx(0.5, abs=2.0 * error)
    assert found[f"correlation at 1,0 {of}"] == pytest.approx(0.0, abs=2.0 * error)
    name = "ln variance/signal near the corners over the centre of flat"
    assert found[name] == pytest.approx(-np.log(2.0), abs=2.0 * np.sqrt(2.0) * error)
    assert all(abs(value) < 2.0 * np.sqrt(2.0) * error for value in plain.values())


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


def test_causes_are_named_by_the_way_that_their_numbers_go_and_only_where_a_statistic_fails() -> (
    None
):
    sharpened = statistic_of("autocorrelation", "correlation at 0,1 px of flat", -6.0)
    blurred = statistic_of("autocorrelation", "correlation at 0,1 px of flat", 6.0)
    averaged = statistic_of("time", "correlation of dark frames of dark, 1 apart", 6.0)
    assert [one.flag for one in likely_causes([sharpened])] == ["processed"]
    assert likely_causes([blurred]) == ()
    assert likely_causes([replace(sharpened, p_value=0.5)]) == ()
    # Frames averaged are named before what they do to the noise.
    both = likely_causes(
        [sharpened, averaged, statistic_of("linearity", "signal of low over high", 5.0)]
    )
    assert [one.flag for one in both] == ["processed", "processed", "nonlinear"]
    assert "averaged" in both[0].effect
    # Less anticorrelated than predicted is no average.
    less = replace(averaged, measured=(-0.1,), low95=(-0.15,), high95=(-0.14,))
    assert likely_causes([less]) == ()
    assert "is 6, not -1.96 to 1.96" in both[0].effect
    assert {one.flag for one in SIGNATURES} <= set(FLAGS)


def test_likely_causes_are_part_of_the_document_of_the_page_and_of_the_printed_lines() -> None:
    validation = Validation(
        session="s",
        sensor="c",
        seed=0,
        draws=20,
        seconds=0.0,
        controls=(),
        statistics=(statistic_of("linearity", "signal of low over high", 5.0),),
    )
    assert [one["flag"] for one in as_json(validation)["likely_causes"]] == ["nonlinear"]
    cause = validation.likely_causes[0].note
    assert sentence_of(validation).startswith(f"Likely cause: {cause}. It differs most in ")
    assert f"likely cause: {cause}" in list(lines_of(validation))
