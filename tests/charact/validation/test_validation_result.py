"""A verdict needs every statistic and both controls, and survives being kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from charact.validation import (
    FramePair,
    ResidualMap,
    Statistic,
    Validation,
    ValidationControl,
    ValidationFigures,
    load,
    save,
)
from labdata import BadInput


def _statistic(p_value: float, name: str = "noise") -> Statistic:
    return Statistic(
        name=name,
        title="Noise",
        distance=1.0,
        p_value=p_value,
        level=0.01,
        labels=("a",),
        measured=(1.0,),
        low95=(0.5,),
        high95=(1.5,),
    )


@pytest.fixture
def good() -> Validation:
    picture = np.arange(12, dtype=np.uint8).reshape(3, 4)
    pair = FramePair(
        role="dim flat",
        kind="flat",
        label="f",
        measured=picture,
        simulated=picture[::-1],
        low_dn=1.0,
        high_dn=9.0,
        frames=8,
    )
    return Validation(
        session="s",
        sensor="fitted",
        seed=3,
        draws=12,
        seconds=1.5,
        statistics=(_statistic(0.4), _statistic(0.2, "mtf")),
        controls=(
            ValidationControl(name="null", title="null", statistics=(_statistic(0.7),)),
            ValidationControl(
                name="negative", title="negative", statistics=(_statistic(0.9), _statistic(1e-9))
            ),
        ),
        figures=ValidationFigures(
            overlays={"mtf": {"curves": [{"x": [0.1], "measured": [0.9]}]}},
            pairs=(pair, replace(pair, label="g", measured=picture + 1)),
            blind=(replace(pair, simulated=picture + 2),),
            residuals=(
                ResidualMap(
                    role="dark",
                    label="d",
                    block_px=4,
                    difference_dn=np.eye(3, 4, dtype=np.float32),
                    sd_dn=0.3,
                ),
            ),
        ),
        notes=("a note",),
    )


def test_a_verdict_needs_every_statistic_and_both_controls(good: Validation) -> None:
    null, negative = good.controls
    failing, passing = (_statistic(0.001),), (_statistic(0.9),)
    assert good.passed
    assert not replace(good, statistics=(*good.statistics, *failing)).passed
    assert not replace(good, controls=(replace(null, statistics=failing), negative)).passed
    assert not replace(good, controls=(null, replace(negative, statistics=passing))).passed


def test_kept_and_read_back(good: Validation, tmp_path: Path) -> None:
    save(good, tmp_path)
    back = load(tmp_path)
    assert back is not None
    assert replace(back, figures=good.figures) == good
    assert back.figures.overlays == good.figures.overlays
    for name in ("pairs", "blind", "patterns", "residuals"):
        for kept, own in zip(getattr(back.figures, name), getattr(good.figures, name), strict=True):
            assert vars(kept).keys() == vars(own).keys()
            assert all(
                np.array_equal(vars(kept)[field], value) for field, value in vars(own).items()
            )
    assert back.passed


def test_none_kept_is_none_and_a_damaged_one_is_said_to_be(tmp_path: Path) -> None:
    assert load(tmp_path) is None
    (tmp_path / "validation.json").write_text("{")
    with pytest.raises(BadInput, match="validation kept by charact"):
        load(tmp_path)
