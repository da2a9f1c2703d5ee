"""Frames, targets, planes of colour and captures are values that say what they are."""

import dataclasses
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdata import (
    FLAGS,
    QUANTITIES,
    BadInput,
    Conditions,
    FrameStack,
    Limits,
    LostFrames,
    Measurement,
    Plan,
    Posterior,
    Result,
    SessionFile,
    SessionWriter,
    Step,
    Target,
    convert_frequency,
    from_toml,
    import_frames,
    losses_before,
    make_measurement,
    make_refusal,
    measurement_from_draws,
    measurement_from_sd,
    open_lazy_stack,
    open_session,
    order_flags,
    read_array,
    read_frames,
    to_toml,
    write_atomically,
)
from labdata.camera import Parameter

# The core types refuse what they cannot mean, in one sentence, and never change once made.


def test_frames_cannot_be_written_to_through_the_stack():
    own = np.zeros((2, 3, 4))
    stack = FrameStack(data=own, time_s=np.arange(2.0))
    with pytest.raises(ValueError, match="read-only"):
        stack.data[0, 0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        stack.time_s[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        stack.unit = "e-"  # type: ignore[misc]
    own[0, 0, 0] = 5  # the caller's array stays the caller's


@given(*[st.integers(-3, 12)] * 4)
@settings(deadline=None)
def test_a_region_is_cut_as_it_is_named_or_refused(row, col, height, width):
    stack = FrameStack(data=np.arange(2 * 8 * 9).reshape(2, 8, 9), time_s=np.arange(2.0))
    inside = (
        row >= 0
        and col >= 0
        and height > 0
        and width > 0
        and row + height <= 8
        and col + width <= 9
    )
    if not inside:
        with pytest.raises(
            BadInput, match=f"8 rows and 9 columns, got {row},{col},{height},{width}"
        ):
            stack.region(row, col, height, width)
        return
    cut = stack.region(row, col, height, width)
    assert cut.shape == (2, height, width)
    assert cut.data[1, 0, 0] == 72 + 9 * row + col
    assert np.array_equal(cut.time_s, stack.time_s)


def test_only_gain_in_db_and_temperature_may_be_negative():
    Conditions(camera_gain_db=-6.0, temperature_c=-40.0)
    for name in ("mcp_v", "gate_ns", "illuminance_lux", "exposure_s", "photons_per_px"):
        with pytest.raises(BadInput, match=f"{name} must not be negative, got -1"):
            Conditions(**{name: -1.0})


def step(label: str = "a", **conditions: float) -> Step:
    return Step(label=label, kind="flat", frames=1, conditions=Conditions(**conditions))


def test_a_plan_is_checked_whole_when_it_is_made():
    for name, over in (("mcp_v", 901.0), ("illuminance_lux", 0.02), ("gate_ns", 3e7)):
        with pytest.raises(BadInput, match=f"{name} of step 'a' must not exceed the limit"):
            Plan(name="p", steps=(step(**{name: over}),))
        Plan(name="p", steps=(step(**{name: over}),), limits=Limits(**{name: over}))


TWO = np.zeros((2, 2, 2))


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (
            lambda: FrameStack(data=np.zeros((3, 4))),
            r"axes \(frame, row, col\), got shape \(3, 4\)",
        ),
        (lambda: FrameStack(data=np.zeros((0, 3, 4))), "at least one pixel"),
        (
            lambda: FrameStack(data=np.full((1, 2, 2), np.nan)),
            "got 4 of 4 that are NaN, infinite or larger: scale the frames",
        ),
        (
            lambda: FrameStack(data=np.zeros((1, 2, 2), bool)),
            "whole or real numbers, got the type bool",
        ),
        (
            lambda: FrameStack(data=TWO, time_s=np.zeros(3)),
            "time_s must be empty or one for each of 2 frames",
        ),
        (
            lambda: FrameStack(data=TWO, frame_number=np.zeros(1)),
            "frame_number must be empty or one for each",
        ),
        (lambda: Target(bars=1), "at least 2 bars, got 1"),
        (lambda: Target(frequency_cy_per_px=0.0), "must be positive, got 0"),
        (lambda: Target(frequency_cy_per_px=np.inf), "must be a finite number, got inf"),
        (lambda: Target(pinhole_px=-1.0), "must not be negative, got -1"),
        (lambda: Target(contrast=1.5), r"must lie in \(0, 1\], got 1\.5"),
        (lambda: Parameter(value=4.0, low=1.0, high=3.0), r"got 4 for 1\.\.3"),
        (lambda: Parameter(value=4.0, low=1.0), "given together, got 1"),
        (
            lambda: Plan(name="p", steps=(step(), step())),
            r"every step's label must be its own, got \['a', 'a'\]",
        ),
        (
            lambda: Step(label="a", kind="flat", frames=0, conditions=Conditions()),
            "at least one frame, got 0",
        ),
        (lambda: convert_frequency(0.1, "lp/mm"), "needs a positive pitch_um"),
        (lambda: convert_frequency(0.1, "tvl/ph"), "positive picture_height_px"),
        (lambda: convert_frequency(0.1, "Hz"), "must be one of"),
        (
            lambda: LostFrames(first=5, last=4, reason="late"),
            "must not come before the first, got 5 to 4",
        ),
        (lambda: LostFrames(first=5, last=5, reason=""), "must have a reason"),
        *(
            (
                lambda stated=stated: read_array(dark(), stated),
                f"of its first 2x2 pixels, as rggb, got '{stated[:-3]}'",
            )
            for stated in ("rgb:g1", "RGGB:g1", "rg1b:g1")
        ),
    ],
)
def test_what_cannot_be_is_refused(make, rule):
    with pytest.raises(BadInput, match=rule):
        make()


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        *(
            (lambda value=value: measured(value), "must be a finite number")
            for value in (np.nan, np.inf)
        ),
        (lambda: dataclasses.replace(REFUSAL, value=0.2), "carries a reason and no value"),
        (lambda: measured(0.2, "mtf51"), "no quantity 'mtf51'"),
        (lambda: measured(0.2, unit="lp/mm"), "with the unit 'lp/mm'"),
        (lambda: order_flags(("halo",)), "'halo'"),
        (
            lambda: Posterior(names=("a",), units=("1",), draws=np.zeros((3, 2))),
            "draws must be",
        ),
    ],
)
def test_what_no_caller_may_ask_for_is_an_error(make, rule):
    with pytest.raises(ValueError, match=rule):
        make()


