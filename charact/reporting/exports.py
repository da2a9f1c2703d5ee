"""Measurements as CSV and JSON."""

import csv
import io
import json
from collections.abc import Mapping

from charact import __version__
from labdata.measurement import Result
from labdata.result_io import to_json

COLUMNS = (
    "quantity",
    "unit",
    "value",
    "status",
    "method",
    "stack",
    "frequency_cy_per_px",
    "orientation_deg",
    "reason",
)


def table_of_files(results: Mapping[str, Result]) -> str:
    """Return CSV: one line a measurement of each file or session, with the limits of its 95 %
    interval.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("file", *COLUMNS, "region", "low95", "high95", "flags"))
    for name, result in results.items():
        for m in result.measurements:
            region = "" if m.region is None else ",".join(map(str, m.region))
            ends = m.interval95 or (None, None)
            table.writerow(
                (
                    name,
                    *(getattr(m, column) for column in COLUMNS),
                    region,
                    *ends,
                    " ".join(m.flags),
                )
            )
    return text.getvalue()


def as_json(result: Result, input_name: str) -> str:
    """Return the JSON object of a measuring verb."""
    return json.dumps(to_json(result, given=input_name, version=__version__), allow_nan=False)
