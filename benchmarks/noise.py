"""Noise statistics of a long photon-transfer series, beyond the reading of its frames, and the
memory they take.
"""

import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.row import Row

PAIRS = 100
SHAPE = (493, 768)
MS_PER_PAIR = 5.0
MEMORY_GIB = 1.0


def rows() -> Iterator[Row]:
    """A series of 100 pairs of 12 bits and a pair of darks: statistics alone, with spectra, and the
    whole verb.
    """
    from charact.estimators import noise
    from charact.estimators.noise.gain.series import read_levels
    from charact.session_measurement import method_context
    from labdata import open_lazy_stack, open_session

    with tempfile.TemporaryDirectory() as folder:
        _series(Path(folder))
        session = open_session(folder)
        context = method_context(session, quick=True, seed=0)
        reading = _cpu_seconds(
            lambda: [open_lazy_stack(entry).in_memory() for entry in session.stacks]
        )
        pair = session.stacks[1].read().data
        plain = _cpu_seconds(lambda: [_variance(pair) for _ in range(PAIRS)])
        promised = 1e-3 * MS_PER_PAIR * PAIRS
        for name, limit, work in (
            ("statistics", promised, lambda: read_levels(session, context=context, spectra=False)),
            (
                "statistics with spectra",
                promised,
                lambda: read_levels(session, context=context, spectra=True),
            ),
            (
                "variance --quick",
                promised,
                lambda: noise.measure(session, method="variance", context=context),
            ),
            (
                "covariance-sum --quick",
                promised,
                lambda: noise.measure(session, method="covariance-sum", context=context),
            ),
        ):
            yield Row(
                name=f"{name}, {PAIRS} pairs, CPU",
                seconds=_cpu_seconds(work) - reading,
                peer="variance of differences in NumPy",
                peer_seconds=plain,
                limit_seconds=limit,
            )
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    if peak_gib > MEMORY_GIB:
        raise MemoryError(f"a series must be measured in {MEMORY_GIB:g} GiB, took {peak_gib:.2f}")


def _series(folder: Path) -> None:
    """Frames of a camera of white noise, K = 0.5 DN/e-."""
    rng = np.random.default_rng(1)
    lines = ['name = "series"', "bit_depth = 12"]
    for number in range(PAIRS + 1):
        label, kind = (f"flat-{number}", "flat") if number else ("dark", "dark")
        frames = (
            64.0
            + 0.5 * rng.poisson(60.0 * number, (2, *SHAPE))
            + 3.0 * rng.standard_normal((2, *SHAPE))
        )
        np.save(folder / f"{label}.npy", np.clip(np.rint(frames), 0, 4095).astype(np.uint16))
        lines += ["[[stack]]", f'label = "{label}"', f'kind = "{kind}"', f'frames = "{label}.npy"']
    (folder / "session.toml").write_text("\n".join(lines) + "\n")


def _variance(pair: np.ndarray) -> float:
    return 0.5 * float(np.var(pair[1].astype(np.float64) - pair[0]))


def _cpu_seconds(work) -> float:
    """Shortest processor time of three: other work on the machine counts little."""
    times = []
    for _ in range(3):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)
