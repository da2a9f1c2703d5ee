"""Photon-transfer sessions drawn with plain NumPy: share `ok`, coverage of the intervals, and
silent failures.

No part of the simulator draws here: Poisson electrons, gamma multiplication, linear crosstalk,
normal read noise, noise of rows and columns, whole codes of 8 to 16 bits. Half of the sessions hold
pixels that misbehave. The intensified kinds are in `benchmarks.studies.strangers_intensified`.

    python -m benchmarks.studies.strangers_noise [SEED [SESSIONS]]
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KINDS = ("white", "crosstalk", "lines", "multiplied")
SESSIONS = 260
# Read noise below this hides under the steps, as `quantised` says: its intervals are counted apart.
FINE_DN = 0.6


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Frames of one session and what they were drawn from.

    Parameters
    ----------
    kind, spoilt
        Kind of camera, and whether pixels misbehave.
    bits
        Of the digitiser.
    stacks
        Kind, frames of shape (frame, row, col) and conditions of each stack.
    truth
        Value of a quantity by its name and unit.
    """

    kind: str
    spoilt: bool
    bits: int
    stacks: list[tuple[str, NDArray[np.uint16], dict[str, float]]]
    truth: dict[tuple[str, str], float] = field(default_factory=dict)


def draw_session(kind: str, rng: np.random.Generator, *, spoilt: bool) -> Drawn:
    """Draw a session of a kind of camera."""
    bits = int(rng.choice([14, 16] if kind == "multiplied" else [8, 10, 12, 12, 14, 16]))
    top = 2.0**bits - 1.0
    rows, cols = (int(side) for side in rng.integers(128, 257, 2))
    read_e = float(
        rng.uniform(30.0, 80.0)
        if kind == "multiplied"
        else np.exp(rng.uniform(np.log(2.0), np.log(12.0)))
    )
    # At least a third of a step of read noise, as a maker would choose it; up to two electrons a
    # code.
    least = 0.35 / read_e
    gain = float(
        np.exp(rng.uniform(np.log(least), np.log(max(2.0 * least, min(2.0, top / 4000.0)))))
    )
    black = 0.03 * top + 6.0 * gain * read_e
    register = (
        float(np.exp(rng.uniform(np.log(20.0), np.log(1000.0)))) if kind == "multiplied" else 1.0
    )
    per_electron = gain * register
    well = 0.9 * (top - black) / per_electron
    share = float(rng.uniform(0.0, 0.05)) if kind == "crosstalk" else 0.0
    lines = float(rng.uniform(0.2, 1.5)) * read_e if kind == "lines" else 0.0
    along = int(rng.integers(2))
    frames = int(rng.choice([2, 2, 4, 8, 12]))
    count = int(rng.integers(4, 11))
    low, high = rng.uniform(0.02, 0.1), rng.uniform(0.4, 0.75)
    levels = well * (np.linspace if rng.random() < 0.5 else np.geomspace)(low, high, count)
    response = 1.0 + rng.uniform(0.003, 0.015) * rng.standard_normal((rows, cols))
    offset = rng.uniform(0.5, 3.0) * rng.standard_normal((rows, cols))
    y, x = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, cols)[None, :]
    shade = 1.0 - rng.uniform(0.0, 0.3) * (x**2 + y**2) / 2.0
    wrong = _misbehaviour(rng, (rows, cols), well) if spoilt else None
    efficiency = float(rng.uniform(0.3, 0.9))

    def exposed(level: float, number: int) -> NDArray[np.uint16]:
        charge = rng.poisson(
            np.broadcast_to(level * shade * response, (number, rows, cols))
        ).astype(float)
        if register > 1.0:
            charge = np.where(charge > 0, rng.gamma(np.maximum(charge, 1e-9)), 0.0) * register
        if share:
            charge = _shared(charge, share)
        charge += offset + read_e * rng.standard_normal(charge.shape)
        if lines:
            line = lines * rng.standard_normal((number, rows, 1) if along else (number, 1, cols))
            charge = charge + line
        if wrong is not None:
            charge = wrong(charge, level)
        return np.clip(np.rint(black + gain * charge), 0, top).astype(np.uint16)

    state = {"em_gain": register} if register > 1.0 else {}
    stacks: list[tuple[str, NDArray[np.uint16], dict[str, float]]] = [
        ("dark", exposed(0.0, max(frames, 2)), state)
    ]
    stacks += [
        (
            "flat",
            exposed(e, frames),
            {**state, "photons_per_px": e * float(shade.mean()) / efficiency},
        )
        for e in levels
    ]
    noise = float(np.hypot(read_e, lines))
    truth = {
        ("system_gain", "DN/e-"): per_electron,
        ("covariance_gain", "DN"): per_electron * (2.0 if register > 1.0 else 1.0),
        ("read_noise", "DN"): float(np.hypot(gain * noise, 12.0**-0.5)),
        ("read_noise", "e-"): noise / register,
        ("quantum_efficiency", "%"): 100.0 * efficiency,
    }
    return Drawn(kind=kind, spoilt=spoilt, bits=bits, stacks=stacks, truth=truth)


def _shared(charge: Array, share: float) -> Array:
    """Every pixel gives a share of its signal to each of its four neighbours."""
    whole = np.pad(charge, ((0, 0), (1, 1), (1, 1)), mode="reflect")
    around = whole[:, :-2, 1:-1] + whole[:, 2:, 1:-1] + whole[:, 1:-1, :-2] + whole[:, 1:-1, 2:]
    return (1.0 - 4.0 * share) * charge + share * around


