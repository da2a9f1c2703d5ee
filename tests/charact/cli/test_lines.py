"""What people read: of a session every number, of a picture a line for each target and one for all
together.
"""

import pytest

from charact.cli.demo_loop import lines
from charact.cli.output import print_result
from charact.reporting import compare_with_truth
from labdata import Measurement, Result, measurement_from_sd


def bars(col: int, **fields) -> Measurement:
    own = {
        "method": "bars-forward",
        "frequency_cy_per_px": 0.1,
        "region": (0, col, 20, 20),
        **fields,
    }
    return measurement_from_sd("mtf", "1", 0.8, 0.01, **own)


def together(note: str = "") -> Measurement:
    return measurement_from_sd(
        "mtf50", "cy/px", 0.21, 0.002, method="bars-joint", notes=(note,) if note else ()
    )


def test_a_session_with_targets_in_regions_prints_the_numbers_of_no_region_too(
    capsys: pytest.CaptureFixture,
) -> None:
    gain = measurement_from_sd("covariance_gain", "DN", 11.9, 0.1, method="covariance-sum")
    found = (
        gain,
        bars(0, stack="b1"),
        bars(40, stack="b2"),
        together("Stages: taken as known: pixel."),
    )
    print_result(Result(measurements=found), given="s", verb="v", as_json=False)
    told = " ".join(capsys.readouterr().out.split())
    pieces = (
        "covariance_gain 11.90",
        "b1 0,0,20,20",
        "b2 0,40,20,20",
        "mtf50 0.2100",
        "taken as known: pixel",
    )
    assert all(piece in told for piece in pieces)


def test_the_groups_of_a_picture_have_a_line_each_and_one_together(
    capsys: pytest.CaptureFixture,
) -> None:
    print_result(
        Result(measurements=(bars(0), bars(40), together())), given="f.tif", verb="v", as_json=False
    )
    first, second, third = capsys.readouterr().out.splitlines()
    assert "0,0,20,20" in first and "0,40,20,20" in second
    assert "all together" in third and "mtf50 0.21" in third


def test_sources_of_one_stack_are_told_apart_by_their_place(capsys: pytest.CaptureFixture) -> None:
    own = {"method": "one-frame", "stack": "spots"}
    spots = [
        measurement_from_sd("bloom_diameter", "px", 2.5, 0.1, region=(row, 9, 2, 3), **own)
        for row in (5, 60)
    ]
    halo = measurement_from_sd("halo_diameter", "px", 40.0, 0.1, **own)
    print_result(Result(measurements=(*spots, halo)), given="spots.tif", verb="v", as_json=False)
    _, first, second, third = capsys.readouterr().out.splitlines()
    assert "bloom_diameter" in first and "5,9,2,3" in first and "60,9,2,3" in second
    assert "halo_diameter" in third and "40.00" in third


def test_the_table_of_truths_tells_directions_apart() -> None:
    own = {"method": "point-forward", "stack": "point-3"}
    found = [
        measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, orientation_deg=angle, **own)
        for angle in (0.0, 90.0)
    ]
    _, along_rows, along_columns = lines(
        compare_with_truth(Result(measurements=tuple(found)), {"mtf50": 0.2})
    )
    assert along_rows.startswith("mtf50 along 0 deg ") and along_columns.startswith(
        "mtf50 along 90 deg "
    )
