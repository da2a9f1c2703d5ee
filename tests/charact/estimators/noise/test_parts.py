"""However a stack is cut and wherever it is read, its statistics are the same bytes, in little
memory.
"""

import shutil
import sys
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from charact.estimators.noise import read_levels
from charact.frames import stack_statistics
from charact.method.registry import parallel_map
from charact.session_measurement import method_context
from labdata import BadInput, Conditions, SessionWriter, open_session

SHAPE = (64, 96)
# More than one run of 32 frames, so that large stacks have several parts.
FRAMES = {"dark": 40, "flat-0": 70, "flat-1": 2}


@pytest.fixture(scope="module")
def session(tmp_path_factory, seed):
    """A session of the store: blurred noise above a pattern."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("spread") / "session"
    pattern = 5.0 * rng.standard_normal(SHAPE)
    with SessionWriter.create(folder, name="spread", bit_depth=12) as writer:
        for label, count in FRAMES.items():
            kind = "dark" if label == "dark" else "flat"
            with writer.begin_stack(label, kind, SHAPE, np.uint16, Conditions()) as stack:
                for number in range(count):
                    noise = gaussian_filter(
                        20.0 * rng.standard_normal(SHAPE), 0.7
                    ) + rng.standard_normal(SHAPE)
                    frame = 300.0 + 100.0 * (label != "dark") + pattern + noise
                    stack.append(np.rint(frame).astype(np.uint16), number / 30.0, number)
                stack.finish()
    return open_session(folder)


def same(one, two) -> bool:
    """Whether two values are equal to the last bit, the time they took aside."""
    if is_dataclass(one):
        names = [field.name for field in fields(one) if field.name != "seconds"]
        return type(one) is type(two) and all(
            same(getattr(one, name), getattr(two, name)) for name in names
        )
    if isinstance(one, np.ndarray):
        return one.dtype == two.dtype and one.tobytes() == two.tobytes()
    if isinstance(one, dict):
        return list(one) == list(two) and all(same(one[key], two[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(two) and all(map(same, one, two))
    return one == two


def levels(session, **more):
    darks, flats, single = read_levels(
        session,
        context=method_context(session, quick=True, seed=1, **more),
        spectra=True,
        cubes=True,
    )
    assert not single
    return darks + flats


def test_a_stack_larger_than_memory_has_the_statistics_of_one_that_is_not(session, monkeypatch):
    whole = levels(session)
    monkeypatch.setattr(stack_statistics, "WHOLE_BYTES", 0)
    assert same(levels(session), whole)


def test_two_workers_of_a_cluster_give_the_same_bytes(session, monkeypatch):
    distributed = pytest.importorskip(
        "distributed", reason="Dask is not installed: pip install 'charact[dask]'"
    )
    here = levels(session)
    monkeypatch.setattr(stack_statistics, "WHOLE_BYTES", 2**19)
    with (
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=50,
        ) as cluster,
        parallel_map(cluster.scheduler_address) as spread,
    ):
        assert same(levels(session, spread=spread), here)
        broken = replace(session.stacks[0], frames="frames/none")
        with pytest.raises(BadInput):
            list(spread(stack_statistics.part_statistics, [replace(_part(session), entry=broken)]))


def _part(session):
    context = method_context(session, quick=True, seed=1)
    return stack_statistics.Part(
        entry=session.stacks[0],
        runs=((0, 2),),
        cube=False,
        spectra=False,
        context=context,
        at_once=False,
    )


def test_a_frame_that_is_not_what_was_acknowledged_is_refused_part_by_part_too(
    session, tmp_path, monkeypatch
):
    copy = tmp_path / "copy"
    shutil.copytree(session.folder, copy)
    (chunk,) = (path for path in copy.rglob("c.35.0.0") if "dark" in path.parent.name)
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"x")
    monkeypatch.setattr(stack_statistics, "WHOLE_BYTES", 0)
    with pytest.raises(BadInput, match="frame 35"):
        levels(open_session(copy))


def test_what_is_no_address_of_a_scheduler_ends_in_one_sentence_before_there_is_a_client(
    monkeypatch,
):
    """A client without an address complains a second time when it is thrown away, with a
    traceback.
    """
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: pytest.fail("a client was made"))
    for address in ("nowhere", "", "tcp://127.0.0.1:99999", "tcp://127.0.0.1:9"):
        with pytest.raises(BadInput, match="running Dask scheduler"), parallel_map(address):
            pass


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInput, match=r"charact\[dask\]"), parallel_map("tcp://127.0.0.1:9"):
        pass
