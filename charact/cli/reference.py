"""The verbs `methods`, `schema`, `chart`, `stability`, `doctor` and `conform`: references and
checks.
"""

import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input
from labdata.errors import BadInput

if TYPE_CHECKING:
    from drivers.serial_lines.line import InstrumentLine


def methods(as_json: options.Json = False) -> None:
    """List the registered methods with scope, measured error and computing time.

    Example: charact methods
    """
    from charact.method.registry import chart_table, describe_methods
    from charact.method.stopwatch import time_text

    rows = []
    for row in describe_methods():
        charted = [
            r for q in row["quantities"] for r in chart_table(q) if r["method"] == row["name"]
        ]
        rows.append(
            row
            | ({key: charted[0][key] for key in ("error_percent", "seconds")} if charted else {})
        )
    if as_json:
        print(json.dumps({"methods": rows}))
        return
    for row in rows:
        cost = (
            f"{row['error_percent']:.3g} % in {time_text(row['seconds'])}"
            if "seconds" in row
            else "not charted"
        )
        print(
            f"{row['kind']:6} {row['name']:16} {cost:22} "
            f"{', '.join(row['quantities'])}\n{'':24}{row['scope']}"
        )


def schema(
    kind: Annotated[
        str,
        typer.Argument(
            help="session, sensor, solid-state, infrared, plan, limits, scene (outdoor) or bench."
        ),
    ],
) -> None:
    """Print the JSON Schema of a file format, for editors.

    Example: charact schema plan > plan.schema.json
    """
    with exit_on_bad_input(kind):
        from charact.comparison import Limits
        from labdata.schema import file_schema
        from simulate.radiance.outdoor.scene import OutdoorScene
        from simulate.radiance.scene import LabScene

        found = file_schema(kind, {"limits": Limits, "scene": OutdoorScene, "bench": LabScene})
        if kind == "scene":
            # The folder is not part of the file.
            del found["properties"]["folder"]
        print(json.dumps(found, indent=2))


Name = Annotated[str, typer.Argument(help="Quantity, such as mtf50.")]


def chart(
    quantity: Name,
    out: Annotated[Path, typer.Option(help="Folder for the figure.")] = Path("study"),
) -> None:
    """Show error against computing time of every method of a quantity, from the shipped table.

    Example: charact chart mtf50 --out study
    """
    with exit_on_bad_input(quantity):
        from charact.cli.figures import chart_lines, write_chart

        rows = _shipped_rows(quantity)
        print("\n".join(chart_lines(quantity, rows)))
        print(write_chart(quantity, rows, out))
        print(f"Measure anew in a checkout: make study NAME=chart QUANTITY={quantity}")


def stability(quantity: Name) -> None:
    """Show how every method of a quantity failed on the shipped cases.

    Example: charact stability mtf50
    """
    with exit_on_bad_input(quantity):
        from charact.cli.figures import failure_lines

        print("\n".join(failure_lines(quantity, _shipped_rows(quantity))))
        print(f"Breaking points, in a checkout: make study NAME=stability QUANTITY={quantity}")


def _shipped_rows(quantity: str) -> list[dict[str, Any]]:
    """Return the rows of the shipped table of a quantity."""
    from charact.method.registry import chart_table, charted_quantities

    if quantity not in (charted := charted_quantities()):
        raise BadInput(
            f"QUANTITY must be one with a shipped table, {', '.join(charted)}, got {quantity!r}: "
            "charact methods lists what each method measures"
        )
    return chart_table(quantity)


def doctor(
    folder: Annotated[Path, typer.Argument(help="Folder for sessions.")] = Path(),
    as_json: options.Json = False,
) -> None:
    """Check versions, disk, cameras, ports, permissions and network; report ok or how to fix it.

    Changes nothing and contacts no instrument. Exit 0 if the core works, even without a camera.

    Example: charact doctor /data
    """
    with exit_on_bad_input(str(folder), as_json=as_json):
        from charact.live.doctor import examine

        found = []
        for one in examine(folder):
            found.append(one)
            if not as_json:
                mark = "ok " if one.ok else "FIX"
                print(
                    f"{mark}  {one.area:14} {one.says}"
                    + ("" if one.ok else f"\n{'':19} -> {one.fix}"),
                    flush=True,
                )
        lacking = [one for one in found if one.core and not one.ok]
        if as_json:
            findings = [{**vars(one), "ok": one.ok} for one in found]
            print(
                json.dumps(
                    {"charact": __version__, "core_can_work": not lacking, "findings": findings}
                )
            )
        elif not lacking:
            print(
                f"\nThe core works; {sum(not one.ok for one in found)} other findings have a fix."
            )
        if lacking:
            print(f"charact: the core does not work: {lacking[0].says}", file=sys.stderr)
            raise typer.Exit(1)


