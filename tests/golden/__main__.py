"""Golden net: results and frames on fixed seeds, recorded once and compared after each change.

    python -m tests.golden record [SECTION ...]     write tests/golden/*.csv
    python -m tests.golden compare [SECTION ...]    table of what moved; exit 1 beyond a guard

Sections are `methods`, `frames`, `sensors` and `effects`; `methods:WORD` compares methods with the
word in their name. Guard of a method: value and interval within 0.1 of half the
68 % width (a quarter of the width of the 95 % interval), status equal in 99 % of the cases. Guard
of all others: equal digests.
"""

import csv
import hashlib
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
CASES = {
    "mtf50": 20,
    "mtf": 20,
    "covariance_gain": 4,
    "system_gain": 8,
    "post_gain_mtf50": 6,
    "halo_diameter": 6,
}
SENSORS = ("pulnix-ag5745ef3", "gen3-digital-iccd", "emccd-512")
LEVELS_PE = (0.0, 0.03, 0.5, 3.0, 40.0, 400.0)
SETTINGS = ((), ("--exact",), ("--error-budget", "0"), ("--temperature-c", "0"))
Row = tuple[str, ...]


def _cases_of(study, count: int) -> list:
    """Half in scope, half past the breaking point."""
    inside = study.chart_cases(45, count - count // 2)
    breaking = study.stability_cases(45, 1, study.axes)
    picked = np.random.default_rng(45).permutation(len(breaking))[: count // 2]
    return [*inside, *(breaking[i] for i in sorted(picked))]


def methods(word: str = "") -> list[Row]:
    """Every registered method, with a word in its name, of every quantity that has a study."""
    from benchmarks.studies.harness import attempt
    from benchmarks.studies.registry import methods_of, studies_of
    from charact.method import Context

    rows = []
    for quantity, count in CASES.items():
        for case in [case for study in studies_of(quantity) for case in _cases_of(study, count)]:
            for method in methods_of(quantity):
                if method.kind == case.kind and word in method.name:
                    row = attempt(method, case, Context(quick=True))
                    name = f"{quantity} {method.name} {case.kind} {case.name} {case.seed}"
                    numbers = [
                        "" if x is None else f"{x:.7g}" for x in (row.value, row.low95, row.high95)
                    ]
                    rows.append((name, *numbers, row.status, " ".join(row.flags)))
        print(quantity, len(rows), file=sys.stderr)
    return rows


def _charact(*arguments: str) -> str:
    done = subprocess.run(
        [str(Path(sys.executable).with_name("charact")), *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout if done.returncode == 0 else f"exit {done.returncode}: {done.stderr}"


def _digest_of(session: Path) -> str:
    from labdata import open_session

    digest = hashlib.sha256()
    for stack in open_session(session).stacks:
        digest.update(np.ascontiguousarray(stack.read().data).tobytes())
    return digest.hexdigest()


def _picture(folder: str) -> Path:
    """Write an image of a ramp with a bright square."""
    ramp = np.linspace(0.0, 1.0, 96)[:, None] * np.linspace(0.2, 1.0, 128)[None]
    ramp[40:44, 60:64] = 8.0
    np.save(path := Path(folder, "picture.npy"), ramp)
    return path


def frames() -> list[Row]:
    """SHA-256 of simulated frames: cameras by levels by settings."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        picture = _picture(scratch)
        for sensor in SENSORS:
            for level in LEVELS_PE:
                for number, setting in enumerate(SETTINGS):
                    out = Path(scratch, f"{sensor}-{level}-{number}")
                    said = _charact(
                        "simulate",
                        str(picture),
                        str(out),
                        "--sensor",
                        sensor,
                        "--frames",
                        "2",
                        "--seed",
                        "45",
                        "--photoelectrons-per-dn",
                        str(level),
                        *setting,
                    )
                    done = (
                        _digest_of(out)
                        if out.is_dir()
                        else hashlib.sha256(said.encode()).hexdigest()
                    )
                    rows.append((f"{sensor} {level:g} {' '.join(setting)}", done))
    return rows


def sensors() -> list[Row]:
    """SHA-256 of each sensor description, read and written again."""
    from labdata import load_camera, save_sensor

    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in SENSORS:
            save_sensor(load_camera(name), path := Path(scratch, f"{name}.toml"))
            rows.append((name, hashlib.sha256(path.read_bytes()).hexdigest()))
    return rows


def effects() -> list[Row]:
    """Numbers that `--explain` prints, by sensor and light; times are left out."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        picture = _picture(scratch)
        for sensor in SENSORS:
            for level in LEVELS_PE:
                said = _charact(
                    "simulate",
                    str(picture),
                    str(Path(scratch, f"{sensor}{level}")),
                    "--sensor",
                    sensor,
                    "--frames",
                    "1",
                    "--photoelectrons-per-dn",
                    str(level),
                    "--explain",
                )
                rows.append((f"{sensor} {level:g}", " ".join(re.findall(r"\d[\d.e+-]* ?%", said))))
    return rows


SECTIONS = {"methods": methods, "frames": frames, "sensors": sensors, "effects": effects}


def record(name: str) -> None:
    with (HERE / f"{name}.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(SECTIONS[name]())


def compare(section: str) -> bool:
    """Print what moved; whether all stays within its guard."""
    name, _, word = section.partition(":")
    with (HERE / f"{name}.csv").open(newline="") as file:
        before = {row[0]: tuple(row[1:]) for row in csv.reader(file)}
    if word:
        before = {key: row for key, row in before.items() if word in key.split()[1]}
    after = {row[0]: row[1:] for row in (methods(word) if word else SECTIONS[name]())}
    missing, added = before.keys() - after.keys(), after.keys() - before.keys()
    changed = [key for key in before if key in after and before[key] != after[key]]
    print(
        f"\n{name}: {len(before)} rows, {len(changed)} changed, {len(missing)} missing, "
        f"{len(added)} added"
    )
    if name != "methods":
        for key in changed[:20]:
            print(f"  {key}: {before[key]} -> {after[key]}")
        return not changed and not missing
    good = not missing
    tally: dict[str, Counter] = defaultdict(Counter)
    for key in before:
        if key not in after:
            continue
        method = " ".join(key.split()[:2])
        tally[method]["cases"] += 1
        if before[key] != after[key]:
            tally[method]["changed"] += 1
        tally[method]["status"] += before[key][3] != after[key][3]
        if _beyond(before[key], after[key]):
            tally[method]["beyond"] += 1
            print(f"  {key}: {' '.join(before[key])} -> {' '.join(after[key])}")
    for method, count in tally.items():
        if count["changed"]:
            print(f"{method:45} {dict(count)}")
        good &= not count["beyond"] and count["status"] <= 0.01 * count["cases"] + 0.5
    return good


def _beyond(before: Row, after: Row) -> bool:
    if "" in before[:3] or "" in after[:3]:
        return before[:3] != after[:3] and before[3] == after[3]
    old, new = np.array(before[:3], float), np.array(after[:3], float)
    if not (np.isfinite(old).all() and np.isfinite(new).all()):
        return before[:3] != after[:3]
    half = max(abs(old[2] - old[1]) / 4.0, 1e-12)
    return bool(np.any(np.abs(old - new) > 0.1 * half))


if __name__ == "__main__":
    verb, chosen = sys.argv[1], sys.argv[2:] or list(SECTIONS)
    if verb == "record":
        for section in chosen:
            record(section)
    else:
        good = [compare(section) for section in chosen]
        sys.exit(0 if all(good) else 1)
