"""What one target of a session tells is known when the next is measured."""

from pathlib import Path

import numpy as np
import pytest

from charact.measuring import _knowing_halo, measure
from charact.method import Context
from charact.study.edge.scene import EdgeScene
from labdata.measurement import Result, from_sd, refused
from labdata.sensors import load_sensor


@pytest.fixture
def context() -> Context:
    return Context(sensor=load_sensor("pulnix-ag5745ef3"))


def test_a_halo_of_four_gaps_sets_the_gap(context: Context) -> None:
    halo = from_sd("halo_diameter", "px", 48.0, 0.1, method="series-forward")
    gap = _knowing_halo(context, Result(measurements=(halo,))).sensor.photocathode.gap_mm
    mm_per_px = 11.0e-3 * float(context.sensor.taper.demagnification)
    assert gap.value == pytest.approx(48.0 * mm_per_px / 4.0, rel=1e-12)
    assert gap.high - gap.low == pytest.approx(2 * 1.959964 * 0.1 * mm_per_px / 4.0, rel=1e-5)


@pytest.mark.parametrize(
    "halo",
    [
        refused("halo_diameter", "px", "no halo", method="series-forward"),
        from_sd("halo_diameter", "px", 48.0, 0.1, method="series-forward", flags=("saturated",)),
    ],
)
def test_a_halo_that_is_not_sound_tells_nothing(context: Context, halo) -> None:
    assert _knowing_halo(context, Result(measurements=(halo,))) is context


def edge_and_dark(folder: Path, volts: int, seed: int) -> None:
    """Keep a session of an edge at 700 V and a dark in a folder."""
    rng = np.random.default_rng(seed)
    np.save(folder / "edge.npy", EdgeScene(rows=90, cols=90, snr=60.0).frames_drawn(rng).data)
    np.save(folder / "dark.npy", rng.poisson(10.0, (4, 90, 90)).astype(np.uint8))
    stacks = (("edge", 700), ("dark", volts))
    (folder / "session.toml").write_text(
        'name = "s"\n'
        + "".join(
            f'[[stack]]\nlabel = "{kind}"\nkind = "{kind}"\nframes = "{kind}.npy"\nmcp_v = {voltage}\n'
            for kind, voltage in stacks
        )
    )


def test_what_an_analysis_says_of_its_progress_is_told_within_its_part(tmp_path: Path, seed: int) -> None:
    edge_and_dark(tmp_path, 700, seed)
    told: list[tuple[str, float]] = []
    measure(tmp_path, quick=True, progress=lambda sentence, share: told.append((sentence, share)))
    sentences = [sentence for sentence, _ in told]
    edge = sentences.index("MTF of edge")
    assert sentences[:2] == ["noise against gain", "noise of dark"]
    assert all(0.0 <= share < 0.5 for _, share in told[:edge])
    assert all(0.5 <= share <= 1.0 for _, share in told[edge:])


@pytest.mark.parametrize(("volts", "known"), [(700, True), (720, False)])
def test_the_dark_under_an_edge_s_settings_is_its_black(tmp_path: Path, volts: int, known: bool, seed: int) -> None:
    edge_and_dark(tmp_path, volts, seed)
    (mtf50,) = [m for m in measure(tmp_path, quick=True).find("mtf50") if m.stack == "edge"]
    dark = np.load(tmp_path / "dark.npy").mean()
    assert (f"No light is at {dark:.4g} DN." in mtf50.notes) == known
    assert any(note.startswith("No light") for note in mtf50.notes) == known
