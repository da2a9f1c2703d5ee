"""Dose of a tube, screen charge and hours at gain, and the ledger that accumulates it."""

import fcntl
import json
import math
import os
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path

from labdata.camera.description import Camera
from labdata.camera.tube import TubeLimits
from labdata.errors import BadInput, check
from labdata.file_io import ends_mid_line, sync_folder, write_whole


@dataclass(frozen=True, kw_only=True)
class Dose:
    """Accumulated load of a tube."""

    screen_c_per_cm2: float = 0.0  #: Charge through the brightest large area of the screen, C/cm2
    #: Charge through the images of pinholes, as if all fell on one point, C/cm2
    point_c_per_cm2: float = 0.0
    hours_at_gain: float = 0.0  #: Time with high voltage across the MCP, h
    #: Standard uncertainty of the logarithm of both charges, from those of photocathode sensitivity
    #: and MCP gain
    log_sd: float = 0.0

    def __post_init__(self) -> None:
        check(self, not_negative=(item.name for item in fields(self)))

    @property
    def charge_c_per_cm2(self) -> float:
        """Largest charge through any point of the phosphor, C/cm2."""
        return self.screen_c_per_cm2 + self.point_c_per_cm2

    @property
    def factor95(self) -> float:
        """Factor of the 95 % interval of the charge."""
        return math.exp(1.96 * self.log_sd)


def total_dose(doses: Iterable[Dose]) -> Dose:
    """Return the total of several doses; their relative error is common to all, so it does not
    average out.
    """
    doses = tuple(doses)
    charge = sum(dose.charge_c_per_cm2 for dose in doses)
    weighted = sum(dose.charge_c_per_cm2 * dose.log_sd for dose in doses)
    return Dose(
        screen_c_per_cm2=sum(dose.screen_c_per_cm2 for dose in doses),
        point_c_per_cm2=sum(dose.point_c_per_cm2 for dose in doses),
        hours_at_gain=sum(dose.hours_at_gain for dose in doses),
        log_sd=weighted / charge if charge else max((dose.log_sd for dose in doses), default=0.0),
    )


def dose_of(
    *, delivered_na_per_cm2: float, lit_s: float, at_gain_s: float, point: bool, log_sd: float
) -> Dose:
    """Return the dose of light for `lit_s` and high voltage for `at_gain_s` at one current density
    of the phosphor.
    """
    charge = delivered_na_per_cm2 * 1e-9 * lit_s
    return Dose(
        screen_c_per_cm2=0.0 if point else charge,
        point_c_per_cm2=charge if point else 0.0,
        hours_at_gain=at_gain_s / 3600.0,
        log_sd=log_sd,
    )


def warnings(dose: Dose, sensor: Camera | None) -> tuple[str, ...]:
    """Return one sentence for each part of a tube's life that is nearly used up."""
    limits = TubeLimits() if sensor is None else sensor.limits
    sentences = [
        _life_warning(
            "screen charge", dose.charge_c_per_cm2, float(limits.screen_charge_c_per_cm2), "C/cm2"
        ),
        None
        if sensor is None
        else _life_warning("time at gain", dose.hours_at_gain, float(sensor.tube.life_h), "h"),
    ]
    return tuple(sentence for sentence in sentences if sentence)


def _life_warning(what: str, amount: float, life: float, unit: str) -> str | None:
    if amount < 0.8 * life:  # Fraction of a tube's expected life at which a warning is given
        return None
    return (
        f"The tube's {what} is {amount:.3g} {unit}, {amount / life:.0%} of the {life:g} {unit} "
        f"expected of its life."
    )


FOLDER_VARIABLE = "CHARACT_TUBES"  # Environment variable with another folder for the ledgers
PATIENCE_S = 2.0  # Longest wait for the lock of a ledger, s; an append holds it for milliseconds
LOOK_S = 0.02  # Time between two tries for the lock, s


def ledger_of(tube: str) -> "DoseLedger":
    """Return the ledger of a tube by its name, in the user's data folder."""
    if not tube or tube.startswith(".") or set(tube) & set("/\\\0"):
        raise BadInput(
            f"a tube's name must be a file name without slashes or a leading dot, got {tube!r}"
        )
    data = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    folder = os.environ.get(FOLDER_VARIABLE) or Path(data) / "charact" / "tubes"
    return DoseLedger(Path(folder) / f"{tube}.jsonl")


class DoseLedger:
    """Doses of one tube, in a file that is made with its folder at the first dose."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def append(self, dose: Dose, **said: object) -> None:
        """Add a dose, on the disk when this returns, with further keys of the line; OSError if the
        disk refuses.
        """
        values = {item.name: getattr(dose, item.name) for item in fields(Dose)}
        line = (
            json.dumps({"time": datetime.now(UTC).isoformat(timespec="seconds"), **values, **said})
            + "\n"
        )
        new = not self.path.exists()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with open(self.path, "ab+", buffering=0) as file:
            _lock(file.fileno())
            # A power cut may have left an incomplete line: the new line must not continue it.
            write_whole(
                file.fileno(), (b"\n" if ends_mid_line(file.fileno()) else b"") + line.encode()
            )
            os.fsync(file.fileno())
        if new:
            sync_folder(self.path.parent)

    def total(self) -> Dose:
        """Return the total dose; zero where there is no ledger yet."""
        return total_dose(self._doses())

    def __len__(self) -> int:
        """Number of doses so far."""
        return sum(1 for _ in self._doses())

    def _doses(self) -> Iterator[Dose]:
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:
            return
        except OSError as error:
            raise BadInput(
                f"a dose ledger must be a readable file, got {self.path}: {error.strerror}"
            ) from None
        for number, line in enumerate(data.split(b"\n"), 1):
            if line.strip() and (dose := self._dose(line, number)) is not None:
                yield dose

    def _dose(self, line: bytes, number: int) -> Dose | None:
        """Return the dose of a line; None if the line is truncated."""
        try:
            values = json.loads(line)
        except RecursionError:
            raise self._damage_error(number) from None
        except ValueError:
            if line.startswith(b"{") and not line.rstrip().endswith(b"}"):
                return None
            raise self._damage_error(number) from None
        try:
            return Dose(**{item.name: float(values[item.name]) for item in fields(Dose)})
        except (KeyError, TypeError, ValueError, OverflowError):
            raise self._damage_error(number) from None

    def _damage_error(self, number: int) -> BadInput:
        return BadInput(
            f"every line of a dose ledger must hold a dose, got another in line {number} of "
            f"{self.path}"
        )


def _lock(descriptor: int) -> None:
    """Lock a ledger; TimeoutError if another process keeps the lock.

    The lock belongs to the open file; a lock of the process would end when a reader in this process
    closes the file.
    """
    until_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > until_s:
                raise TimeoutError(
                    f"another process has locked it for more than {PATIENCE_S:g} s"
                ) from None
            time.sleep(LOOK_S)
