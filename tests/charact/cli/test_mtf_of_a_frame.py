"""`charact mtf` on a whole frame: each target its region, units at detector and cathode, and the
annotated picture.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.special import erf

from charact.reporting import (
    VERDICT_COLOURS,
    FrequencyUnit,
    place_captions,
    render_annotations,
    unusable_edges,
)
from labdata import BadInput, FrameStack, load_camera, make_measurement, make_refusal
from labdata import Result as Measured
from tests.charact.cli.runner import assert_one_sentence, charact, json_of
from tests.truth import EdgeScene, TrueBlur


@pytest.fixture(scope="module")
def two_edges(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of one edge each, side by side, with even ground between them."""
    rng = np.random.default_rng(0)
    one = EdgeScene(rows=120, cols=120, snr=60.0).frames_drawn(rng).data[0]
    # The mirrored twin goes from bright to dark, so that the frame is whole where they meet.
    path = tmp_path_factory.mktemp("frame") / "two.npy"
    np.save(path, np.concatenate([one, one[:, ::-1]], axis=1))
    return path


def test_each_edge_of_a_frame_has_its_region_and_its_curve(two_edges: Path) -> None:
    document = json_of("mtf", "edge", two_edges, "--quick", "--method", "edge-slanted")
    regions = {tuple(m["region"]) for m in document["measurements"]}
    assert len(regions) == 2
    assert {"mtf", *(f"mtf:{','.join(map(str, region))}" for region in regions)} == set(
        document["curves"]
    )
    left, right = sorted(regions, key=lambda region: region[1])
    assert left[1] + left[3] <= 185
    assert right[1] >= 55


def test_each_edge_has_its_conventional_sfr_beside_its_mtf(two_edges: Path) -> None:
    document = json_of("mtf", "edge", two_edges, "--quick", "--also", "sfr")
    alone = json_of("mtf", "edge", two_edges, "--quick", "--method", "edge-slanted")
    found = [m["value"] for m in document["measurements"] if m["quantity"] == "sfr50"]
    assert found == [m["value"] for m in alone["measurements"] if m["quantity"] == "mtf50"]
    assert {"sfr", "mtf"} < set(document["curves"])
    assert_one_sentence(charact("mtf", "edge", two_edges, "--also", "fsr"), "--also", "'fsr'")


def test_a_black_level_above_the_dark_side_is_not_believed_and_said(two_edges: Path) -> None:
    """The dark side lies at 40 DN, the bright one at 190."""
    asked = (
        "mtf",
        "edge",
        two_edges,
        "--quick",
        "--method",
        "edge-slanted",
        "--roi",
        "0,0,120,110",
    )
    without, above = (json_of(*asked, *more) for more in ((), ("--black-dn", "100")))
    said = "The black level of 100 DN is above the edge's dark side at 40"
    assert any(
        note.startswith(said) and note.endswith("it is not used.")
        for note in above["measurements"][0]["notes"]
    )
    assert [m["value"] for m in above["measurements"]] == [
        m["value"] for m in without["measurements"]
    ]


@pytest.mark.parametrize("black", ["nan", "-inf", "4000"])
def test_a_black_level_that_is_none_is_one_sentence(two_edges: Path, black: str) -> None:
    done = charact("mtf", "edge", two_edges, "--quick", "--black-dn", black)
    below = "--black-dn must be below the largest grey value of the frames, "
    assert_one_sentence(done, below if black == "4000" else "--black-dn must be a finite", black)


def test_each_colour_channel_has_its_own_mtf(tmp_path: Path) -> None:
    """A lens that is sharper in red than in blue; the luminance, mostly green, lies between."""
    scenes = [EdgeScene(blur=TrueBlur(sigma_px=sigma), snr=60.0) for sigma in (0.7, 1.0, 1.5)]
    planes = [scene.frames_drawn(np.random.default_rng(0)).data[0] for scene in scenes]
    cv2.imwrite(str(tmp_path / "lens.png"), np.stack(planes[::-1], axis=-1).astype(np.uint8))
    for plane, scene in zip("rgb", scenes, strict=True):
        asked = ("--quick", "--plane", plane, "--method", "edge-gradient")
        found = json_of("mtf", "edge", tmp_path / "lens.png", *asked)["measurements"][0]
        assert found["value"] == pytest.approx(scene.truth_mtf50, rel=0.05)
    values = [
        json_of("mtf", "edge", tmp_path / "lens.png", "--quick", *asked)["measurements"][0]
        for asked in ((), ("--plane", "luminance"))
    ]
    assert values[0]["value"] == values[1]["value"]
    assert scenes[2].truth_mtf50 < values[0]["value"] < scenes[0].truth_mtf50


