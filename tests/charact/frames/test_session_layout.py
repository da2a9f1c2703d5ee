"""Every method that reads darks and flats reads them without unexposed strips and lost rows."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators import mtf
from charact.fitting import fit_sensor, levels_of
from charact.frames.layout import lost_rows
from charact.frames.session_layout import layout_notes, sound_session
from charact.method import Context
from charact.session_measurement import measure
from charact.validation.frames import choose
from labdata import Conditions, Session, Target, load_camera, open_lazy_stack
from simulate.lab import LabBench
from tests.truth.scintillating_flats import ScintillatingFlats
from tests.truth.sessions import session_in_memory, stack_in_memory

STRIP_PX = 14
LOST = np.s_[1, 20:29]  # rows of a frame


def with_strip_and_lost_rows(session: Session) -> Session:
    """The frames of a session with an unexposed strip at the right, and rows of a flat lost."""
    stacks = []
    for entry in session.stacks:
        data = np.array(entry.kept.data)
        dark = session.of_kind("dark")[0].kept.data
        frames = np.arange(len(data)) % len(dark)
        data = np.concatenate([data, dark[frames, :, -STRIP_PX:].astype(data.dtype)], axis=2)
        if entry.label == session.stacks[-1].label:
            data[LOST] = 0
        stacks.append(replace(entry, kept=replace(entry.kept, data=data)))
    return replace(session, stacks=tuple(stacks))


@pytest.fixture(scope="module")
def machine_vision() -> Session:
    sheet = load_camera("machine-vision")
    camera = replace(sheet, ccd=replace(sheet.ccd, rows=64, columns=90))
    bench, stacks = LabBench(camera), []
    for photons in (0.0, 1500.0, 5000.0, 12000.0):
        lit = {"photons_per_px": photons, "wavelength_nm": 530.0} if photons else {}
        conditions, kind = Conditions(exposure_s=0.02, **lit), "flat" if photons else "dark"
        kept = bench.expose(kind, Target(), conditions, frames=8, seed=1 + int(photons))
        label, bits = f"{kind} {photons:.0f}", camera.video.bit_depth
        stacks.append(stack_in_memory(kind, kept, conditions, label=label, bit_depth=bits))
    return session_in_memory(stacks, camera=sheet, bit_depth=bits)


def test_sound_frames_are_read_alike_at_once_and_on_demand(machine_vision):
    broken = with_strip_and_lost_rows(machine_vision)
    layout, sound = sound_session(broken)
    for entry, plain in zip(sound.stacks, machine_vision.stacks, strict=True):
        stack, lazy = entry.read(), open_lazy_stack(entry)
        assert np.array_equal(stack.data, lazy.frames(0, len(lazy)))
        kept = np.delete(plain.kept.data, 1, axis=0) if plain is machine_vision.stacks[-1] else None
        assert np.array_equal(stack.data, plain.kept.data if kept is None else kept)
    (note,) = layout_notes(layout)
    assert "columns 90 to 103 are an unexposed strip" in note
    assert "rows 20 to 28 of frame 1 of flat 12000 are 0 DN" in note


def test_frames_that_are_sound_are_read_as_they_are(machine_vision):
    layout, sound = sound_session(machine_vision)
    assert sound is machine_vision and not layout_notes(layout)


def test_a_fit_takes_levels_of_what_is_exposed(machine_vision):
    broken = with_strip_and_lost_rows(machine_vision)
    fitted = fit_sensor(broken, measure(broken, quick=True))
    assert any("unexposed strip" in note for note in fitted.notes)
    for path in ("video.conversion_gain_dn_per_e", "ccd.prnu"):
        parameter = fitted.parameters()[path]
        truth = load_camera("machine-vision").parameters()[path].value
        width = parameter.high - parameter.low
        assert parameter.standing == "fitted"
        assert parameter.low - width < truth < parameter.high + width
    # The strip would lower the level by the fraction of its columns.
    levels = {level.label: level.mean_dn for level in levels_of(sound_session(broken)[1])}
    plain = {level.label: level.mean_dn for level in levels_of(machine_vision)}
    assert levels["flat 5000"] == pytest.approx(plain["flat 5000"], rel=1e-3)


def test_a_validation_compares_what_is_exposed(machine_vision):
    chosen = choose(with_strip_and_lost_rows(machine_vision))
    assert any("lost data" in note for note in chosen.notes)
    frames = chosen.measured["flat 12000"]
    assert frames.shape[2] == 90 and frames.min() > 0.5 * np.median(frames)


def test_the_transfer_of_flats_is_that_of_the_exposed_area(seed):
    scene = ScintillatingFlats(half_frequency_cy_per_px=0.2, exponent=1.5)
    session = scene.session_drawn(np.random.default_rng(seed))
    context = Context(seed=1, quick=True, full_scale_dn=scene.full_scale_dn)
    plain, striped = (
        mtf.measure_flats(shown, context=context)
        for shown in (session, with_strip_and_lost_rows(session))
    )
    for angle in (0.0, 90.0):
        of_plain, of_striped = (
            result.find("post_gain_mtf50", orientation_deg=angle)[0] for result in (plain, striped)
        )
        assert of_striped.status == of_plain.status == "ok"
        assert of_striped.value == pytest.approx(of_plain.value, rel=0.02)
        assert any("unexposed strip" in note for note in of_striped.notes)


def test_rows_of_one_value_that_row_noise_makes_are_not_lost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # The dark of a tube in whole codes: rows shifted by a tenth of a code, and as much noise.
    level = 8.5 + 0.1 * rng.standard_normal((12, 150, 1))
    frames = np.rint(level + 0.1 * rng.standard_normal((12, 150, 200))).astype(np.uint8)
    assert np.any(np.ptp(frames, axis=2) == 0)
    assert not lost_rows(frames)
    frames[3, 50:52] = 0
    assert [(part.frame, part.first, part.stop) for part in lost_rows(frames)] == [(3, 50, 52)]
