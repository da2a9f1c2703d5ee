"""Frames a second of the intensified-camera simulator, against the same physics in plain NumPy and SciPy."""

from collections.abc import Iterator

import numpy as np

from benchmarks.row import Row, best_seconds

FRAMES = 4
LAMBDA_PER_FIELD_PX = 10.0


def rows() -> Iterator[Row]:
    """One row: flat frames, interlaced, 768x493."""
    from labdata.conditions import Conditions
    from labdata.sensors import load_sensor
    from labdata.target import Target
    from simulate.lab import LabBench

    bench = LabBench(load_sensor("pulnix-ag5745ef3"))
    conditions = Conditions(mcp_v=800.0, gate_ns=1.6e7, illuminance_lux=1e-4)

    def ours() -> None:
        bench.expose("flat", Target(), conditions, frames=FRAMES, seed=1)

    ours()
    rng = np.random.default_rng(1)
    yield Row(
        name=f"{FRAMES} simulated frames of a flat",
        seconds=best_seconds(ours, 3),
        peer="the intensified chain in plain NumPy and scipy.ndimage",
        peer_seconds=best_seconds(lambda: [_plain_frame(rng) for _ in range(FRAMES)], 3),
    )


def _plain_frame(rng: np.random.Generator) -> np.ndarray:
    """Two fields at twice the column density: Poisson, exponential pulses, Gaussian blur, read noise, digitised."""
    from scipy.ndimage import gaussian_filter

    fields = []
    for _ in range(2):
        events = rng.poisson(LAMBDA_PER_FIELD_PX / 4, (494, 1536))
        charge = rng.standard_gamma(np.maximum(events, 1e-9)) * 3.5
        blurred = gaussian_filter(charge, (1.3, 2.6))
        rows = blurred[:-1] + blurred[1:]
        fields.append(rows.reshape(493, 768, 2).sum(axis=2))
    frame = np.where(np.arange(493)[:, None] % 2 == 0, *fields) + 12 + rng.normal(0, 0.25, (493, 768))
    return np.clip(np.round(frame), 0, 255).astype(np.uint8)
