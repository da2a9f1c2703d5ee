"""Maps of a camera drawn in plain NumPy: its patterns from half of the frames, and their use."""

import re
from dataclasses import replace
from functools import cache

import h5py
import numpy as np
import pytest
import tifffile
from astropy.io import fits

import charact
from charact.fitting import fit_sensor
from charact.fitting.specimen_maps import (
    code_width_finding,
    frames_for_maps,
    measure_maps,
    with_maps,
)
from charact.method import Context
from charact.session_measurement import measure
from charact.validation import VALIDATION, validate
from charact.validation import side_by_side as command
from charact.validation.frame_features import features_of
from charact.validation.frames import choose
from labdata import (
    BadInput,
    Camera,
    Conditions,
    FrameStack,
    Session,
    Target,
    load_camera,
    save_sensor,
)
from labdata.camera.maps import IN_DARK, SpecimenMaps, bands_of
from labdata.camera.parameters import Draws
from simulate.lab import LabBench
from tests.charact.cli.runner import done_well
from tests.truth.sessions import session_in_memory, stack_in_memory

SHAPE = (120, 160)
GAIN, BLACK, READ_DN, PRNU = 0.4, 50.0, 2.0, 0.012
HOT = [(20, 30), (61, 100), (90, 7)]
DUST = 0.2
PHOTONS = (0.0, 1500.0, 4000.0, 9000.0)