REFUSAL = make_refusal("mtf50", "cy/px", "no edge was found", method="m")


def measured(value: float, quantity: str = "mtf50", unit: str = "cy/px", **more) -> Measurement:
    return make_measurement(quantity, unit, value, None, None, method="m", **more)


def test_a_number_without_flags_is_ok_and_with_flags_suspect():
    assert measured(0.2).status == "ok"
    suspect = measured(0.2, flags=("lag", "agc", "lag"))
    assert (suspect.status, suspect.flags) == ("suspect", ("lag", "agc"))
    assert measured(0.2).with_(flags=("drift",)).status == "suspect"


def test_a_refusal_has_no_number_whatever_its_flags():
    assert (REFUSAL.value, REFUSAL.interval95, REFUSAL.status) == (None, None, "refused")
    assert REFUSAL.with_(flags=("no-target",)).status == "refused"


def test_flags_are_sentences_and_quantities_have_units():
    assert all(sentence.endswith(".") for sentence in FLAGS.values())
    assert all(quantity.units for quantity in QUANTITIES.values())


def test_intervals_of_draws_and_of_a_standard_deviation_agree(seed):
    draws = np.random.default_rng(seed).normal(5.0, 0.1, 40_000)
    drawn = measurement_from_draws("blur_factor", "1", draws, method="m")
    exact = measurement_from_sd("blur_factor", "1", 5.0, 0.1, method="m")
    # Standard error of the 2.5 % quantile of n normal draws: sqrt(p (1 - p) / n) / density, here
    # 2.7 sd / sqrt(n).
    standard_error = 2.7 * 0.1 / 200
    assert np.array(drawn.interval95) == pytest.approx(
        np.array(exact.interval95), abs=4.5 * standard_error
    )
    assert np.array(drawn.interval68) == pytest.approx(
        np.array(exact.interval68), abs=4.5 * standard_error
    )


