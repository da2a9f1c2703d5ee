"""Photometric files: what they say is what shines; whatever else is in them, they are refused in a
sentence.
"""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from labdata import BadInput
from simulate.radiance.lamps import parse_photometry, read_ies
from simulate.radiance.outdoor import BuiltScene
from tests.simulate.radiance.test_scenes import BALL, CAMERA, GREY, scene_of

EXAMPLES = int(os.environ.get("CHARACT_FUZZ_EXAMPLES", "200"))
# A street lamp of two intensities: 100 cd down, 200 cd at 60 deg on the side of C0, none beyond 90.
STREET = """IESNA:LM-63-2002
[TEST] none
[MANUFAC] none
TILT=NONE
1 1000 1.0 4 3 1 2 0.3 0.3 0.0
1.0 1.0 50
0 60 90 180
0 90 180
100 200 0 0
100, 100, 0, 0
100 50
0 0
"""


def at(polar_deg: float, azimuth_deg: float) -> np.ndarray:
    down, turn = np.deg2rad([polar_deg, azimuth_deg])
    return np.array([[np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.cos(down)]])


def candela(lamp, polar_deg: float, azimuth_deg: float) -> float:
    return float(lamp.lumens * lamp.table.per_sr(at(polar_deg, azimuth_deg))[0])


def test_intensities_are_those_of_the_file():
    lamp = parse_photometry(STREET)
    assert [candela(lamp, 60.0, turn) for turn in (0.0, 90.0, 180.0, 270.0)] == pytest.approx(
        [200, 100, 50, 100]
    )
    assert candela(lamp, 0.0, 0.0) == pytest.approx(100.0)
    assert candela(lamp, 120.0, 0.0) == 0.0


def test_a_source_of_100_candela_all_around_has_400_pi_lumens():
    even = "TILT=NONE\n1 -1 2.0 2 1 1 1 0 0 0\n0.5 1 0\n0 180\n0\n100 100\n"
    assert parse_photometry(even).lumens == pytest.approx(400.0 * np.pi, rel=1e-6)


def test_tilt_that_changes_nothing_is_read_and_one_that_does_is_refused():
    with_tilt = STREET.replace("TILT=NONE", "TILT=INCLUDE\n1\n2\n0 90\n1 {}")
    assert parse_photometry(with_tilt.format("1.0")).lumens == pytest.approx(
        parse_photometry(STREET).lumens
    )
    with pytest.raises(BadInput, match=r"must not depend on its tilt, got factors of 0\.8"):
        parse_photometry(with_tilt.format("0.8"))


def test_a_lamp_given_from_90_to_270_degrees_is_the_same_on_both_sides():
    turned = STREET.replace("\n0 90 180\n", "\n90 180 270\n")
    lamp = parse_photometry(turned)
    assert [candela(lamp, 60.0, turn) for turn in (90.0, 180.0, 270.0)] == pytest.approx(
        [200, 100, 50]
    )
    assert candela(lamp, 60.0, 0.0) == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("TILT=NONE\n", "", "must have a line TILT="),
        ("TILT=NONE", "TILT=lamp.tlt", "TILT must be NONE or INCLUDE, got 'TILT=lamp.tlt'"),
        ("4 3 1 2 0.3", "4 3 2 2 0.3", r"must be of type C \(1\), got 2"),
        ("4 3 1 2 0.3", "4 3 1 3 0.3", "must be 1 .feet. or 2 .metres., got 3"),
        ("1 1000 1.0", "1 1000 0", "candela multiplier must be positive"),
        ("4 3 1 2", "4e9 3 1 2", "number of vertical angles must be whole and within 1 to"),
        ("100 50\n0 0\n", "100 50\n", "must hold 12 numbers for candela, got 10"),
        ("100 50\n0 0\n", "100 50\n0 0 7\n", "must end after its candela, got 1 more"),
        ("100 200 0 0", "100 nan 0 0", "candela must be finite"),
        ("100 200 0 0", "100 two 0 0", "candela must be numbers"),
        ("100 200 0 0", "100 -200 0 0", "candela must be finite, not negative"),
        ("0 60 90 180", "0 60 50 180", "must ascend"),
        ("0 90 180\n100", "0 90 170\n100", "azimuth_deg must ascend from 0 to 0, 90, 180 or 360"),
    ],
)
def test_a_bad_file_is_refused_in_a_sentence(tmp_path, old, new, says):
    assert old in STREET
    path = tmp_path / "lamp.ies"
    path.write_text(STREET.replace(old, new, 1))
    with pytest.raises(BadInput, match=says):
        read_ies(path)


@settings(max_examples=EXAMPLES, deadline=None)
@given(
    some.one_of(
        some.text(max_size=200),
        some.lists(
            some.tuples(some.integers(0, len(STREET) - 1), some.characters(max_codepoint=255)),
            max_size=8,
        ).map(
            lambda changes: "".join(
                dict(changes).get(place, letter) for place, letter in enumerate(STREET)
            )
        ),
        some.lists(some.sampled_from([*STREET.split(), "\n", "-1", "1e400"]), max_size=60).map(
            " ".join
        ),
    )
)
def test_whatever_a_file_holds_it_is_a_lamp_or_a_sentence(text):
    try:
        lamp = parse_photometry(text)
    except BadInput as error:
        assert "\n" not in str(error) and len(str(error)) < 300
    else:
        assert np.isfinite(lamp.lumens) and lamp.lumens > 0.0


def test_a_measured_lamp_in_a_scene_has_the_lumens_of_its_file_and_shines_where_it_is_turned(
    tmp_path,
):
    (tmp_path / "street.ies").write_text(STREET)
    lamp = (
        '[[lamp]]\nlabel = "a"\nkind = "led-warm"\nbeam = "street.ies"\nposition_m = [0, 0, '
        "5]\nheading_deg = 90\n"
    )
    site = BuiltScene(scene_of(tmp_path, CAMERA + GREY + BALL + lamp))
    light = site.on(np.array([500.0, 600.0])).lighting.lamps[0]
    assert site.lamps[0][1].flux.lumens == pytest.approx(parse_photometry(STREET).lumens)
    east, north, west = (
        light.per_sr(np.array([[x, y, -0.5]]))[0] for x, y in ((0.866, 0), (0, 0.866), (-0.866, 0))
    )
    assert [east, north, west] / east == pytest.approx([1.0, 0.5, 0.25], rel=1e-3)
