"""A disk that is really full ends a session cleanly: what it took is whole, all else has its number
and reason.
"""

import json
import os
import shutil
import subprocess
import sys
import textwrap

import pytest

DISK_BYTES = 4 << 20

# A file system of its own, seen by this process alone, so that no rights are needed and nothing is
# left behind.
MOUNTED = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
CHILD = """
    import json, sys
    from pathlib import Path
    import numpy as np
    from labdata.capture import Frame
    from labdata.conditions import Conditions
    from labdata.errors import BadInput
    from labdata.session import open_session
    from labdata.session_writer import SessionWriter
    from labdata.storage_thread import Storage

    folder, said = Path(sys.argv[1]) / "s", None
    pixels = np.random.default_rng(1).integers(0, 4096, (200, 300), dtype=np.uint16)
    writer = SessionWriter.create(folder, name="full", sensor=None, bit_depth=12, interlaced=None)
    try:
        with Storage(writer) as storage:
            stack = storage.begin_stack("flat", "flat", pixels.shape, np.uint16, Conditions())
            for number in range(1, 101):
                stack.enqueue(Frame(pixels=pixels ^ number, number=number, time_s=float(number)))
                if number % 5 == 0:
                    storage.wait()
    except BadInput as error:
        said = str(error)
    entry = open_session(folder).stack("flat")
    read = entry.read()
    print(json.dumps({
        "said": said,
        "acknowledged": stack.acknowledged,
        "whole": [
            int(n)
            for n, frame in zip(read.frame_number, read.data)
            if (frame == pixels ^ int(n)).all()
        ],
        "finished": entry.finished,
        "lost": [(one.first, one.last, one.reason) for one in entry.losses],
    }))
"""


def on_a_small_disk(folder) -> dict:
    """Run the child on a file system of a few megabytes; skipped where nobody may mount one."""
    mount = f"mount -t tmpfs -o size={DISK_BYTES} none {folder}"
    if (
        shutil.which("unshare") is None
        or subprocess.run([*MOUNTED, mount], capture_output=True).returncode
    ):
        pytest.skip("nobody may mount a small disk here")
    child = [sys.executable, "-c", textwrap.dedent(CHILD), str(folder)]
    done = subprocess.run(
        [*MOUNTED, f'{mount} && exec "$@"', "sh", *child],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_what_a_full_disk_acknowledged_is_whole_and_the_rest_is_told(tmp_path):
    told = on_a_small_disk(tmp_path)
    assert "the disk must take every frame, got 'No space left on device'" in told["said"]
    assert not told["finished"]
    assert 5 < told["acknowledged"] < DISK_BYTES / 120_000
    assert told["whole"] == list(range(1, len(told["whole"]) + 1))
    assert len(told["whole"]) == told["acknowledged"]
    (first, last, reason), *_ = told["lost"]
    assert first == told["acknowledged"] + 1 and last <= told["acknowledged"] + 5
    assert "No space left" in reason
