"""A session is fit for a purpose only with the frames that it needs; what lacks is named."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.special import erf

import charact
from charact.api.settings import purpose_for
from charact.verdict.purpose import PURPOSES, TURNED_EDGE, purpose_of
from labdata import Result, make_refusal, measurement_from_sd
from labdata.quantity import QUANTITIES
from tests.charact.cli.runner import assert_one_sentence, done_well, json_of
from tests.charact.cli.runner import charact as charact_command
from tests.truth import session_in_memory

ROWS, COLS = 72, 96
FLATS, DARKS, EDGE = "flats of one gain setting at 3 levels or more", "darks of", "a slanted edge"


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A plain camera of its own make: gain K, read noise, black level, unequal pixels and offsets
    of .4 electrons.
    """

    rng: np.random.Generator
    gain_dn_per_e: float
    black_dn: float = 50.0

    def stack(self, kind: str, electrons: object, frames: int = 6, **conditions: float):
        """Return a stack of frames of a mean image, electrons."""
        response = np.random.default_rng(1).normal(1.0, 0.01, (ROWS, COLS))
        offset = np.random.default_rng(2).normal(0.0, 0.4, (ROWS, COLS))
        mean = np.broadcast_to(np.asarray(electrons) * response, (frames, ROWS, COLS))
        charge = self.rng.poisson(mean) + self.rng.normal(offset, 3.0, mean.shape)
        pixels = np.clip(np.round(self.gain_dn_per_e * charge + self.black_dn), 0, 4095)
        return charact.stack(pixels.astype(np.uint16), kind, exposure_s=0.01, **conditions)

    def flats(self, *levels: float, **conditions: float):
        """Return flats at levels, electrons."""
        return [self.stack("flat", level, **conditions) for level in levels]

    def edge(self, sigma_px: float = 0.9, *, turned: bool = False, frames: int = 6):
        """Return a slanted edge, `turned` along the rows."""
        row, col = np.mgrid[:ROWS, :COLS]
        across, along = (row, col) if turned else (col, row)
        distance = across - across.max() / 2 + 0.1 * (along - along.max() / 2)
        return self.stack("edge", 800 + 700 * erf(distance / (sigma_px * 2**0.5)), frames)


@dataclass(frozen=True, kw_only=True)
class HalfFilled:
    """A session that is not enough for a purpose."""

    stacks: list
    words: tuple[str, ...]  #: Words of the frames that the answer names
    added: list  #: Those frames
    purpose: str | None = None


def half_filled(bench: Bench) -> dict[str, HalfFilled]:
    """Return sessions that lack frames."""
    darks, levels, edge = [bench.stack("dark", 0, 12)], (300, 1200, 4000), [bench.edge()]
    flats, turned = bench.flats(*levels), [bench.edge(turned=True)]
    others = Bench(rng=bench.rng, gain_dn_per_e=bench.gain_dn_per_e, black_dn=400.0)
    full_e = 4045.0 / bench.gain_dn_per_e
    pairs = [bench.stack("dark", 0, 2, photons_per_px=0.0)]
    pairs += [
        bench.stack("flat", level, 2, photons_per_px=level / 0.6)
        for level in np.linspace(0.02, 1.1, 50) * full_e
    ]
    many = bench.stack("flat", 0.5 * full_e, 24, photons_per_px=0.5 * full_e / 0.6)
    volts = [bench.flats(900.0, mcp_v=v)[0] for v in (700.0, 750.0, 800.0)]
    single = [bench.stack(kind, level, 1) for kind, level in (("dark", 0), ("flat", 900))]
    single += [bench.stack("flat", level, 1) for level in levels]
    return {
        "darks alone": HalfFilled(stacks=darks, words=(FLATS, EDGE), added=flats + edge),
        "flats alone": HalfFilled(stacks=flats, words=(DARKS, EDGE), added=darks + edge),
        "one level": HalfFilled(stacks=darks + flats[:1] + edge, words=(FLATS,), added=flats[1:]),
        "three voltages": HalfFilled(
            stacks=darks + volts + edge,
            words=(FLATS,),
            added=bench.flats(300.0, 4000.0, mcp_v=750.0),
        ),
        "no target": HalfFilled(stacks=darks + flats, words=(EDGE,), added=edge),
        "saturated": HalfFilled(
            stacks=darks + bench.flats(9e4, 9e4, 9e4) + edge, words=(FLATS,), added=flats
        ),
        "out of focus": HalfFilled(
            stacks=[*darks, *flats, bench.edge(9.0)], words=(EDGE + " in focus",), added=edge
        ),
        "darks of another camera": HalfFilled(
            stacks=[others.stack("dark", 0), *flats, *edge], words=("dark",), added=darks
        ),
        "two frames a level": HalfFilled(
            stacks=pairs,
            words=("darks of 16 frames or more",),
            added=[bench.stack("dark", 0, 40), many],
        ),
        "one exposure": HalfFilled(stacks=single, words=(FLATS, EDGE), added=darks + flats + edge),
        "an edge alone": HalfFilled(stacks=edge, words=("turned by 90",), added=turned),
        "an edge for a detector": HalfFilled(
            stacks=edge, words=(FLATS, DARKS), added=darks + flats, purpose="detector"
        ),
    }


