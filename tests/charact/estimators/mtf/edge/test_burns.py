"""The plain estimator against the table that its author made of a real edge, on every colour
channel.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf import PreparedEdge, crossing_frequency, prepare_edge
from charact.estimators.mtf.edge import conventional as edge_slanted
from charact.method import Context
from labdata import FrameStack, read_frames

# Colour plane, as `--plane` takes it, and the column of the table.
CHANNELS = {"r": 1, "g": 2, "b": 3, "luminance": 4}
CONTEXT = Context(quick=True)


@pytest.fixture
def frame(shared_data):
    """One channel of one of the two frames, the second the first turned round."""
    pytest.importorskip("tifffile")
    return lambda name, plane: read_frames(shared_data / "burns_sfrmat3" / name, plane=plane)


@pytest.fixture
def table(shared_data):
    """Burns' own table of sfrmat3 for h_edge.tif: frequency in cy/px, then red, green, blue and
    luminance.
    """
    text = (shared_data / "burns_sfrmat3" / "me.xls").read_text(encoding="latin-1")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("%")]
    return np.array([[float(word) for word in line.split()] for line in lines])


def response_of(stack: FrameStack):
    edge = prepare_edge(stack, None, CONTEXT)
    assert isinstance(edge, PreparedEdge)
    return edge_slanted._estimate_slanted(edge.picture, edge.rows.line)


@pytest.mark.parametrize("name", ["h_edge.tif", "v_edge.tif"])
@pytest.mark.parametrize("plane", CHANNELS)
def test_the_author_s_whole_table_is_reproduced(frame, table, name, plane):
    """Acceptance: MTF50 within 1 % and RMS 0.003 over all frequencies of the table, to 1.004
    cy/px.
    """
    stack = frame(name, plane)
    reference, theirs = table[:, 0], table[:, CHANNELS[plane]]
    found = mtf.measure("edge", stack, method="edge-slanted", context=CONTEXT).find("mtf50")[0]
    assert found.status == "ok"
    assert found.value == pytest.approx(
        crossing_frequency(reference, theirs[None], 0.5)[0], rel=0.01
    )
    ours = response_of(stack)
    assert ours.frequency[1] == pytest.approx(reference[-1] / (len(reference) - 1), rel=1e-3)
    away = np.interp(reference, ours.frequency, ours.values[0]) - theirs
    print(
        f"{name} {plane}: MTF50 {found.value:.4f}, RMS {np.sqrt(np.mean(away**2)):.4f}, worst "
        f"{np.abs(away).max():.4f}"
    )
    assert np.sqrt(np.mean(away**2)) < 0.003


def test_all_eight_ways_to_turn_a_frame_give_the_same_numbers(frame):
    data = frame("h_edge.tif", "g").data[0]
    upright = response_of(FrameStack(data=data[None]))
    for turns in range(4):
        for turned in (np.rot90(data, turns), np.rot90(data, turns)[::-1]):
            other = response_of(FrameStack(data=np.ascontiguousarray(turned)[None]))
            assert np.abs(other.values[0] - upright.values[0]).max() < 1e-6