def test_a_posterior_names_each_column_of_its_draws():
    posterior = Posterior(names=("a", "b"), units=("1", "px"), draws=np.arange(6.0).reshape(3, 2))
    assert posterior["b"].tolist() == [1.0, 3.0, 5.0]


def test_results_add_up_and_are_searched_by_what_they_say():
    one, other = (measured(9.0, "bloom_diameter", "px", stack=label) for label in "ab")
    both = Result(measurements=(one,), evidence={"a": {}}) + Result(
        measurements=(other,), evidence={"b": {}}
    )
    assert both.find("bloom_diameter", stack="b") == (other,)
    assert both.evidence.keys() == {"a", "b"}
    assert both.find("mtf50") == ()


def test_570_television_lines_are_27_lp_per_mm_at_the_cathode():
    """Regression truth 8: 768 columns are 576 lines, and 570 lines over 493 rows of 13 um are 27.2
    lp/mm at 18/11.
    """
    assert convert_frequency(0.5, "tvl/ph", picture_height_px=768 * 3 / 4) == 576
    height_px = 493 * 13.0 / 11.0
    at_570 = 570 / convert_frequency(1.0, "tvl/ph", picture_height_px=height_px)
    assert convert_frequency(at_570, "lp/mm", pitch_um=11.0) / (18 / 11) == pytest.approx(
        27.2, abs=0.05
    )
    assert convert_frequency(0.1, "cy/mrad", pitch_um=11.0, focal_length_mm=22.0) == pytest.approx(
        0.2
    )


# Planes of a mosaic: every second row and column of the file, from the site of its colour.


SITES = {"r": (0, 0), "g1": (0, 1), "g2": (1, 0), "b": (1, 1)}


def dark(shape: tuple[int, ...] = (5, 24, 36)) -> np.ndarray:
    """Return frames without a checkerboard, as those of a dark."""
    return np.random.default_rng(3).integers(50, 70, shape, dtype=np.uint16)


@pytest.mark.parametrize(("plane", "site"), SITES.items())
def test_a_mosaic_that_does_not_show_is_stated_with_the_plane(
    tmp_path: Path, plane: str, site: tuple[int, int]
) -> None:
    data = dark()
    cv2.imwrite(str(tmp_path / "dark.png"), data[0])
    with pytest.raises(BadInput, match=f"got plane '{plane}' of dark.png; .* `plane` rggb:{plane}"):
        read_frames(tmp_path / "dark.png", plane)
    for stack in (
        read_frames(tmp_path / "dark.png", f"rggb:{plane}"),
        read_array(data[:1], f"rggb:{plane}"),
    ):
        assert np.array_equal(stack.data[0], data[0, site[0] :: 2, site[1] :: 2])
        assert (stack.plane, stack.sample_pitch_px) == (plane, 2)
        assert any("two pixels of the camera apart" in note for note in stack.notes)


def test_a_plane_of_a_picture_of_three_colours_is_as_fine_as_the_picture() -> None:
    stack = read_array(np.stack([dark((24, 36))] * 3, axis=-1), "r")
    assert (stack.shape, stack.plane, stack.sample_pitch_px) == ((1, 24, 36), "r", 1)


def write_fits(path: Path, data: np.ndarray, **cards: object) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    unit = fits.PrimaryHDU(data)
    unit.header.update(CTYPE3="TIME", **cards)
    unit.writeto(path)


@pytest.mark.parametrize(
    ("across", "down", "red"), [(0, 0, (0, 0)), (1, 0, (0, 1)), (0, 1, (1, 0)), (1, 1, (1, 1))]
)
def test_offsets_of_a_fits_header_move_the_mosaic(
    tmp_path: Path, across: int, down: int, red: tuple[int, int]
) -> None:
    data = dark()
    write_fits(tmp_path / "a.fits", data, BAYERPAT="RGGB", XBAYROFF=across, YBAYROFF=down)
    assert np.array_equal(
        read_frames(tmp_path / "a.fits", "r").data, data[:, red[0] :: 2, red[1] :: 2]
    )