def conform(
    names: Annotated[
        list[str] | None, typer.Argument(help="Models, such as dg645 (default: all).")
    ] = None,
) -> None:
    """Run the conformance tests of drivers against their virtual instruments.

    Exit 1 if a rule is broken. Models of other packages are found by their entry points.

    Example: charact conform iseg
    """
    with exit_on_bad_input("conform"):
        from drivers.instruments.models import models

        broken = sum(_check_model(name) for name in names or models())
        if broken:
            raise BadInput(f"all conformance rules must be kept, got {broken} broken")


def _check_model(name: str) -> int:
    """Check one model, print each rule, and return the number of broken rules."""
    from drivers.conformance import rules_for

    broken = 0
    with tempfile.TemporaryDirectory() as folder, VirtualPair(name, Path(folder)) as pair:
        rules = rules_for(pair.model)
        print(f"{name} ({pair.model.role}), {len(rules)} rules:")
        for rule in rules:
            said = (rule.__doc__ or rule.__name__).strip().splitlines()[0]
            try:
                rule(pair)
                print(f"  kept    {said}")
            except Exception as error:  # a driver under test may raise anything
                broken += 1
                print(f"  BROKEN  {said} {rule.__name__}: {error!r}")
                pair.heal()
    return broken


ADDRESS = 14
_FAULTS: dict[str, dict[str, Any]] = {
    "silent": {"silent": True},
    "mute": {"mute": True},
    "garbage": {"garbage": True},
    "half-lines": {"half_lines": True},
    "late": {"late_s": 0.6},
    "unplugged": {"unplugged": True},
    "trip": {"tripped": True},
    "power-cycle": {},
    "panel": {},
}


class VirtualPair(AbstractContextManager["VirtualPair"]):
    """Driver and virtual instrument of a model over a pseudo-terminal, running within a `with`
    block.
    """

    def __init__(self, name: str, folder: Path) -> None:
        from drivers.instruments.models import models
        from simulate.virtual_bench.instrument import virtual_model
        from simulate.virtual_bench.process import VirtualInstruments

        known = models()
        if name not in known:
            raise BadInput(f"a model must be one of {', '.join(sorted(known))}, got {name!r}")
        self.model = known[name]
        self._virtual, self._folder = virtual_model(name), Path(folder)
        self._instruments = VirtualInstruments(
            self._folder,
            models=(name,),
            gate_address=ADDRESS,
            supply_address=ADDRESS,
            time_scale=20.0,
        )
        self._line: InstrumentLine | None = None
        self._power_cycles, self._tripped = 0, False

    def __enter__(self) -> "VirtualPair":
        self._instruments.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        self._instruments.stop()

    def driver(self) -> Any:
        """Reopen the line and return a driver on it."""
        self._close()
        self._line = self.model.open_line(self._instruments.port(self._virtual.bench_name), ADDRESS)
        return self.model.driver(self._line)

    def outputs(self) -> Mapping[str, Any]:
        """Return the present outputs of the instrument."""
        found: dict[str, Any] = {}
        for path in self._folder.glob("*.output.json"):
            found |= json.loads(path.read_text())
        return found

    def suffer(self, fault: str, setting: str = "") -> None:
        """Start one fault and end all others; "panel" changes a setting at the instrument's front
        panel.
        """
        self._power_cycles += fault == "power-cycle"
        self._tripped = fault == "trip"
        if fault == "panel":
            self._now(panel=self._virtual.panel[setting])
        self._now(**_FAULTS[fault])

    def heal(self) -> None:
        """End all faults; a trip is cleared by a power cycle."""
        self._power_cycles += self._tripped
        self._now()
        self._tripped = False

    def _now(self, **faults: Any) -> None:
        from simulate.virtual_bench.faults import Faults, inject_faults

        inject_faults(
            self._folder,
            self._virtual.bench_name,
            Faults(**faults, power_cycles=self._power_cycles),
        )
        # Time until a virtual instrument reads its fault file, s.
        time.sleep(0.06)

    def _close(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            with contextlib.suppress(OSError):
                line.close()
