"""Targets of one camera agree as often as promised; one that reads another MTF is found out."""

import numpy as np
import pytest

from charact.estimators.mtf import mtf_consistency
from labdata import Curve, Result, measurement_from_sd

FREQUENCIES = (0.08, 0.15, 0.25)
KINDS = {"a": "edge", "b1": "bars", "b2": "bars", "b3": "bars", "p": "point"}


def _result(
    rng: np.random.Generator, *, edge_offset: float = 0.0, edge_angle_deg: float = 5.0
) -> Result:
    frequency = np.linspace(0.0, 0.5, 26)
    truth = np.exp(-((frequency / 0.3) ** 1.3))

    def curve(stack: str, offset: float, sd: float) -> Curve:
        value = truth + offset + sd * rng.standard_normal()
        return Curve(
            frequency_cy_per_px=frequency,
            value=value,
            interval68=np.stack([value - sd, value + sd]),
            stack=stack,
        )

    bars = [
        measurement_from_sd(
            "mtf",
            "1",
            float(np.exp(-((f / 0.3) ** 1.3)) + 0.01 * rng.standard_normal()),
            0.01,
            method="fake",
            stack=f"b{n}",
            frequency_cy_per_px=f,
            orientation_deg=4.0,
        )
        for n, f in enumerate(FREQUENCIES, 1)
    ]
    tilt = measurement_from_sd(
        "mtf50", "cy/px", 0.2, 0.01, method="fake", stack="a", orientation_deg=edge_angle_deg
    )
    curves = {"mtf:a": curve("a", edge_offset, 0.005), "mtf:p": curve("p", 0.0, 0.02)}
    return Result(measurements=(*bars, tilt), curves=curves)


def _found(result: Result) -> dict:
    return mtf_consistency(result, KINDS).evidence["agreement of targets"]


def test_one_camera_agrees_with_itself_in_95_of_100_sessions_or_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 400
    inside = sum(_found(_result(rng))["inside_joint_95_percent_region"] for _ in range(count))
    assert inside / count > 0.95 - 3.5 * np.sqrt(0.95 * 0.05 / count)


@pytest.mark.parametrize("offset", [0.08, -0.08])
def test_an_edge_that_reads_another_mtf_is_found_out(offset: float, seed: int) -> None:
    found = _found(_result(np.random.default_rng(seed), edge_offset=offset))
    assert not found["inside_joint_95_percent_region"]
    assert found["largest_z"] > found["joint_95_percent_limit_z"]


def test_a_curve_along_another_direction_is_not_compared(seed: int) -> None:
    found = _found(_result(np.random.default_rng(seed), edge_angle_deg=85.0, edge_offset=0.3))
    assert set(found["pair"]) == {"bars - point"}


def test_a_target_alone_agrees_with_nothing() -> None:
    assert mtf_consistency(Result(), KINDS).evidence == {}