@cache
def truth(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset with columns and hot pixels, DN, response, and shading of the light."""
    rng = np.random.default_rng([seed, 9])
    offset = 1.5 * rng.standard_normal(SHAPE[1]) + 0.1 * rng.standard_normal(SHAPE)
    for place in HOT:
        offset[place] += 25.0
    response = 1.0 + PRNU * rng.standard_normal(SHAPE)
    shading = 1.0 - 0.04 * np.linspace(-1.0, 1.0, SHAPE[1]) ** 2 * np.ones((SHAPE[0], 1))
    return offset, response / response.mean(), shading / shading.mean()


@cache
def numpy_session(seed: int, frames: int = 16) -> Session:
    """Return darks and flats of the camera: Poisson electrons, read noise, whole DN."""
    offset, response, shading = truth(seed)
    rng, stacks = np.random.default_rng(seed), []
    for photons in PHOTONS:
        electrons = rng.poisson(0.6 * photons * response * shading, (frames, *SHAPE))
        level = BLACK + offset + GAIN * electrons + READ_DN * rng.standard_normal(electrons.shape)
        data = np.clip(np.rint(level), 0, 4095).astype(np.uint16)
        known = Conditions(exposure_s=0.02)
        if photons:
            known = replace(known, photons_per_px=photons, wavelength_nm=530.0)
        kind = "flat" if photons else "dark"
        stack = FrameStack(data=data, full_scale_dn=4095.0)
        label = f"flat {photons:g}" if photons else "dark"
        stacks.append(stack_in_memory(kind, stack, known, label=label, bit_depth=12))
    sheet = load_camera("machine-vision")
    return replace(session_in_memory(tuple(stacks)), camera=sheet, bit_depth=12)


@cache
def fitted(seed: int) -> Camera:
    session = numpy_session(seed)
    return with_maps(session, fit_sensor(session, measure(session, quick=True), seed=seed))


def test_maps_are_the_cameras_within_their_deviation_and_hot_pixels_are_marked(seed: int) -> None:
    offset, response, shading = truth(seed)
    maps = measure_maps(numpy_session(seed), load_camera("machine-vision"))
    assert maps is not None and maps.offset_dn is not None and maps.response is not None
    for measured, expected in (
        (maps.offset_dn, offset - offset.mean()),
        (maps.response, response * shading / (response * shading).mean()),
    ):
        pull = (measured.value - expected) / measured.sd
        # Of 19,200 pixels the variance of pulls is known to 1 %, the noise itself to as much.
        assert 0.95 < pull.var() < 1.05
    assert maps.defect is not None
    assert {tuple(place) for place in np.argwhere(maps.defect & IN_DARK)} == set(HOT)


def test_draws_have_the_variance_of_the_pattern_and_not_the_noise_of_the_map(seed: int) -> None:
    _, response, _ = truth(seed)
    measured = measure_maps(numpy_session(seed), load_camera("machine-vision")).response
    draws = np.stack([measured.draw(number) for number in range(20)]) / measured.smooth
    assert measured.remainder.var() > 1.02 * response.var()
    assert draws.var(axis=(1, 2)).mean() == pytest.approx(response.var(), rel=0.02)
    # A draw departs from the truth by the posterior's deviation.
    assert draws.var(axis=0).mean() == pytest.approx(
        ((draws - response) ** 2).mean() / 2.0, rel=0.1
    )
    assert np.array_equal(measured.draw(3), measured.draw(3))


def test_frames_of_maps_are_the_last_half_and_are_not_compared(seed: int) -> None:
    session, maps = numpy_session(seed), fitted(seed).maps
    assert maps.frames["dark"] == tuple(range(8, 16))
    compared = choose(session, maps).measured["dark"]
    assert np.array_equal(compared, session.stack("dark").read().data[: VALIDATION.frames])
    # Frames of another session of the same labels are compared: they made no map.
    assert choose(session, maps).notes[-1].startswith("not compared: 32 frames")
    assert not any("not compared:" in n for n in choose(numpy_session(seed + 1), maps).notes)


def test_of_pairs_every_second_stack_makes_maps_and_the_last_tests(seed: int) -> None:
    entries = [
        stack_in_memory("flat", FrameStack(data=np.full((2, 8, 8), 100.0 + n)), label=f"{n}")
        for n in range(5)
    ]
    chosen = frames_for_maps(entries, 4095.0)
    assert [(frames.entry.label, len(frames.numbers)) for frames in chosen] == [("1", 2), ("3", 2)]


def test_maps_are_read_with_the_file_of_their_fit_alone(seed: int, tmp_path) -> None:
    camera = fitted(seed)
    save_sensor(camera, tmp_path / "fitted.toml")
    maps = load_camera(tmp_path / "fitted.toml").maps
    for name, plane in camera.maps.planes().items():
        assert np.array_equal(plane, maps.planes()[name])
    assert np.array_equal(maps.offset_dn.draw(1), camera.maps.offset_dn.draw(1))
    assert (maps.frames, maps.checksums) == (camera.maps.frames, camera.maps.checksums)
    other = replace(camera, maps=None, draws=Draws(names=("ccd.prnu",), values=((0.01,),)))
    save_sensor(other, tmp_path / "other.toml")
    assert load_camera(tmp_path / "other.toml").maps is None
    (tmp_path / "maps.zarr" / "offset_dn" / "zarr.json").write_text("{}")
    with pytest.raises(BadInput, match="damaged"):
        load_camera(tmp_path / "fitted.toml")


def test_bands_part_columns_rows_and_directions() -> None:
    bands = bands_of(SHAPE)
    assert set(bands[0, 1:]).isdisjoint(bands[1:, 1:].ravel())
    assert set(bands[1:, 0]).isdisjoint(bands[1:, 1:].ravel())
    assert np.bincount(bands.ravel())[np.unique(bands)].min() >= 20


def test_the_specimen_passes_with_its_maps_and_fails_as_one_of_its_type(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "VALIDATION", replace(VALIDATION, draws=10))
    monkeypatch.setattr(command, "PARAMETERS", ())
    session, camera = numpy_session(seed), fitted(seed)
    patterns = ("fixed-pattern", "defects", "shading")
    found = validate(session, camera, seed=seed)
    failing = [statistic.name for statistic in found.statistics if not statistic.passed]
    assert not set(failing) & set(patterns) and len(failing) <= 1
    assert any("3 pixels beyond 5" in note for note in found.notes)
    of_type = validate(session, replace(camera, maps=None), seed=seed)
    assert not any(s.passed for s in of_type.statistics if s.name in patterns)


def test_hot_pixels_that_appear_after_the_maps_are_found(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "VALIDATION", replace(VALIDATION, draws=10))
    monkeypatch.setattr(command, "PARAMETERS", ())
    session, rng = numpy_session(seed), np.random.default_rng([seed, 4])
    entry = session.stack("dark")
    data = np.array(entry.read().data)
    rows, cols = (rng.integers(size, size=8) for size in SHAPE)
    # The frames that are compared, the first of the dark apart, by which the session is known.
    data[1:8, rows, cols] += np.uint16(12.0 * READ_DN)
    stacks = (replace(entry, kept=replace(entry.read(), data=data)), *session.stacks[1:])
    found = validate(replace(session, stacks=stacks), fitted(seed), seed=seed)
    assert any("not compared: 32 frames" in note for note in found.notes)
    (defects,) = (s for s in found.statistics if s.name == "defects")
    assert not defects.passed and "of dark" in defects.worst


@cache
def tube_session(seed: int, depth: float, frames: int = 32) -> Session:
    """Return a dark of sparse pulses with hot pixels, and flats with stripes of a depth, behind a
    tube: pulses of exponential height on four pixels each.
    """
    rng, rows = np.random.default_rng([seed, 5]), np.arange(SHAPE[0])[:, None]
    stripes = 1.0 + depth * np.cos(2.0 * np.pi * rows / 12.0) * np.ones(SHAPE)
    stacks = []
    for rate in (0.01, 10.0, 40.0):
        counts = rng.poisson(rate * (stripes if rate > 1.0 else 1.0), (frames, *SHAPE))
        light = 40.0 * counts * rng.gamma(np.maximum(counts, 1e-9)) / np.maximum(counts, 1)
        light = sum(np.roll(light, step, (1, 2)) for step in ((0, 0), (0, 1), (1, 0), (1, 1))) / 4.0
        data = 200.0 + light + 3.0 * rng.standard_normal(light.shape)
        for place in HOT:
            data[:, *place] += 60.0
        known = Conditions(exposure_s=0.033, mcp_v=800.0, illuminance_lux=rate * 1e-6)
        kind = "flat" if rate > 1.0 else "dark"
        stack = FrameStack(data=np.rint(data).astype(np.uint16), full_scale_dn=4095.0)
        stacks.append(stack_in_memory(kind, stack, known, label=f"{rate:g}", bit_depth=12))
    return replace(session_in_memory(tuple(stacks)), bit_depth=12)


@pytest.mark.parametrize("depth", [0.0, 0.03, 0.08])
def test_a_tube_is_simulated_with_the_pattern_that_its_flats_show_or_with_none(
    seed: int, depth: float
) -> None:
    sheet = load_camera("gen3-digital-iccd")
    maps = measure_maps(tube_session(seed, depth), sheet)
    small = replace(sheet, ccd=replace(sheet.ccd, rows=SHAPE[0], columns=SHAPE[1]))
    bright = Conditions(mcp_v=800.0, gate_ns=1e7, illuminance_lux=1e-5)
    of_type, of_specimen = (
        LabBench(replace(small, maps=known))
        .mean("flat", Target(), bright)[8:-8, 8:-8]
        .astype(float)
        for known in (None, maps)
    )
    dark_dn = float(sheet.video.black_level_dn)
    shown, usual = (
        (image / image.mean(axis=0)).std() * image.mean() / (image.mean() - dark_dn)
        for image in (of_specimen, of_type)
    )
    # The noise of the map: 16 frames of 50 pulses that four pixels share, and of 200.
    noise = np.sqrt(2.0 / 4.0 / 16.0 / 50.0)
    blurred = depth * np.cos(np.pi / 12.0)  # of stripes of 12 rows by pulses of two
    assert shown**2 == pytest.approx(blurred**2 / 2.0, abs=0.25 * noise**2)
    assert usual**2 > 0.25 * noise**2


@pytest.mark.parametrize("frames", [32, 16])
def test_pulses_of_a_dark_are_no_hot_pixels_of_its_map(seed: int, frames: int) -> None:
    maps = measure_maps(tube_session(seed, 0.0, frames), load_camera("gen3-digital-iccd"))
    assert {tuple(place) for place in np.argwhere(maps.defect & IN_DARK)} == set(HOT)
    heights = np.array([maps.offset_dn.value[place] for place in HOT])
    assert heights == pytest.approx(60.0, abs=6.0 * float(maps.offset_dn.sd[0, 0]))


def test_exported_maps_carry_their_unit(seed: int, tmp_path) -> None:
    save_sensor(fitted(seed), tmp_path / "fitted.toml")
    units = {"offset_dn": "DN", "offset_dn_sd": "DN", "response": "1", "defect": "1"}
    for ending in ("fits", "tif", "h5"):
        done_well("convert", tmp_path, tmp_path / ending, "--maps", "--to", ending)
    for name, unit in units.items():
        with fits.open(tmp_path / "fits" / f"{name}.fits") as file:
            assert file[0].header["BUNIT"] == unit
        with tifffile.TiffFile(tmp_path / "tif" / f"{name}.tif") as file:
            assert file.shaped_metadata[0]["unit"] == unit
        with h5py.File(tmp_path / "h5" / f"{name}.h5") as file:
            assert file["frames"].attrs["unit"] == unit


def test_a_simulation_of_the_type_leaves_the_maps_out(seed: int) -> None:
    camera, light = fitted(seed), np.full(SHAPE, 2000.0)
    frames = [
        charact.simulate(
            light, sensor=described, photoelectrons_per_dn=1.0, frames=2, of_type=of_type
        ).data
        for described, of_type in (
            (camera, False),
            (camera, True),
            (replace(camera, maps=None), False),
        )
    ]
    assert np.array_equal(frames[1], frames[2]) and not np.array_equal(frames[0], frames[1])


def converted(seed: int, gain: float, wide: float) -> Session:
    """Return flats of a converter whose codes are scaled by a gain, odd ones wider by a part."""
    rng, stacks = np.random.default_rng([seed, 8]), []
    for photons in PHOTONS[1:]:
        electrons = rng.poisson(0.6 * photons * truth(seed)[1], (16, *SHAPE))
        level = BLACK + GAIN * electrons + READ_DN * rng.standard_normal(electrons.shape)
        codes = np.rint(gain * np.rint(level / gain)).astype(np.uint16)
        codes += ((codes % 2 == 0) & (rng.random(codes.shape) < wide)).astype(np.uint16)
        stacks.append(stack_in_memory("flat", FrameStack(data=codes), label=f"{photons:g}"))
    return session_in_memory(tuple(stacks))


def test_unlike_widths_of_codes_are_named_by_their_size(seed: int) -> None:
    assert code_width_finding(converted(seed, 1.0, 0.0), 4095.0) is None
    odd = code_width_finding(converted(seed, 1.0, 0.06), 4095.0)
    width = float(re.search(r"deviation ([.\d]+) LSB", odd.effect)[1])
    assert width == pytest.approx(0.06, rel=0.2)
    assert "of a period of 2; 0 codes" in odd.effect
    # Ten codes spread over eleven: one of them is missing.
    scaled = code_width_finding(converted(seed, 1.1, 0.0), 4095.0)
    codes, missing = (
        int(re.search(rf"(\d+) codes{end}", scaled.effect)[1]) for end in (",", " are")
    )
    assert "of a period of 11;" in scaled.effect
    assert missing == pytest.approx(codes / 11.0, abs=1.5)


def test_single_electrons_of_a_multiplying_register_are_no_hot_or_noisy_pixels(seed: int) -> None:
    """A pixel in 50 and frame has one, of an exponential height of 40 times the read noise."""
    rng = np.random.default_rng([seed, 8])
    shape = (16, *SHAPE)
    electrons = rng.poisson(0.02, shape) * rng.exponential(100.0, shape)
    level = BLACK + electrons + 2.5 * rng.standard_normal(shape)
    hot = [(30, 40), (80, 100)]
    for place in hot:
        level[:, *place] += 60.0
    frames = FrameStack(data=np.rint(level).clip(0, 65535).astype(np.uint16))
    dark = stack_in_memory("dark", frames, Conditions(exposure_s=0.02, em_gain=300.0))
    maps = measure_maps(session_in_memory((dark,)), load_camera("emccd-512"))
    assert maps is not None and maps.variance_dn2 is None
    places = {tuple(place) for place in np.argwhere(maps.defect & IN_DARK)}
    # Two electrons at one pixel in several frames of a part are rare.
    assert set(hot) <= places and len(places) < 2 + 0.001 * level[0].size


def dusted(seed: int, shift: int) -> Session:
    """Return the session of a camera with three spots of dust, moved over rows and columns."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]] - shift
    spots = [(rows - row) ** 2 + (cols - col) ** 2 for row, col in ((30, 40), (70, 110), (90, 60))]
    dust = 1.0 - DUST * sum(np.exp(-square / 2.0 / 2.5**2) for square in spots)
    session, stacks = numpy_session(seed), []
    for entry in session.stacks:
        frames = entry.read()
        data = np.rint(BLACK + (frames.data - BLACK) * (dust if entry.kind == "flat" else 1.0))
        stacks.append(replace(entry, kept=replace(frames, data=data.astype(np.uint16))))
    return replace(session, stacks=tuple(stacks))


def test_dust_is_no_defect_of_its_map_and_both_dark_and_bright_where_it_has_moved(
    seed: int,
) -> None:
    session = dusted(seed, 0)
    context = Context(seed=0, quick=True, camera=session.camera, full_scale_dn=4095.0)
    maps = measure_maps(session, session.camera)

    def heights(shift: int, maps: SpecimenMaps | None) -> list[float]:
        chosen = choose(dusted(seed, shift), maps)
        found = features_of(chosen.measured, chosen, context=context)
        names = [
            f"ln height of the 10 most {side} spots of flat 9000, DN" for side in ("dark", "bright")
        ]
        return [float(np.exp(found.groups["defects"][name])) / found.mean_dn[-1] for name in names]

    known, moved = heights(0, maps), heights(9, maps)
    # A tenth of its depth: of 20 values of a spot the mean behind a difference of Gaussians.
    assert max(known) < 0.1 * DUST
    assert min(moved) > 0.2 * DUST
    dark, bright = heights(9, None)
    assert dark > 0.2 * DUST > bright * 3.0


@pytest.mark.parametrize("noise_dn", [0.2, 0.35])
def test_hot_pixels_of_darks_that_rounding_hides_are_in_the_map(seed: int, noise_dn: float) -> None:
    rng = np.random.default_rng([seed, 6])
    data = 16.3 + 0.1 * rng.standard_normal(SHAPE) + noise_dn * rng.standard_normal((32, *SHAPE))
    for place in HOT:
        data[:, *place] += 13.0
    stack = FrameStack(data=np.rint(data).astype(np.uint8), full_scale_dn=255.0)
    session = session_in_memory((stack_in_memory("dark", stack, bit_depth=8),), bit_depth=8)
    maps = measure_maps(session, load_camera("machine-vision"))
    assert {tuple(place) for place in np.argwhere(maps.defect)} == set(HOT)
    assert maps.variance_dn2 is None
    drawn = maps.offset_dn.draw(1)
    assert [drawn[place] for place in HOT] == pytest.approx([13.0] * 3, abs=0.5)
    assert np.median(np.abs(drawn)) < 0.05 and maps.offset_dn.hidden_part == 1.0