NAMES = tuple(half_filled(Bench(rng=np.random.default_rng(0), gain_dn_per_e=0.5)))


def answer(stacks: list, purpose: str | None = None, seed: int = 0):
    session = charact.session(stacks, bit_depth=12)
    return charact.measure(session, purpose=purpose, quick=True, seed=seed).verdict


@pytest.mark.parametrize("name", NAMES)
def test_a_half_filled_session_is_never_fit_and_is_so_with_the_frames_that_it_names(name, seed):
    rng = np.random.default_rng(seed)
    half = half_filled(Bench(rng=rng, gain_dn_per_e=rng.uniform(0.3, 0.8)))[name]
    lacking = answer(half.stacks, half.purpose)
    assert lacking.answer == "not enough" and lacking.status != "ok", lacking
    named = " ".join(frames for lack in lacking.missing for frames in lack.frames)
    assert all(words in named for words in half.words), named
    filled = answer(half.stacks + half.added, half.purpose)
    assert filled.answer == "fit" and filled.line.startswith("✓ Fit for"), filled


@pytest.mark.parametrize("name", ["no target", "out of focus", "an edge for a detector"])
def test_the_answer_does_not_change_with_the_seed_of_the_analysis(name, seed):
    half = half_filled(Bench(rng=np.random.default_rng(seed), gain_dn_per_e=0.5))[name]
    for stacks in (half.stacks, half.stacks + half.added):
        answers = [answer(stacks, half.purpose, number) for number in range(5)]
        assert len({given.answer for given in answers}) == 1, answers
        assert len({tuple(m.frames for m in given.missing) for given in answers}) == 1, answers


def test_measure_ends_with_the_answer_and_json_has_it(tmp_path, seed):
    bench = Bench(rng=np.random.default_rng(seed), gain_dn_per_e=0.5)
    np.save(tmp_path / "edge.npy", bench.edge().read().data)
    done_well("import", "frames", tmp_path / "edge.npy", tmp_path / "mine", "--kind", "edge")
    *_, guess, last = done_well("measure", tmp_path / "mine", "--quick").stdout.splitlines()
    assert guess == "Purpose by the frames: focus (--for states another)"
    assert last.endswith(f"add {TURNED_EDGE}")
    told = done_well("measure", tmp_path / "mine", "--quick", "--for", "detector").stdout
    assert "Purpose by" not in told and "Not enough for a detector: add flats" in told
    verdict = json_of("measure", tmp_path / "mine", "--quick", "--for", "detector")["verdict"]
    assert (verdict["purpose"], verdict["answer"]) == ("detector", "not enough")
    assert all(lack["frames"] and lack["why"] for lack in verdict["missing"])
    assert_one_sentence(charact_command("measure", tmp_path / "mine", "--for", "tub"), "'tube'?")


# The purpose is that of the frames; the rules alone, without frames that are measured.


def blank(kind: str, **conditions: float):
    return charact.stack(np.zeros((2, 9, 9)), kind, **conditions)


@pytest.mark.parametrize(
    ("kinds", "sensor", "name"),
    [
        (("edge",), None, "focus"),
        (("dark", "bars"), None, "focus"),
        (("dark", "point", "point"), None, "halo"),
        (("dark",), None, "detector"),
        (("dark", "flat", "edge"), None, "detector"),
        (("dark", "flat", "edge"), "machine-vision", "detector"),
        (("dark", "flat"), "gen3-digital-iccd", "tube"),
        (("flat", "edge"), "vox-lwir-640", "infrared"),
    ],
)
def test_the_purpose_of_a_session_is_that_of_its_frames(kinds, sensor, name):
    session = charact.session([blank(kind) for kind in kinds], sensor=sensor)
    assert purpose_of(session, Result()) is PURPOSES[name]


def test_flats_of_known_photons_without_a_target_are_a_data_sheet():
    flats = [blank("flat", photons_per_px=level) for level in (10.0, 20.0, 30.0)]
    for stacks, name in ((flats, "emva1288"), ([*flats, blank("edge")], "detector")):
        assert purpose_of(charact.session(stacks), Result()).name == name


def test_flats_of_a_black_body_are_those_of_an_infrared_camera():
    stacks = [*(blank("flat", blackbody_c=celsius) for celsius in (20.0, 30.0)), blank("edge")]
    assert purpose_of(charact.session(stacks), Result()).name == "infrared"


@pytest.mark.parametrize("name", PURPOSES)
def test_where_nothing_is_measured_nothing_is_green_and_all_frames_are_named(name):
    purpose = PURPOSES[name]
    assert all(need.quantity in QUANTITIES for need in purpose.needs)
    assert all(quantity in QUANTITIES for quantity in purpose.also)
    given = purpose.decide(session_in_memory(()), Result())
    assert (given.answer, given.status) == ("not enough", "refused")
    assert {lack.frames for lack in given.missing} == {need.frames for need in purpose.needs}