def test_a_plane_stated_against_the_file_is_refused(tmp_path: Path) -> None:
    write_fits(tmp_path / "a.fits", dark(), BAYERPAT="GRBG")
    assert np.array_equal(read_frames(tmp_path / "a.fits", "grbg:r").data, dark()[:, 0::2, 1::2])
    with pytest.raises(
        BadInput, match=r"mosaic of a\.fits is grbg by the file itself, got the plane rggb:r"
    ):
        read_frames(tmp_path / "a.fits", "rggb:r")


def test_a_border_cut_off_leaves_the_colours_in_their_places(tmp_path: Path) -> None:
    data = dark().astype(np.float32)
    data[:, 0], data[:, :, :3] = np.nan, np.nan
    write_fits(tmp_path / "a.fits", data, BAYERPAT="RGGB")
    for plane, (row, col) in SITES.items():
        found = read_frames(tmp_path / "a.fits", plane).data
        inside = data[:, 2 - row if row == 0 else 1 :: 2, 4 - col if col == 0 else 3 :: 2]
        assert np.array_equal(found, inside)


def recorded(folder: Path, data: np.ndarray, plane: str) -> None:
    """Write a session of the store as an acquisition does, and state the plane of its stack."""
    with SessionWriter.create(folder, name="s") as writer:
        stack = writer.begin_stack("dark", "dark", data.shape[1:], data.dtype, Conditions())
        for number, frame in enumerate(data):
            stack.append(frame, number / 30, number)
        stack.finish()
    form = from_toml(folder / "session.toml", SessionFile)
    form = replace(form, stack=tuple(replace(one, plane=plane) for one in form.stack))
    write_atomically(folder / "session.toml", to_toml(form).encode())


def test_a_recorded_mosaic_gives_the_same_plane_read_at_once_and_on_demand(tmp_path: Path) -> None:
    data = dark()
    recorded(tmp_path / "s", data, "bggr:r")
    (entry,) = open_session(tmp_path / "s").stacks
    red = data[:, 1::2, 1::2]
    assert np.array_equal(entry.read().data, red)
    lazy = open_lazy_stack(entry)
    assert lazy.shape == red.shape
    assert np.array_equal(lazy.frames(0, 5), red)
    assert np.array_equal(entry.read().frame_number, np.arange(5))


def test_a_session_knows_the_plane_of_its_files_and_how_far_its_samples_lie_apart(
    tmp_path: Path,
) -> None:
    np.save(tmp_path / "a.npy", dark())
    np.save(tmp_path / "b.npy", dark())
    session = import_frames([tmp_path / "a.npy"], tmp_path / "s", kind="dark", plane="rggb:g2")
    assert session.sampling == ("g2", 2)
    session = import_frames(
        [tmp_path / "b.npy"], tmp_path / "s", kind="flat", plane="rggb:b", add=True
    )
    with pytest.raises(
        BadInput, match="one colour plane, got g2 in 'a' and b in 'b' of session 's'"
    ):
        _ = session.sampling
    grey = import_frames([tmp_path / "a.npy"], tmp_path / "t", kind="dark")
    assert grey.sampling == ("mono", 1)


# Lost frames have numbers and reasons.


def test_a_gap_in_the_numbers_is_told_with_its_reasons():
    lost = losses_before(
        15, expected=10, faults={11: "missing packets", 12: "missing packets", 30: "late"}
    )
    assert [(one.first, one.last, one.reason) for one in lost] == [
        (10, 10, "never arrived"),
        (11, 12, "missing packets"),
        (13, 14, "never arrived"),
    ]
    assert sum(map(len, lost)) == 5


def test_no_gap_loses_nothing():
    assert losses_before(10, expected=10, faults={}) == ()
