"""`charact compare` and `charact check`: text, JSON and exit codes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import charact
from labdata import Measurement, make_refusal, measurement_from_sd, open_session, result_io
from labdata import Result as Measured
from tests.charact.cli.runner import assert_one_sentence, json_of
from tests.charact.cli.runner import charact as run

QUANTITIES = (
    ("mtf50", "cy/px", 0.2),
    ("read_noise", "e-", 3.0),
    ("system_gain", "DN/e-", 0.05),
    ("dynamic_range", "1", 900.0),
    ("minimum_illumination", "lux", 4e-6),
)


def measurements(factor: float) -> list[Measurement]:
    session = [
        measurement_from_sd(q, unit, factor * v, 0.01 * v, method="x") for q, unit, v in QUANTITIES
    ]
    stacks = [
        measurement_from_sd("snr", "1", factor * 5.0 * n, 0.1, method="y", stack=f"flat-{n}")
        for n in range(1, 6)
    ]
    return [*session, *stacks, make_refusal("prnu", "%", "too few flats", method="x")]


def make_session(folder: Path, factor: float, mcp_v: float = 780.0) -> Path:
    """A session with saved results; its frames are not looked at."""
    folder.mkdir()
    text = 'name = "test"\n'
    for n in range(1, 6):
        np.save(folder / f"{n}.npy", np.full((2, 16, 16), n, np.uint8))
        text += (
            f'[[stack]]\nlabel = "flat-{n}"\nkind = "flat"\nframes = "{n}.npy"\nmcp_v = {mcp_v}\n'
        )
    (folder / "session.toml").write_text(text)
    result_io.save(Measured(measurements=tuple(measurements(factor))), folder)
    return folder


@pytest.fixture
def days(tmp_path: Path) -> tuple[Path, Path]:
    return make_session(tmp_path / "day1", 1.0), make_session(tmp_path / "day2", 1.05)


def test_the_json_has_every_difference(days: tuple[Path, Path]) -> None:
    document = json_of("compare", *days)
    assert document["input"] == [str(day) for day in days]
    found = {(one["quantity"], one.get("stack")): one for one in document["differences"]}
    assert len(found) == len(QUANTITIES) + 5
    mtf50 = found["mtf50", None]
    assert mtf50["difference"] == pytest.approx(mtf50["b"] - mtf50["a"]) == pytest.approx(0.01)
    assert mtf50["interval95"] == pytest.approx(
        [0.01 - 1.96 * 0.0028284, 0.01 + 1.96 * 0.0028284], abs=1e-4
    )
    assert mtf50["probability_better"] > 0.999
    assert found["read_noise", None]["probability_better"] < 0.001
    assert "probability_better" not in found["system_gain", None]
    assert (mtf50["status"], mtf50["flags"], document["conditions"]) == ("ok", [], [])
    assert found["snr", "flat-3"]["a"] == 15.0


def test_the_text_fits_one_screen_and_all_shows_the_rest(days: tuple[Path, Path]) -> None:
    done = run("compare", *days)
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert len(lines) <= 40 and max(map(len, lines)) <= 100
    assert any(
        line.startswith("mtf50 ") and "+0.0100 ± 0.0" in line and "> 0.999" in line
        for line in lines
    ), lines
    assert any(line.startswith("snr flat-5 (of 5)") for line in lines)
    assert "Conditions: alike in 5 matched stacks" in lines
    # 4 more rows, no count of them
    assert len(run("compare", *days, "--all").stdout.splitlines()) == len(lines) + 3


def test_unlike_sessions_are_refused_in_a_sentence_and_compared_anyway(
    days: tuple[Path, Path],
) -> None:
    other = make_session(days[0].parent / "day3", 1.0, mcp_v=800.0)
    rule = (
        "charact: compared sessions must be alike, got mcp_v 780 and 800 of stack 'flat-1' and 4 "
        "more unlike conditions; --anyway compares them nevertheless"
    )
    assert_one_sentence(run("compare", days[0], other), rule)
    assert json_of("compare", days[0], other)["error"] == rule.removeprefix("charact: ")
    done = run("compare", days[0], other, "--anyway")
    assert done.exit_code == 0
    assert "  mcp_v 780 | 800 of flat-1, flat-2, flat-3, flat-4 and 1 more (unlike)" in done.stdout
    assert "! unlike-conditions: mtf50, read_noise" in done.stdout.replace("system_gain, ", "")
    found = json_of("compare", days[0], other, "--anyway")
    assert {one["status"] for one in found["differences"]} == {"suspect"}


def test_unlike_sessions_are_refused_before_they_are_measured(days: tuple[Path, Path]) -> None:
    other = make_session(days[0].parent / "day3", 1.0, mcp_v=800.0)
    (other / "results.json").unlink()
    done = run("compare", days[0], other)
    assert done.exit_code == 1 and "has not been measured" not in done.stderr


@pytest.mark.parametrize(
    ("limits", "code", "verdict"),
    [
        ('quantity = "mtf50"\nmin = 0.15', 0, "pass"),
        ('quantity = "mtf50"\nmin = 0.25', 3, "fail"),
        ('quantity = "mtf50"\nmin = 0.2', 4, "undecided"),
        ('quantity = "prnu"\nmax = 2.0', 4, "undecided"),
        ('quantity = "mtf10"\nmin = 0.2', 4, "undecided"),
    ],
)
def test_the_exit_code_is_the_verdict(
    days: tuple[Path, Path], limits: str, code: int, verdict: str
) -> None:
    file = days[0] / "limits.toml"
    file.write_text(f"[[limit]]\n{limits}\n")
    done = run("check", days[0], "--limits", file)
    assert done.exit_code == code, done.output
    assert f"Verdict: {verdict} (1 {verdict})" in done.stdout.splitlines()
    done = run("check", days[0], "--limits", file, "--json")
    document = json.loads(done.stdout)
    assert (done.exit_code, document["verdict"], document["limits"]) == (
        code,
        verdict,
        "limits.toml",
    )
    saved = json.loads((days[0] / "checked.json").read_text())
    assert [one["verdict"] for one in saved["outcomes"]] == [verdict]


def test_any_failure_beats_the_undecided(days: tuple[Path, Path]) -> None:
    file = days[0] / "limits.toml"
    file.write_text(
        "".join(f'[[limit]]\nquantity = "mtf50"\nmin = {low}\n' for low in (0.1, 0.2, 0.3))
    )
    done = run("check", days[0], "--limits", file)
    assert done.exit_code == 3
    lines = done.stdout.splitlines()
    assert "Verdict: fail (1 pass, 1 fail, 1 undecided)" in lines
    assert [line.split()[0] for line in lines if " mtf50 " in line] == ["fail", "undecided", "pass"]
    assert max(map(len, lines)) <= 100


def test_many_limits_fit_one_screen(days: tuple[Path, Path]) -> None:
    file = days[0] / "limits.toml"
    file.write_text(
        "".join(f'[[limit]]\nquantity = "mtf50"\nmin = {0.2 + 1e-6 * n}\n' for n in range(60))
    )
    lines = run("check", days[0], "--limits", file).stdout.splitlines()
    assert len(lines) <= 40
    shown = sum(" mtf50 " in line for line in lines)
    assert shown > 10 and lines[-1] == f"Not shown: {60 - shown} undecided (--json)"


def test_bad_limits_are_one_sentence_and_exit_1(days: tuple[Path, Path]) -> None:
    file = days[0] / "limits.toml"
    file.write_text('[[limit]]\nquantity = "mtf50"\nmaximum = 0.1\n')
    rule = "charact: unknown key 'maximum' in limit 1 of limits.toml; did you mean 'max'?"
    assert_one_sentence(run("check", days[0], "--limits", file), rule)
    assert run("check", days[0], "--limits", days[0] / "none.toml").exit_code == 1
    assert run("check", days[0]).exit_code == 2
    assert not (days[0] / "checked.json").exists()


def test_the_page_has_a_chapter_of_limits_that_knows_a_new_result(days: tuple[Path, Path]) -> None:
    from charact.reporting import page

    def shown() -> str:
        session = open_session(days[0])
        return page(session, result_io.load(days[0]) or Measured())

    file = days[0] / "limits.toml"
    file.write_text('[[limit]]\nquantity = "mtf50"\nmin = 0.3\n')
    assert 'id="limits"' not in shown()
    run("check", days[0], "--limits", file)
    text = shown()
    assert (
        '<span class="badge refused">fail</span>' in text
        and "the whole 95 % interval lies outside" in text
    )
    assert "Checked before" not in text
    result_io.save(Measured(measurements=tuple(measurements(1.2))), days[0])
    assert "Checked before the last measurement" in shown()


def test_scripts_get_the_same_differences_and_verdicts(days: tuple[Path, Path]) -> None:
    found = charact.compare(*days)
    shown = json_of("compare", *days)["differences"]
    assert [one.interval95 for one in found.differences] == [
        tuple(one["interval95"]) for one in shown
    ]
    assert charact.check(days[0], [{"quantity": "mtf50", "min": 0.15}]).verdict == "pass"
    one, other = (Measured(measurements=tuple(measurements(factor))) for factor in (1.0, 1.05))
    assert charact.compare(one, other).differences == found.differences
    moved = replace(open_session(days[1]), bit_depth=12)
    assert charact.compare(days[0], moved).conditions[0].name == "bit_depth"