def sharpness(*numbers: tuple[float, float], **more: Any):
    """Return the answer for focus to MTF50s of half-widths, percent, along both axes."""
    measured = [
        measurement_from_sd(
            "mtf50",
            "cy/px",
            value,
            value * percent / 196.0,
            method="m",
            orientation_deg=angle,
            **more,
        )
        for value, percent in numbers
        for angle in (4.0, 94.0)
    ]
    session = charact.session([blank("edge")])
    return PURPOSES["focus"].decide(session, Result(measurements=tuple(measured)))


def test_the_precision_decides_and_how_many_times_the_frames_reach_it():
    assert sharpness((0.2, 4.5)).heading == "Fit for the sharpness of a camera: mtf50 within 5 %"
    coarse = sharpness((0.2, 9.5))
    assert coarse.answer == "not enough"
    assert coarse.heading.endswith("add a slanted edge in focus (4 times as many frames)")
    assert sharpness((0.2, 9.5), (0.2, 4.5)).answer == "fit"


def test_out_of_focus_is_not_fit_only_where_the_interval_says_so():
    blurred, near = sharpness((0.04, 2.0)), sharpness((0.081, 4.5))
    assert blurred.answer == "not fit" and "50 % below the 0.08" in blurred.heading
    assert blurred.missing[0].frames[0] == "a slanted edge in focus"
    assert near.answer == "not enough"


def test_most_curves_of_several_gains_decide():
    """One good curve beside two contradicting ones is no good number; one doubtful edge of four is
    the edge's.
    """
    doubtful = measurement_from_sd("mtf50", "cy/px", 0.2, 0.001, method="m")
    doubtful = doubtful.with_(flags=("drift",), notes=("drift: 1 px; what settles it: a stand",))
    session = charact.session([blank("edge")])
    ok = [
        measurement_from_sd("mtf50", "cy/px", 0.2, 0.001, method="m", orientation_deg=angle)
        for angle in (0.0, 0.0, 90.0)
    ]
    few = PURPOSES["focus"].decide(session, Result(measurements=(doubtful, *ok)))
    many = PURPOSES["focus"].decide(session, Result(measurements=(*ok[:1], doubtful, doubtful)))
    assert (few.answer, many.answer) == ("fit", "not enough")
    assert many.because == ("mtf50 is suspect (drift): 1 px",)
    assert many.missing[0].frames == ("a slanted edge in focus (a stand)",)


def test_targets_that_contradict_each_other_decide_nothing():
    evidence = {"agreement of targets": {"inside_joint_95_percent_region": False}}
    measured = [
        measurement_from_sd("mtf50", "cy/px", 0.2, 0.001, method="m", orientation_deg=angle)
        for angle in (0.0, 90.0)
    ]
    session = charact.session([blank("edge"), blank("bars")])
    given = PURPOSES["focus"].decide(
        session, Result(measurements=tuple(measured), evidence=evidence)
    )
    assert given.answer == "undecided"


def test_correlated_noise_is_not_fit_for_a_data_sheet_of_emva_1288():
    refused = make_refusal(
        "system_gain", "DN/e-", "noise is correlated", method="m", refusal="not-applicable"
    )
    session = charact.session([blank("flat"), blank("dark")])
    given = PURPOSES["emva1288"].decide(session, Result(measurements=(refused,)))
    assert given.heading == (
        "Not fit for a data sheet of EMVA 1288: system_gain: noise is correlated"
    )


@pytest.mark.parametrize(
    ("limit", "verdict", "answer"),
    [
        ({"min": 0.15}, "pass", "fit"),
        ({"min": 0.25}, "fail", "not fit"),
        ({"max": 0.2}, "undecided", "undecided"),
    ],
)
def test_the_limits_of_a_file_decide_as_check_does(tmp_path, limit, verdict, answer):
    (key, bound) = next(iter(limit.items()))
    file = tmp_path / "acceptance.toml"
    file.write_text(f'[[limit]]\nquantity = "mtf50"\nunit = "cy/px"\n{key} = {bound}\n')
    result = Result(measurements=(measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, method="m"),))
    specification = purpose_for(str(file))
    given = specification.decide(charact.session([blank("edge")]), result)
    assert charact.check(result, file).verdict == verdict and given.answer == answer
    assert given.purpose == "acceptance.toml"
    if answer == "not fit":
        assert "outside by 0.05 cy/px" in given.heading


def test_a_limit_of_a_quantity_that_is_not_measured_names_its_frames(tmp_path):
    file = tmp_path / "limits.toml"
    file.write_text('[[limit]]\nquantity = "system_gain"\nmax = 3\n')
    given = purpose_for(file).decide(charact.session([blank("edge")]), Result())
    assert given.answer == "not enough" and FLATS in given.heading


def test_a_purpose_that_is_not_known_is_one_sentence():
    with pytest.raises(charact.BadInput, match="did you mean 'detector'"):
        purpose_for("detectr")
