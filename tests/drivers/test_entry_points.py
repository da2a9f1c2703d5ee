"""A small package that is installed beside ours brings an instrument: its driver and its virtual
twin.
"""

import os
import textwrap

import pytest

from charact.cli.reference import VirtualPair
from drivers.conformance import rules_for
from drivers.instruments.models import models
from labdata import BadInput
from simulate.virtual_bench.instrument import virtual_models

pytestmark = pytest.mark.wires

MODULE = """
    from drivers.instruments.models import InstrumentModel
    from drivers.serial_lines.line import FramedLine, KnownAnswer
    from simulate.virtual_bench.instrument import VirtualModel
    from simulate.virtual_bench.instruments.meters import Thermometer as Virtual

    class Thermometer:
        def __init__(self, line):
            self.line = line

        def identify(self):
            return self.line.ask("*IDN?")

        def look(self):
            self.temperature_c()

        def temperature_c(self):
            return float(self.line.ask("In1.value?"))

    KNOWN = KnownAnswer(question="*IDN?", form=".*CTC100.*")
    MODEL = InstrumentModel(
        name="room-sensor",
        role="thermometer",
        title="room sensor",
        line=lambda port, address: FramedLine(
            port, name="room sensor", command_end=b"\\r\\n", known=KNOWN
        ),
        driver=Thermometer,
    )
    VIRTUAL = VirtualModel(
        name="room-sensor",
        bench_name="thermometer",
        make=lambda address, scale: Virtual(),
        baud=9600,
    )
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install a package as an installer leaves it: a module, and its entry points beside it."""

    def install(**points: str) -> None:
        site = tmp_path / "site"
        about = site / "room_sensor-1.0.dist-info"
        about.mkdir(parents=True, exist_ok=True)
        (site / "room_sensor.py").write_text(textwrap.dedent(MODULE))
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: room-sensor\nVersion: 1.0\n")
        groups = (f"[charact.{group}]\n{line}\n" for group, line in points.items())
        (about / "entry_points.txt").write_text("\n".join(groups))
        monkeypatch.syspath_prepend(site)
        monkeypatch.setenv(
            "PYTHONPATH",
            os.pathsep.join((str(site), os.environ.get("PYTHONPATH", ""), os.getcwd())),
        )

    return install


def test_an_instrument_of_another_package_stands_at_the_bench_and_keeps_the_rules(
    installed, tmp_path
):
    installed(
        instruments="room-sensor = room_sensor:MODEL",
        virtual_instruments="room-sensor = room_sensor:VIRTUAL",
    )
    assert models()["room-sensor"].role == "thermometer"
    assert "room-sensor" in virtual_models()
    with VirtualPair("room-sensor", tmp_path / "wires") as pair:
        rules = rules_for(pair.model)
        assert len(rules) > 5
        for rule in rules:
            rule(pair)


@pytest.mark.parametrize(
    ("point", "sentence"),
    [
        (
            "room-sensor = room_sensor:NOTHING",
            "the instrument 'room-sensor' of room_sensor:NOTHING must load, got",
        ),
        (
            "other = room_sensor:MODEL",
            "the entry point 'other' must be a InstrumentModel of that name",
        ),
        (
            "dg645 = room_sensor:MODEL",
            "the entry point 'dg645' must be a InstrumentModel of that name",
        ),
    ],
)
def test_a_package_that_brings_something_else_is_told_in_a_sentence(installed, point, sentence):
    installed(instruments=point)
    with pytest.raises(BadInput, match=sentence):
        models()