def test_lines_at_the_cathode_are_wider_by_the_taper() -> None:
    """11 um pixels behind a taper of 18/11 are 18 um at the cathode: 0.5 cy/px is 27.8 lp/mm
    there.
    """
    lengths = {
        "pitch_x_um": 11.0,
        "pitch_y_um": 13.0,
        "demagnification": 18 / 11,
        "focal_length_mm": 36.0,
    }
    at_cathode = FrequencyUnit(unit="lp/mm-cathode", **lengths)
    assert at_cathode(0.5)[0] == pytest.approx(1e3 * 0.5 / 18.0)
    assert FrequencyUnit(unit="lp/mm", **lengths)(0.5)[0] == pytest.approx(1e3 * 0.5 / 11.0)
    # An angle of one milliradian is 36 um on the cathode, two pixels.
    assert FrequencyUnit(unit="cy/mrad", **lengths)(0.5)[0] == pytest.approx(1.0)


def test_an_edge_along_rows_counts_their_pitch() -> None:
    """Rows of 13 um: 0.5 cycles per row are 38.5 lp/mm, and 493 rows hold 493 lines of them."""
    unit = FrequencyUnit(unit="lp/mm", pitch_x_um=11.0, pitch_y_um=13.0)
    lying, standing, point = (
        make_measurement("mtf50", "cy/px", 0.5, None, None, method=method, orientation_deg=angle)
        for method, angle in (
            ("edge-forward", 95.0),
            ("edge-forward", 5.0),
            ("point-forward", 90.0),
        )
    )
    assert unit(0.5, lying)[0] == pytest.approx(500 / 13)
    assert unit(0.5, standing)[0] == pytest.approx(500 / 11)
    assert unit(0.5, point)[0] == pytest.approx(500 / 11)
    lines = FrequencyUnit(unit="tvl/ph", pitch_x_um=11.0, pitch_y_um=13.0, rows=493)
    assert lines(0.5, lying)[0] == pytest.approx(493)
    assert lines(0.5, standing)[0] == pytest.approx(493 * 13 / 11)


@pytest.mark.parametrize("pitch_um", [None, 5.0])
def test_samples_of_a_plane_lie_two_pixels_apart(pitch_um: float | None) -> None:
    """0.5 cycles per sample of a plane are 0.25 per pixel of the camera, stated or described."""
    camera = load_camera("machine-vision")
    own_um = float(camera.ccd.pitch_x_um) if pitch_um is None else pitch_um
    plane = FrequencyUnit.of(camera, unit="lp/mm", sample_pitch_px=2, pitch_um=pitch_um)
    assert plane(0.5)[0] == pytest.approx(1e3 * 0.25 / own_um)
    assert FrequencyUnit.of(camera, unit="lp/mm", pitch_um=pitch_um)(0.25)[0] == pytest.approx(
        1e3 * 0.25 / own_um
    )


@pytest.mark.parametrize(
    ("unit", "given", "words"),
    [
        ("lp/mm", {}, ("`units` lp/mm", "`pitch_um`")),
        ("lp/mm-cathode", {"pitch_x_um": 11.0}, ("`demagnification`", "`sensor`")),
        ("cy/mrad", {"pitch_x_um": 11.0}, ("`focal_length_mm`",)),
        ("lp/mm", {"pitch_x_um": -1.0}, ("`pitch_um` must be positive, got -1",)),
        ("furlongs", {}, ("furlongs", "lp/mm-cathode")),
    ],
)
def test_a_missing_length_is_named_with_its_remedy(
    unit: str, given: dict[str, float], words: tuple[str, ...]
) -> None:
    with pytest.raises(BadInput) as error:
        FrequencyUnit(unit=unit, **given)
    assert all(word in str(error.value) for word in words)


def test_captions_cover_neither_one_another_nor_what_was_measured() -> None:
    boxes = [(100 * k, 150 * j, 100 * k + 60, 150 * j + 60) for k in range(4) for j in range(5)]
    size = (44, 120)
    places = place_captions(boxes, [size] * 20, (493, 900))
    for k, (top, left) in enumerate(places):
        assert top >= 0 and top + size[0] < 493 and left >= 0 and left + size[1] < 900
        for other_top, other_left in places[:k]:
            assert abs(top - other_top) >= size[0] or abs(left - other_left) >= size[1]
        for box in boxes:
            row, col = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
            assert not (top <= row <= top + size[0] and left <= col <= left + size[1])


