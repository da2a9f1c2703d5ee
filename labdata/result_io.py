"""Results as JSON: output of the command line, and the result saved in a session folder."""

import hashlib
import io
import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.file_io import write_atomically
from labdata.measurement import Curve, Measurement, Posterior, Provenance, Result

RESULTS = "results.json"
DRAWS = "results-{}.npz"
FORMAT = 1

# Fields of a measurement written to the JSON only if set.
WHERE_THEY_APPLY = (
    "stack",
    "region",
    "frequency_cy_per_px",
    "orientation_deg",
    "amplifier",
    "notes",
    "reason",
)
ALWAYS = (
    "quantity",
    "unit",
    "value",
    "interval68",
    "interval95",
    "status",
    "flags",
    "method",
    "seconds",
)


def to_json(result: Result, *, given: str, version: str) -> dict[str, Any]:
    """Return a result as the JSON object of a measuring verb; `given` is the input as named on the
    command line.
    """
    return {
        "charact": version,
        "input": given,
        "measurements": [_measurement(measurement) for measurement in result.measurements],
        "curves": {name: _curve(curve) for name, curve in result.curves.items()},
    }


def save(result: Result, folder: str | Path) -> Path:
    """Save a full result, with posterior draws and figure data, in a session folder, and return its
    document.
    """
    folder = Path(folder)
    arrays: dict[str, NDArray] = {}
    document = {
        "format": FORMAT,
        "measurements": [
            _full_measurement(m, f"m{i}", arrays) for i, m in enumerate(result.measurements)
        ],
        "curves": {name: _curve(curve) for name, curve in result.curves.items()},
        "evidence": _value(result.evidence),
    }
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **arrays)
    # The file name of the draws contains their digest, so that old document and old draws match
    # until the rename.
    draws = folder / DRAWS.format(hashlib.sha256(packed.getvalue()).hexdigest()[:16])
    text = json.dumps({**document, "draws": draws.name}, allow_nan=False)
    write_atomically(draws, packed.getvalue())
    write_atomically(folder / RESULTS, text.encode())
    for old in folder.glob(DRAWS.format("*")):
        if old != draws:
            old.unlink()
    return folder / RESULTS


def save_into(result: Result, folder: str | Path) -> Path:
    """Save the result of one analysis in a session folder; other quantities saved there stay."""
    earlier = load(folder) or Result()
    anew = {m.quantity for m in result.measurements}
    remaining = Result(
        measurements=tuple(m for m in earlier.measurements if m.quantity not in anew),
        curves=earlier.curves,
        evidence=earlier.evidence,
    )
    return save(remaining + result, folder)


def load(folder: str | Path) -> Result | None:
    """Load the result saved in a session folder; None if there is none, BadInput if it cannot be
    read.
    """
    path = Path(folder) / RESULTS
    if not path.exists():
        return None
    try:
        document = json.loads(path.read_bytes())
        with np.load(path.parent / document["draws"], allow_pickle=False) as packed:
            arrays = {name: packed[name] for name in packed.files}
        if document["format"] != FORMAT:
            raise BadInput(
                f"a kept result must have format {FORMAT}, got {document['format']} in {path}"
            )
        return Result(
            measurements=tuple(
                _read_measurement(stored, arrays) for stored in document["measurements"]
            ),
            curves={name: _read_curve(stored) for name, stored in document["curves"].items()},
            evidence=document["evidence"],
        )
    except BadInput:
        raise
    except (OSError, ValueError, KeyError, TypeError):
        raise BadInput(
            f"a kept result must be whole and readable, got {path}; measure the session again"
        ) from None


def _measurement(measurement: Measurement) -> dict[str, Any]:
    always = {name: _value(getattr(measurement, name)) for name in ALWAYS}
    applying = {name: _value(getattr(measurement, name)) for name in WHERE_THEY_APPLY}
    return {
        **always,
        **{name: value for name, value in applying.items() if value not in (None, [])},
    }


def _curve(curve: Curve) -> dict[str, Any]:
    columns = {
        item.name: _value(getattr(curve, item.name))
        for item in fields(curve)
        if item.name != "draws"
    }
    return {name: value for name, value in columns.items() if value is not None or name != "stack"}


def _full_measurement(
    measurement: Measurement, key: str, arrays: dict[str, NDArray]
) -> dict[str, Any]:
    """Return a measurement with provenance and posterior; its arrays are replaced by names, equal
    ones by one.
    """
    record = _measurement(measurement)
    if measurement.value is None:
        record["refusal"] = measurement.refusal
    if measurement.provenance is not None:
        record["provenance"] = _value(vars(measurement.provenance))
    if measurement.posterior is not None:
        record["posterior"] = {
            name: {"array": _array_name(value, f"{key}.{name}", arrays)}
            if isinstance(value, np.ndarray)
            else _value(value)
            for name, value in vars(measurement.posterior).items()
        }
    return record


def _array_name(value: NDArray, key: str, arrays: dict[str, NDArray]) -> str:
    for name, known in arrays.items():
        if known is value or (known.shape == value.shape and np.array_equal(known, value)):
            return name
    arrays[key] = value
    return key


def _read_measurement(document: dict[str, Any], arrays: dict[str, NDArray]) -> Measurement:
    keys = _with_tuples(document)
    if "provenance" in keys:
        keys["provenance"] = Provenance(**keys["provenance"])
    if "posterior" in keys:
        parts = _with_tuples(keys["posterior"])
        parts |= {
            name: arrays[value["array"]] for name, value in parts.items() if isinstance(value, dict)
        }
        keys["posterior"] = Posterior(**parts)
    return Measurement(**keys)


def _with_tuples(document: dict[str, Any]) -> dict[str, Any]:
    return {
        name: tuple(value) if isinstance(value, list) else value for name, value in document.items()
    }


def _read_curve(document: dict[str, Any]) -> Curve:
    lists = {
        name: np.array(value, float) for name, value in document.items() if isinstance(value, list)
    }
    keys: dict[str, Any] = {**document, **lists}
    return Curve(**keys)


def _value(value: Any) -> Any:
    """Return a value as JSON; a non-finite number becomes null, a gap in a figure."""
    if isinstance(value, np.ndarray | np.generic):
        return _value(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, tuple | list):
        return [_value(item) for item in value]
    if isinstance(value, dict):
        return {str(key): _value(item) for key, item in value.items()}
    return str(value) if isinstance(value, Path) else value
