"""Shared fixtures: the seed of every statistical test, chosen or taken from outside."""

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

# One thread a worker, as on the command line; it must be said before numpy is loaded.
for library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(library, "1")

# What a shell runs in the background is deaf to Ctrl-C, and so are its children, to which tests
# send one.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

DEFAULT_SEED = 20261121


# Tests, without their parameters, that take more than half a second of processor time, the
# processes that they start included (`pytest --durations=0` shows where to look).
SLOW = frozenset((Path(__file__).parent / "slow_tests.txt").read_text().split())
SLOW_FILES = frozenset(name.partition("::")[0] for name in SLOW)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers", "seeded: draws by chance, and holds for any seed; set by its fixture `seed`"
    )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file without a test of those asked for: a third of the time of collection where
    these are slow.
    """
    if not (collection_path.name.startswith("test_") and collection_path.name.endswith(".py")):
        return None
    asked, holds = config.option.markexpr, True
    if asked.startswith("slow"):
        holds = collection_path.relative_to(config.rootpath).as_posix() in SLOW_FILES
    elif asked == "wires":
        holds = "wires" in collection_path.read_text()
    return None if holds else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that `make test` leaves out, and those that another seed makes others."""
    for item in items:
        if item.nodeid.partition("[")[0] in SLOW:
            item.add_marker("slow")
        if "seed" in getattr(item, "fixturenames", ()):
            item.add_marker("seeded")


def pytest_report_header() -> str:
    return f"charact test seed: {test_seed()} (set CHARACT_TEST_SEED to choose another)"


def test_seed() -> int:
    return int(os.environ.get("CHARACT_TEST_SEED", DEFAULT_SEED))


test_seed.__test__ = False


@pytest.fixture(scope="session", autouse=True)
def bench_servers() -> Iterator[None]:
    """End the bench servers that still stand guard over instruments of a test that failed."""
    run = f"CHARACT_TEST_RUN={os.getpid()}"
    os.environ.update([run.split("=")])
    yield
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            is_server = b"drivers.bench.server" in (process / "cmdline").read_bytes()
            if is_server and run.encode() in (process / "environ").read_bytes().split(b"\0"):
                os.kill(int(process.name), signal.SIGTERM)


@pytest.fixture(scope="session")
def seed() -> int:
    """Seed of statistical tests; their tolerances hold for seeds that nobody chose."""
    return test_seed()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real frames made elsewhere; a test that needs them skips where they are absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real frames are not beside this checkout")
    return folder
