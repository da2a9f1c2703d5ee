"""The annotated picture: the frame with every measured region, its MTF50 and its verdict drawn in."""

from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Result

GREEN, AMBER, RED = (80, 200, 80), (40, 170, 250), (60, 60, 240)
COLOURS = {"ok": GREEN, "suspect": AMBER, "refused": RED}


def annotated(stack: FrameStack, result: Result, path: Path) -> None:
    """Write the mean frame as PNG with the regions of a result drawn in; refused ones in red with their reason."""
    import cv2

    picture = cv2.cvtColor(_stretched(stack), cv2.COLOR_GRAY2BGR)
    scale = max(1, round(640 / picture.shape[1]))
    picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    for measurement in _one_a_region(result):
        row, col, height, width = (scale * edge for edge in measurement.region or (0, 0, *stack.shape[1:]))
        colour = COLOURS[measurement.status]
        cv2.rectangle(picture, (col, row), (col + width - 1, row + height - 1), colour, 2)
        for line, text in enumerate(_caption(measurement)):
            origin = (col + 6, max(row + 20 + 18 * line, 14))
            cv2.putText(picture, text, origin, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
            cv2.putText(picture, text, origin, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    if path.suffix.lower() != ".png":
        raise BadInput(f"--annotate must name a .png file, got {path.name!r}")
    ok, encoded = cv2.imencode(".png", picture)
    if not ok:
        raise BadInput(f"the annotated picture could not be encoded for {path}")
    path.write_bytes(encoded.tobytes())


def _stretched(stack: FrameStack) -> np.ndarray:
    mean = stack.data.mean(axis=0)
    low, high = np.percentile(mean, (0.5, 99.5))
    return (np.clip((mean - low) / max(high - low, 1e-12), 0, 1) * 255).astype(np.uint8)


def _one_a_region(result: Result) -> list[Measurement]:
    """The measurement that stands for each region: its MTF50, else the first one it has."""
    by_region: dict[object, Measurement] = {}
    for measurement in result.measurements:
        if measurement.region not in by_region or measurement.quantity == "mtf50":
            by_region[measurement.region] = measurement
    return list(by_region.values())


def _caption(m: Measurement) -> list[str]:
    if m.value is None:
        return [f"{m.quantity}: refused", str(m.reason)[:70]]
    at = f" at {m.frequency_cy_per_px:.3g} cy/px" if m.frequency_cy_per_px is not None else ""
    lines = [f"{m.quantity}{at} {m.value:.3g} {m.unit if m.unit != '1' else ''}".strip()]
    if m.interval95:
        lines.append(f"95 %: {m.interval95[0]:.3g} to {m.interval95[1]:.3g}")
    return [*lines, ", ".join((m.status, *m.flags))]
