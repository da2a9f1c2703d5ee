"""Curves and pictures of a validation hold what the frames hold, beside a band of the simulated
sets.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.method import Context
from charact.validation import MatchedFrames, MatchedStacks, features_of, figure_data
from charact.validation import frames as frames_of_stacks
from labdata import Conditions, FrameStack, Kind, Target
from tests.truth.sessions import session_in_memory, stack_in_memory

SHAPE, FRAMES, DRAWS = (48, 64), 8, 6
CYCLES = 10  # of the hum over the height of a frame


def _shot(label: str, kind: Kind, lux: float | None = None) -> MatchedFrames:
    return MatchedFrames(
        label=label,
        kind=kind,
        conditions=Conditions(illuminance_lux=lux),
        target=Target(),
        frames=FRAMES,
        corner=(0, 0),
        shape=SHAPE,
    )


@pytest.fixture(scope="module")
def chosen() -> MatchedStacks:
    return MatchedStacks(
        dark=_shot("dark", "dark"),
        flats=(_shot("low", "flat", 1.0), _shot("high", "flat", 4.0)),
        edge=None,
        point=_shot("source", "point", 9.0),
        display_only=(),
        measured={},
        notes=(),
    )


def _frames(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng([seed, 31])
    y, x = np.indices(SHAPE)
    source = 400.0 * np.exp(-0.5 * ((y - 24.0) ** 2 + (x - 32.0) ** 2) / 3.0**2)
    means = {"dark": 20.0, "low": 40.0, "high": 100.0, "source": 20.0 + source}
    sds = {"dark": 2.0, "low": 4.0, "high": 8.0, "source": 3.0}
    return {
        name: mean + rng.normal(0.0, sds[name], (FRAMES, *SHAPE)) for name, mean in means.items()
    }


@pytest.fixture(scope="module")
def simulated(seed: int) -> list[dict[str, np.ndarray]]:
    return [_frames(seed + 1 + number) for number in range(DRAWS)]


def test_the_cuts_of_white_noise_are_its_variance_and_hum_stands_at_its_frequency(
    chosen: MatchedStacks, seed: int
) -> None:
    frames = _frames(seed)
    hum = 1.5 * np.sin(2.0 * np.pi * CYCLES * np.arange(SHAPE[0]) / SHAPE[0])
    sign = np.where(np.arange(FRAMES) % 2, 1.0, -1.0)  # In turns, so that the mean frame has none.
    frames["dark"] = frames["dark"] + sign[:, None, None] * hum[:, None]
    curves = figure_data.curves_of(frames, chosen, ())
    for cut, frequencies in (
        (curves.horizontal["high"], SHAPE[1] // 2),
        (curves.vertical["high"], SHAPE[0] // 2),
    ):
        count = frequencies // figure_data.NEIGHBOURS
        assert len(cut) == count
        # Each of the count x NEIGHBOURS powers is a chi-squared of two degrees a frame less the
        # mean: relative sd 1 / root(frames - 1).
        error = 64.0 / np.sqrt((FRAMES - 1) * count * figure_data.NEIGHBOURS)
        assert cut.mean() == pytest.approx(64.0, abs=4.0 * error)
    assert int(np.argmax(curves.vertical["dark"])) == (CYCLES - 1) // figure_data.NEIGHBOURS
    # A sine of amplitude a in a cut of one frame: a^2 rows cols / 4 at its frequency, over the
    # averaged neighbours.
    power = 1.5**2 * SHAPE[0] * SHAPE[1] / 4.0 * FRAMES / (FRAMES - 1) / figure_data.NEIGHBOURS
    assert curves.vertical["dark"].max() == pytest.approx(power, rel=0.1)


def test_the_histogram_counts_every_value_and_the_ends_hold_all_beyond(
    chosen: MatchedStacks, seed: int
) -> None:
    frames = _frames(seed)
    frames["dark"][0, :3, 0] += 1000.0
    counts = figure_data.curves_of(frames, chosen, ()).counts
    assert counts["dark"].sum() == counts["high"].sum() == FRAMES * SHAPE[0] * SHAPE[1]
    assert counts["dark"][-1] == 3
    within = (
        counts["high"][(figure_data.BINS_SD[:-1] >= -1.0) & (figure_data.BINS_SD[1:] <= 1.0)].sum()
        / counts["high"].sum()
    )
    # Values less their mean frame are nearly Gaussian: 68.27 %, with the binomial error of that
    # many values.
    assert within == pytest.approx(
        0.6827, abs=4.0 * np.sqrt(0.6827 * 0.3173 / counts["high"].sum())
    )


def test_a_residual_is_where_the_frames_differ_and_its_sd_is_that_of_a_mean_of_pixels(
    chosen: MatchedStacks, simulated: list[dict[str, np.ndarray]], seed: int
) -> None:
    measured = _frames(seed)
    measured["high"] = measured["high"] + 0.0
    measured["high"][:, 8:16, 16:24] += 20.0
    found = _figures(chosen, measured, simulated, seed)
    residual = next(one for one in found.residuals if one.role == "bright flat")
    assert residual.difference_dn.shape == (
        SHAPE[0] // figure_data.BLOCK_PX,
        SHAPE[1] // figure_data.BLOCK_PX,
    )
    expected = 8.0 / np.sqrt(FRAMES * figure_data.BLOCK_PX**2) * np.sqrt(1.0 + 1.0 / DRAWS)
    blocks = residual.difference_dn.size
    assert residual.sd_dn == pytest.approx(expected, rel=4.0 / np.sqrt(2.0 * blocks * (DRAWS - 1)))
    inside = residual.difference_dn[2:4, 4:6]
    assert np.all(np.abs(inside - 20.0) < 5.0 * residual.sd_dn)
    assert np.sum(np.abs(residual.difference_dn) > 6.0 * residual.sd_dn) == inside.size


def test_bands_hold_a_set_of_the_same_kind(
    chosen: MatchedStacks, simulated: list[dict[str, np.ndarray]], seed: int
) -> None:
    found = _figures(chosen, _frames(seed), simulated, seed)
    assert {"noise-spectrum-horizontal", "histogram-flat", "point", "photon-transfer"} <= set(
        found.overlays
    )
    assert "mtf" not in found.overlays
    curves = [curve for one in found.overlays.values() for curve in one["curves"]]
    inside = [
        low <= value <= high
        for curve in curves
        for low, value, high in zip(curve["low95"], curve["measured"], curve["high95"], strict=True)
    ]
    # Bands of six sets hold fewer than 95 % of Student's t of five degrees: 91 %.
    assert np.mean(inside) > 0.91 - 4.0 * np.sqrt(0.91 * 0.09 / len(inside))


def test_the_blind_pair_is_another_frame_than_the_pairs_show(
    chosen: MatchedStacks, simulated: list[dict[str, np.ndarray]], seed: int
) -> None:
    found = _figures(chosen, _frames(seed), simulated, seed)
    assert [pair.role for pair in found.pairs] == [
        "dark",
        "dim flat",
        "bright flat",
        "point source",
    ]
    blind = found.blind[0]
    shown = next(pair for pair in found.pairs if pair.label == blind.label)
    assert not np.array_equal(shown.measured, blind.measured)
    assert not np.array_equal(shown.simulated, blind.simulated)
    alone = replace(chosen, flats=chosen.flats[-1:], point=None)
    assert [one.role for one in _figures(alone, _frames(seed), simulated, seed).residuals] == [
        "dark",
        "bright flat",
    ]


def test_levels_of_the_point_source_span_the_dim_to_the_bright(chosen: MatchedStacks) -> None:
    light = (0.5, 8.0, 2.0, 1.0, 4.0, None, 9.0)
    stacks = tuple(
        stack_in_memory(
            "point",
            FrameStack(data=np.zeros((FRAMES, *SHAPE), np.uint8)),
            Conditions(illuminance_lux=lux),
            label="source" if lux == 9.0 else f"at {lux}",
        )
        for lux in light
    )
    session = session_in_memory(stacks, bit_depth=8)
    levels, frames = frames_of_stacks.point_levels(session, chosen)
    assert [shot.label for shot in levels] == ["at 0.5", "at 2.0", "at 8.0"]
    assert {data.shape[1:] for data in frames.values()} == {SHAPE}
    assert frames_of_stacks.point_levels(session, replace(chosen, point=None)) == ((), {})


def _figures(chosen: MatchedStacks, measured: dict, simulated: list[dict], seed: int):
    context = Context(seed=seed, quick=True, interlaced=False, full_scale_dn=4095.0)
    features = [features_of(frames, chosen, context=context) for frames in (measured, *simulated)]
    curves = [figure_data.curves_of(frames, chosen, ()) for frames in simulated]
    return figure_data.figures_of(
        chosen, (), (measured, features[0]), (simulated[0], features[1:], curves), seed=seed
    )
