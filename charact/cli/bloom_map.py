"""The bloom map as a file: a picture for people, or arrays for who fuses it with another picture."""

import io
from pathlib import Path

import numpy as np

from charact.method import Context
from labdata.errors import BadInput
from labdata.file_io import write_atomically
from labdata.measurement import Result
from labdata.session import Session


def write_bloom_map(session: Session, result: Result, context: Context, *, label: str | None, path: Path) -> None:
    """Write the bloom map of a stack of a session.

    Parameters
    ----------
    session, result
        The session and what `charact.bloom.measure` found in it.
    context
        Seed, full scale and pitches.
    label
        Stack; None: the scene, else the brightest point source.
    path
        A .png file with the frame, the map and its standard deviation, or an .npz file with the arrays `signal_dn`,
        `fraction`, `sd`, `blooming_dn`, `clipped` and `near_border`, shape (row, col), and the number `near_px`.

    Raises
    ------
    BadInput
        If the file is of another kind, the stack is not there, or the session told no halo.
    """
    if path.suffix.lower() not in (".png", ".npz"):
        raise BadInput(f"--map must name a .png or .npz file, got {path.name!r}")
    from charact.bloom.bloom_map import evidence_of, map_of

    found, signal = map_of(session, result, label=label, context=context)
    content = io.BytesIO()
    if path.suffix.lower() == ".npz":
        np.savez_compressed(
            content, signal_dn=signal.astype(np.float32), fraction=found.fraction, sd=found.sd,
            blooming_dn=found.blooming_dn, clipped=found.clipped, near_border=found.near_border, near_px=found.near_px,
        )  # fmt: skip
        write_atomically(path, content.getbuffer())
        return
    from charact.report.bloom_images import plot_bloom_map
    from charact.report.style import white_style

    with white_style():
        plot_bloom_map({**evidence_of(found, signal), "aspect": context.pitch_ratio}).savefig(
            content, format="png", dpi=130
        )
    write_atomically(path, content.getbuffer())