def test_verdicts_differ_in_more_than_colour() -> None:
    """Of a suspect region half the outline is drawn, of a refused one the diagonals too."""
    stack = FrameStack(data=np.zeros((1, 300, 300), np.uint8))
    common = {"method": "edge-forward", "region": (100, 100, 90, 90)}
    share = {}
    for status, one in {
        "ok": make_measurement("mtf50", "cy/px", 0.2, (0.19, 0.21), (0.18, 0.22), **common),
        "suspect": make_measurement(
            "mtf50", "cy/px", 0.2, (0.19, 0.21), (0.18, 0.22), flags=("clipped",), **common
        ),
        "refused": make_refusal("mtf50", "cy/px", "nothing there", **common),
    }.items():
        picture = render_annotations(stack, Measured(measurements=(one,)))
        assert picture.shape[1] >= 1500
        top_line = picture[498:503, 505:945]
        share[status] = np.all(top_line == VERDICT_COLOURS[status], axis=2).any(axis=0).mean()
        crossed = np.all(
            np.abs(picture[530:540, 530:540].astype(int) - VERDICT_COLOURS[status]) < 60, axis=2
        ).any()
        assert crossed == (status == "refused")
    assert share["ok"] > 0.99 and share["refused"] > 0.99
    assert 0.4 < share["suspect"] < 0.9


def test_edges_that_cannot_be_measured_are_drawn_with_the_reason() -> None:
    """The long sides of a bar of 8 px have no room for their plateaus; unless the region of one was
    measured.
    """
    row, col = np.mgrid[:200, :300].astype(float)
    across = (col - 230) * np.cos(0.09) + (row - 100) * np.sin(0.09)
    bar = (np.abs(row - 100) < 60) * (erf((across + 4) / 1.2) - erf((across - 4) / 1.2))
    stack = FrameStack(
        data=np.random.default_rng(0).poisson(200.0 + 400.0 * bar).astype(np.uint16)[None]
    )
    found = unusable_edges(stack, Measured())
    assert [why for _, why in found] == ["no room next to it"] * 2
    centres = sorted(region[1] + region[3] / 2 for region, _ in found)
    assert centres == pytest.approx([226, 234], abs=1.5)
    region = (41, 229, 120, 60)
    one = make_measurement(
        "mtf50", "cy/px", 0.2, (0.19, 0.21), (0.18, 0.22), method="edge-forward", region=region
    )
    assert len(unusable_edges(stack, Measured(measurements=(one,)))) == 1
    bare, drawn = (
        render_annotations(stack, Measured(measurements=(one,)), unusable=u) for u in ((), found)
    )
    rows, columns = np.nonzero(np.any(bare[:1000] != drawn[:1000], axis=2))
    # Outlines and captions are at the bar, rows 37 to 163, columns 215 to 245, five times enlarged.
    assert rows.size > 2 * 120 * 5 and 180 < rows.min() < 210 and 790 < rows.max() < 840
    assert columns.min() < 1100 and columns.max() > 1190
    assert len(drawn) == len(bare) and np.any(bare[1000:] != drawn[1000:])


def test_a_picture_is_written_and_told_when_everything_is_refused(tmp_path: Path) -> None:
    np.save(
        tmp_path / "even.npy", np.random.default_rng(0).poisson(300.0, (100, 120)).astype(np.uint16)
    )
    path = tmp_path / "even.png"
    done = charact(
        "mtf",
        "edge",
        tmp_path / "even.npy",
        "--quick",
        "--method",
        "edge-slanted",
        "--annotate",
        path,
    )
    told, reason = done.stderr.strip().splitlines()
    assert done.exit_code == 1 and "no target: no step" in reason
    assert told == f"{path}: every region with its value, or why it has none"
    assert np.all(
        np.abs(cv2.imread(str(path)).astype(int) - VERDICT_COLOURS["refused"]) < 10, axis=2
    ).any()
    asked = ("mtf", "edge", tmp_path / "even.npy", "--quick", "--annotate", tmp_path / "out.jpg")
    assert_one_sentence(charact(*asked), "must name a .png file")


def test_a_region_of_a_cropped_stack_is_drawn_where_it_lies() -> None:
    """A region in the file's row 130 of a stack that begins at row 30 is at the stack's row 100."""
    stack = FrameStack(data=np.zeros((1, 300, 300), np.uint8), origin=(30, 0))
    common = {"method": "edge-forward", "region": (130, 100, 90, 90)}
    one = make_measurement("mtf50", "cy/px", 0.2, (0.19, 0.21), (0.18, 0.22), **common)
    picture = render_annotations(stack, Measured(measurements=(one,)))
    rows = np.flatnonzero(np.all(picture[:1500, 600] == VERDICT_COLOURS["ok"], axis=1))
    assert abs(rows.min() - 500) <= 2 and abs(rows.max() - 949) <= 2
