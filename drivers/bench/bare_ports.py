"""Safe state of a bench through its serial ports alone, without server, client or session."""

from contextlib import suppress
from typing import Any

from drivers.bench.safe_state import DANGEROUS, Record, SafeStateReport, Warn, make_safe
from drivers.errors import BenchError
from drivers.instruments.models import model_of
from labdata.instrument_config import InstrumentConfig, InstrumentConnection, Role


def make_bench_safe(
    wires: InstrumentConfig, record: Record, warn: Warn = lambda report: None
) -> SafeStateReport:
    """Make the tube of a bench safe through its serial ports alone, even if another program has
    opened them.

    A missing port is waited for up to 15 s, see `make_safe`, and named in the report.
    """
    drivers: dict[Role, Any] = {
        connection.role: _driver(connection)
        for connection in wires.instruments
        if connection.role in DANGEROUS and connection.port
    }
    report = make_safe(
        gate=drivers.get("gate"),
        supply=drivers.get("supply"),
        lamps=[drivers.get("light-source")] if wires.light else [],
        record=record,
        warn=warn,
    )
    for driver in drivers.values():
        driver.line.close()
    return report


def _driver(connection: InstrumentConnection) -> Any:
    """Return a driver on a serial port that is shared with a program that has opened it."""
    model = model_of(connection)
    port = model.later_port(str(connection.port))
    with suppress(BenchError):
        port.reopen()
    return model.driver(model.line(port, connection.address))