def _misbehaviour(
    rng: np.random.Generator, size: tuple[int, int], well: float
) -> Callable[[Array, float], Array]:
    """Stuck, hot, dead and blinking pixels, up to 0.5 % of all, and hits on up to 1e-4 of the
    pixels of a frame.
    """
    pixels = size[0] * size[1]
    count = int(rng.uniform(1.0, 0.005 * pixels))
    places = np.stack(np.unravel_index(rng.choice(pixels, count, replace=False), size))
    what = rng.integers(4, size=count)
    amount = well * np.exp(rng.uniform(np.log(0.02), np.log(1.5), count))
    hits = rng.uniform(0.0, 1e-4)

    def wrong(charge: Array, level: float) -> Array:
        out = charge.copy()
        for kind in range(4):
            row, col = places[:, what == kind]
            size_e = amount[what == kind]
            if kind == 0:
                # stuck at the top, or without any charge
                out[:, row, col] = 10.0 * well * (size_e > 0.2 * well)
            elif kind == 1:
                out[:, row, col] += rng.poisson(size_e, (len(out), len(row)))
            elif kind == 2:
                out[:, row, col] -= 0.8 * level
            else:
                out[:, row, col] += 0.2 * size_e * (rng.random((len(out), len(row))) < 0.5)
        struck = rng.random(out.shape) < hits
        out[struck] += rng.exponential(0.3 * well, int(struck.sum()))
        return out

    return wrong


def write_session(session: Drawn, folder: Path) -> None:
    """Write a session as a user would: one file a stack and a manifest."""
    lines = ['name = "strangers"', f"bit_depth = {session.bits}"]
    for index, (kind, frames, conditions) in enumerate(session.stacks):
        np.save(folder / f"{index}.npy", frames)
        lines += [
            "",
            "[[stack]]",
            f'label = "{kind}-{index}"',
            f'kind = "{kind}"',
            f'frames = "{index}.npy"',
        ]
        lines += [f"{name} = {float(value)!r}" for name, value in conditions.items()]
    (folder / "session.toml").write_text("\n".join(lines) + "\n")


@dataclass
class Tally:
    """Counts of one quantity."""

    drawn: int = 0
    ok: int = 0
    held: int = 0
    silent: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    flags: Counter[str] = field(default_factory=Counter)

    def add(self, measurement: Any, truth: float, name: str) -> None:
        """Count a measurement, None for one that is missing."""
        self.drawn += 1
        if measurement is None or measurement.status != "ok":
            self.flags.update(
                ("missing",) if measurement is None else measurement.flags or (measurement.status,)
            )
            return
        low, high = measurement.interval95
        half = measurement.value - low if truth < measurement.value else high - measurement.value
        self.ok += 1
        self.held += low <= truth <= high
        sentence = f"{name}: {measurement.value:.4g} [{low:.4g}, {high:.4g}], truth {truth:.4g}"
        if not low <= truth <= high:
            self.missed.append(sentence)
        if abs(truth - measurement.value) > 2.0 * half:
            self.silent.append(sentence)


def tallies_of(sessions: Iterator[tuple[str, Drawn]]) -> dict[tuple[str, str], Tally]:
    """Measure sessions and count by kind and quantity."""
    from charact.estimators import noise
    from charact.session_measurement import method_context
    from labdata import Result, open_session

    out: dict[tuple[str, str], Tally] = {}
    for name, one in sessions:
        with tempfile.TemporaryDirectory() as folder:
            write_session(one, Path(folder))
            session = open_session(folder)
            try:
                result = noise.measure(
                    session, context=method_context(session, quick=False, seed=0)
                )
            except KeyboardInterrupt:
                print(f"broken off at {name}")
                return out
            except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
                print(f"{name} ends in {error!r}")
                result = Result()
        for (quantity, unit), truth in one.truth.items():
            found = result.find(quantity, unit=unit)
            fine = (
                ""
                if quantity != "read_noise" or one.truth["read_noise", "DN"] >= FINE_DN
                else " under the steps"
            )
            key = f"{quantity} {unit}{fine}"
            for kind in (one.kind, "all"):
                tally = out.setdefault((kind, key), Tally())
                tally.add(
                    found[0] if found else None,
                    truth,
                    f"{name} {'spoilt' if one.spoilt else 'sound'}",
                )
    return out


def sessions_of(seed: int, count: int) -> Iterator[tuple[str, Drawn]]:
    """Draw sessions of all kinds in turn, half of them spoilt."""
    for index in range(count):
        kind = KINDS[index % len(KINDS)]
        rng = np.random.default_rng([seed, index])
        yield f"{kind} {index}", draw_session(kind, rng, spoilt=(index // len(KINDS)) % 2 == 1)


def main(seed: int = 1, count: int = SESSIONS) -> None:
    """Print the table."""
    start, cpu = time.perf_counter(), time.process_time()
    table = tallies_of(sessions_of(seed, count))
    print(
        f"seed {seed}, {count} sessions, {time.process_time() - cpu:.0f} s of processor, "
        f"{time.perf_counter() - start:.0f} s"
    )
    print(
        f"{'kind':<11} {'quantity':<34} {'drawn':>5} {'ok %':>6} {'held %':>7} {'silent':>6}  why "
        "not ok"
    )
    for (kind, quantity), tally in sorted(
        table.items(), key=lambda item: (item[0][0] != "all", item[0])
    ):
        held = f"{100 * tally.held / tally.ok:7.1f}" if tally.ok else "      -"
        why = ", ".join(f"{flag} {n}" for flag, n in tally.flags.most_common(4))
        print(
            f"{kind:<11} {quantity:<34} {tally.drawn:5} {100 * tally.ok / tally.drawn:6.1f} {held} "
            f"{len(tally.silent):6}  {why}"
        )
    for word in ("missed", "silent"):
        for (kind, quantity), tally in table.items():
            for sentence in getattr(tally, word) if kind == "all" else ():
                print(f"{word}: {quantity} {sentence}")


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
