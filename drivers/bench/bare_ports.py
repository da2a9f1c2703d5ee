"""Safe state of a bench through its serial ports alone, without server, client or session."""

import time
from dataclasses import replace
from typing import Any

from drivers.bench.safe_state import (
    DANGEROUS,
    FOLLOW_S,
    REOPEN_S,
    Record,
    SafeStateReport,
    StepRecord,
    Warn,
    make_safe,
)
from drivers.errors import BenchError
from drivers.instruments.models import model_of
from labdata.instrument_config import InstrumentConfig, InstrumentConnection, Role


def make_bench_safe(
    wires: InstrumentConfig, record: Record, warn: Warn = lambda report: None
) -> SafeStateReport:
    """Make the tube of a bench safe through its serial ports alone, even if another program has
    opened them.

    The report names instruments whose port could not be opened within 15 s; `warn` is called as by
    `make_safe`, by the first attempts alone.
    """
    connections: dict[Role, InstrumentConnection] = {
        connection.role: connection
        for connection in wires.instruments
        if connection.role in DANGEROUS and connection.port
    }
    drivers: dict[Role, Any] = {}
    failures: dict[Role, str] = {}
    give_up_s = time.monotonic() + REOPEN_S

    report: SafeStateReport | None = None
    step_record = StepRecord(record)
    while report is None or (len(drivers) < len(connections) and time.monotonic() < give_up_s):
        has_new_driver = False
        for role, connection in connections.items():
            if role in drivers:
                continue
            try:
                drivers[role] = _driver_on_port(connection, record)
                has_new_driver = True
            except BenchError as error:
                failures[role] = str(error)
        # Those at hand are followed while the others are awaited.
        is_patient = has_new_driver or report is None
        step_record.is_terse = not is_patient
        report = make_safe(
            gate=drivers.get("gate"),
            supply=drivers.get("supply"),
            lamps=[drivers.get("light-source")] if wires.light else [],
            record=step_record,
            warn=warn if report is None else lambda report: None,
            is_patient=is_patient,
        )
        if not is_patient:
            time.sleep(FOLLOW_S)
    missing = tuple(failures[role] for role in connections if role not in drivers)
    for driver in drivers.values():
        driver.line.close()
    return replace(report, failures=(*missing, *report.failures))


def _driver_on_port(connection: InstrumentConnection, record: Record) -> Any:
    """Return a driver on a serial port, shared with a program that has opened it."""
    model = model_of(connection)
    try:
        line = model.open_line(str(connection.port), connection.address)
    except BenchError as error:
        line = model.open_line(str(connection.port), connection.address, exclusive=False)
        record(
            f"{model.title}: port shared with the program that holds it", ok=True, error=str(error)
        )
    return model.driver(line)
