"""What the cells of the bar study say: a row for each, how many keep to one percent, and how often intervals hold."""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import charact

TABLE = Path(__file__).resolve().parents[1] / "tables" / "bar_bias.json"
# Bias that is allowed, percent, and by how many of its standard errors a cell may seem to exceed it.
ALLOWED_PERCENT, CHANCE = 1.0, 2.0
# Cells in which fewer of the answers are ok are ones that the method says it cannot measure.
FLAGGED_FRACTION = 0.5
VERDICTS = ("within", "chance", "off", "told")


@dataclass(frozen=True, kw_only=True)
class BarScenarioOutcome:
    """What became of the drawings of one cell.

    Parameters
    ----------
    number
        Place among the cells, and seed.
    blur, frequency_cy_per_px, tilt_deg, grain_px, phase_px
        The cell: name of the blur, the bars' frequency and tilt, blur of the noise, and where their middle lies; None:
        evenly over a pixel.
    truth
        MTF, pixel included.
    draws, numbers, ok
        Drawings, those with a number, and those with verdict ok.
    bias_percent, standard_error_percent, scatter_percent
        Mean error over the pairs, its standard error, and root mean squared error, % of the truth; a suspect number
        counts all the same.
    held68, held95
        Numbers whose intervals hold the truth.
    silent
        Numbers that are ok with the truth beyond twice the half of their 95 % interval.
    first
        The first numbers.
    """

    number: int
    blur: str
    frequency_cy_per_px: float
    tilt_deg: float
    grain_px: float
    phase_px: float | None
    truth: float
    draws: int
    numbers: int
    ok: int
    bias_percent: float | None
    standard_error_percent: float | None
    scatter_percent: float | None
    held68: int
    held95: int
    silent: int
    first: list[float | None]

    @property
    def told(self) -> bool:
        """Whether the method mostly says that it cannot tell: suspect or refused."""
        return self.ok < FLAGGED_FRACTION * self.draws

    @property
    def excess(self) -> float:
        """Bias beyond what is allowed, in its standard errors; negative within."""
        if self.bias_percent is None or not self.standard_error_percent:
            return float("inf")
        return (abs(self.bias_percent) - ALLOWED_PERCENT) / self.standard_error_percent

    @property
    def verdict(self) -> str:
        """`within` one percent, `chance` where the excess may be chance, `told` where it is no ok number, or `off`."""
        if self.told:
            return "told"
        if self.excess <= 0:
            return "within"
        return "chance" if self.excess <= CHANCE else "off"


@dataclass(frozen=True, kw_only=True)
class Tally:
    """What all cells say together.

    Parameters
    ----------
    verdicts
        Cells by verdict.
    held
        Shares of the numbers whose 68 % and 95 % intervals hold the truth, over all cells and by class.
    silent, ok
        Silent failures, and numbers that are ok.
    largest_standard_error_percent
        Of the bias of the cells that are not told.
    """

    verdicts: dict[str, int]
    held: dict[str, tuple[float, float, int]]
    silent: int
    ok: int
    largest_standard_error_percent: float

    def lines(self) -> list[str]:
        """Sentences of it."""
        within, chance, off, told = (self.verdicts[verdict] for verdict in VERDICTS)
        return [
            f"{within + chance} of {within + chance + off} cells that are measured keep to {ALLOWED_PERCENT:g} %: "
            f"{within} within, {chance} beyond by no more than {CHANCE:g} standard errors, the largest of which is "
            f"{self.largest_standard_error_percent:.2f} %",
            f"{off} cells are off by more; {told} are told as suspect or refused",
            f"{self.silent} silent failures among {self.ok} numbers that are ok",
            *(
                f"{name:22s} 68 % intervals hold {one:.3f}, 95 % {other:.3f} of {numbers} numbers"
                for name, (one, other, numbers) in self.held.items()
            ),
        ]


CLASSES: dict[str, Callable[[BarScenarioOutcome], str]] = {
    "blur": lambda one: one.blur,
    "frequency": lambda one: f"{one.frequency_cy_per_px:g} cy/px",
    "tilt": lambda one: f"{one.tilt_deg:g} deg",
    "grain": lambda one: "noise blurred" if one.grain_px else "noise white",
}


def tally(outcomes: Sequence[BarScenarioOutcome]) -> Tally:
    """Count verdicts, and pool the intervals of cells that are not told, all and by class."""
    measured = [one for one in outcomes if not one.told]
    held = {"all": _coverage(measured)}
    for name in CLASSES.values():
        for label in dict.fromkeys(map(name, measured)):
            held[label] = _coverage([one for one in measured if name(one) == label])
    return Tally(
        verdicts={verdict: sum(one.verdict == verdict for one in outcomes) for verdict in VERDICTS},
        held=held,
        silent=sum(one.silent for one in outcomes),
        ok=sum(one.ok for one in outcomes),
        largest_standard_error_percent=max((one.standard_error_percent or 0.0 for one in measured), default=0.0),
    )


def _coverage(outcomes: Sequence[BarScenarioOutcome]) -> tuple[float, float, int]:
    """Return the shares of numbers whose 68 % and 95 % intervals hold, and their count."""
    count = sum(one.numbers for one in outcomes)
    return (
        sum(one.held68 for one in outcomes) / max(count, 1),
        sum(one.held95 for one in outcomes) / max(count, 1),
        count,
    )


def lines(outcomes: Iterable[BarScenarioOutcome]) -> list[str]:
    """Return the cells as rows for eyes."""
    head = (
        "  no blur                cy/px tilt grain phase     MTF   bias %   se %  rms %  68 %  95 %    ok number silent"
    )
    return [head, *(_line(one) for one in outcomes)]


def _line(one: BarScenarioOutcome) -> str:
    phase = "  all" if one.phase_px is None else f"{one.phase_px:5.2f}"
    where = (
        f"{one.number:4d} {one.blur:19s} {one.frequency_cy_per_px:5.2f} {one.tilt_deg:4.0f} {one.grain_px:5.1f} {phase}"
    )
    if one.bias_percent is None or one.standard_error_percent is None or one.scatter_percent is None:
        return f"{where} {one.truth:7.4f}  no number: {one.verdict}"
    errors = f"{one.bias_percent:+8.2f} {one.standard_error_percent:6.2f} {one.scatter_percent:6.1f}"
    held = f"{one.held68 / one.numbers:5.2f} {one.held95 / one.numbers:5.2f}"
    shares = f"{one.ok / one.draws:5.2f} {one.numbers / one.draws:6.2f}"
    return f"{where} {one.truth:7.4f} {errors} {held} {shares} {one.silent:6d} {one.verdict}"


def write_table(outcomes: Sequence[BarScenarioOutcome], path: Path = TABLE, *, method: str) -> Path:
    """Write the table: a row for each cell, and what they say together."""
    rows = [[_short(value) for value in asdict(one).values()] for one in outcomes]
    table = {
        "charact": charact.__version__, "method": method, "seed": "[cell, 17, pair]", "tally": tally(outcomes).lines(),
        "columns": [one.name for one in fields(BarScenarioOutcome)], "rows": rows,
    }  # fmt: skip
    path.write_text(json.dumps(table).replace("]], [", "]],\n[") + "\n", encoding="utf-8")
    return path


def read(path: Path = TABLE) -> list[BarScenarioOutcome]:
    """Return the cells of a table."""
    table = json.loads(path.read_text())
    return [BarScenarioOutcome(**dict(zip(table["columns"], row, strict=True))) for row in table["rows"]]


def _short(value: Any) -> Any:
    if isinstance(value, list):
        return [_short(one) for one in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value
