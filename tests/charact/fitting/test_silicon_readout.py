"""Fit of a digital camera's read-out: rows, neighbours, interference, bent response; EMVA 1288
reference set 001.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.fitting import (
    fit_sensor,
    levels_of,
    observations_of,
    stacks_of,
    values_of_description,
)
from charact.fitting.specimen_maps import with_maps
from charact.observables import readout_spectrum
from charact.session_measurement import measure
from charact.validation import validate
from labdata import (
    Camera,
    Conditions,
    FrameStack,
    Result,
    Session,
    Target,
    import_emva1288,
    load_camera,
)
from simulate.lab import LabBench
from tests.truth.sessions import session_in_memory, stack_in_memory

FRAMES = 16
# A noisy read-out: DN^2, cy/px.
READOUT = {
    "readout.row_noise_dn2": 0.4,
    "readout.row_noise_exponent": 0.4,
    "readout.fine_noise_ratio": 1.3,
    "readout.interference_dn2": 0.3,
    "readout.interference_x_cy_per_px": 31 / 120,
    "readout.interference_y_cy_per_px": 0.75,
    "readout.compression_fraction": 0.015,
}
EXPOSURE_S = 0.02


def camera_of(**others: float) -> Camera:
    """Return a machine-vision camera of 96 x 120 px with a noisy read-out."""
    sheet = load_camera("machine-vision")
    sheet = replace(sheet, ccd=replace(sheet.ccd, rows=96, columns=120))
    return sheet.with_values(READOUT | {"video.black_level_dn": 60.0, "ccd.dsnu_e": 4.0} | others)


def session_of(camera: Camera, seed: int, *, lit: bool = True) -> Session:
    """Return darks and flats of a camera; without `lit` the flats do not state their light."""
    bench, dark, stacks = LabBench(camera), Conditions(exposure_s=EXPOSURE_S), []
    for index, photons in enumerate((0.0, 700.0, 2000.0, 5000.0, 9000.0, 13000.0)):
        kind = "flat" if photons else "dark"
        known = replace(dark, photons_per_px=photons, wavelength_nm=530.0) if photons else dark
        kept = bench.expose(kind, Target(), known, frames=FRAMES, seed=1000 * seed + index)
        stacks.append(
            stack_in_memory(
                kind,
                kept,
                known if lit else dark,
                label=f"{kind} {index}",
                bit_depth=camera.video.bit_depth,
            )
        )
    sheet = load_camera("machine-vision")
    return session_in_memory(stacks, camera=sheet, bit_depth=camera.video.bit_depth)


def dark_of(camera: Camera, seed: int, frames: int = FRAMES) -> np.ndarray:
    return (
        LabBench(camera)
        .expose("dark", Target(), Conditions(exposure_s=EXPOSURE_S), frames=frames, seed=seed)
        .data
    )


def test_coloured_read_noise_shows_no_interference(seed):
    plain = {"readout.interference_dn2": 0.0, "readout.fine_noise_ratio": 2.0}
    found = [readout_spectrum(dark_of(camera_of(**plain), seed + number)) for number in range(10)]
    assert all(one is not None and one.interference is None for one in found)


def test_a_stack_of_few_frames_is_not_observed():
    assert readout_spectrum(np.zeros((3, 96, 120))) is None


def test_interference_is_found_with_its_frequency_and_variance(seed):
    pulls = []
    for number in range(8):
        found = readout_spectrum(dark_of(camera_of(), seed + number))
        assert found is not None and found.interference is not None
        one = found.interference
        assert (one.x_cy_per_px, one.y_cy_per_px) == pytest.approx((31 / 120, 0.75))
        pulls.append((one.mean_square_dn2 - 0.3) / one.sd_dn2)
    assert abs(np.mean(pulls)) < 4.5 / np.sqrt(8)
    assert np.std(pulls, ddof=1) < 2.0


def test_observations_agree_with_the_camera_that_was_simulated(seed):
    """Chi-squared of all numbers at the truth, over 8 darks, within 4.5 standard deviations of its
    expectation.
    """
    camera = camera_of()
    values = values_of_description(camera)
    total, count = 0.0, 0
    for number in range(8):
        dark = stack_in_memory(
            "dark",
            FrameStack(data=dark_of(camera, seed + number)),
            Conditions(exposure_s=EXPOSURE_S),
            label="dark",
            bit_depth=camera.video.bit_depth,
        )
        session = session_in_memory([dark], camera=camera, bit_depth=camera.video.bit_depth)
        stacks = stacks_of(session, camera, Result(), levels_of(session))
        for observed in observations_of(stacks):
            total += float(observed.chi_squared(values)[0])
            # The frequency of interference is that of a bin.
            count += 1 if observed.name == "interference" else observed.value.size
    assert count > 40
    assert abs(total - count) < 4.5 * np.sqrt(2.0 * count)


def test_the_read_out_of_a_camera_is_fitted_from_darks_and_flats(seed):
    truth = camera_of()
    session = session_of(truth, seed)
    fitted = fit_sensor(session, measure(session, quick=True), seed=seed)
    expected, missed = truth.parameters(), []
    for path in (
        *READOUT,
        "ccd.read_noise_e",
        "ccd.prnu",
        "ccd.dsnu_e",
        "video.conversion_gain_dn_per_e",
    ):
        one = fitted.parameters()[path]
        assert one.standing == "fitted", path
        missed += [path] if not one.low <= expected[path].value <= one.high else []
    # Of eleven intervals of 95 % three or more miss once in 50 sessions.
    assert len(missed) <= 2, missed


def test_flats_of_unstated_light_tell_gain_and_patterns(seed):
    truth = camera_of()
    session = session_of(truth, seed, lit=False)
    assert [level.light_known for level in levels_of(session)] == [True] + 5 * [False]
    fitted = fit_sensor(session, measure(session, quick=True), seed=seed)
    for path in ("video.conversion_gain_dn_per_e", "ccd.prnu", "ccd.read_noise_e"):
        one, expected = fitted.parameters()[path], truth.parameters()[path].value
        assert one.standing == "fitted"
        assert one.low - (one.high - one.low) < expected < one.high + (one.high - one.low)
    assert fitted.ccd.quantum_efficiency.standing != "fitted"


def test_shading_of_the_light_is_no_response_of_pixels(seed):
    camera = camera_of(**{"ccd.prnu": 0.004})
    session = session_of(camera, seed)
    (shaded,) = [one for one in session.stacks if one.label == "flat 5"]
    ramp = 1.0 + 0.05 * np.linspace(-1.0, 1.0, 96)[None, :, None] ** 2
    kept = replace(shaded.kept, data=np.rint(shaded.kept.data * ramp).astype(np.uint16))
    (plain,) = [one for one in levels_of(session) if one.label == "flat 5"]
    session = replace(session, stacks=(replace(shaded, kept=kept),))
    (found,) = levels_of(session)
    sd = np.hypot(found.spatial_sd_dn2, plain.spatial_sd_dn2)
    assert (
        abs(found.spatial_variance_dn2 - plain.spatial_variance_dn2 * np.mean(ramp) ** 2) < 4.5 * sd
    )


@pytest.fixture(scope="module")
def basler(shared_data, tmp_path_factory) -> Session:
    """A quarter of every fifth exposure of EMVA 1288 reference set 001, of 530 nm, which its file
    leaves out.
    """
    data = shared_data / "emva001_basler_ccd12" / "EMVA1288_Data.txt"
    session = import_emva1288(data, tmp_path_factory.mktemp("emva") / "session")
    stacks = []
    for number, one in enumerate(session.stacks):
        # 26 flats, then darks of the same exposures; the last of each is the stack of 16 frames.
        if number % 26 % 5 == 0:
            known = (
                replace(one.conditions, wavelength_nm=530.0)
                if one.kind == "flat"
                else one.conditions
            )
            frames = one.read()
            kept = replace(frames, data=frames.data[:, :240, :320])
            stacks.append(
                stack_in_memory(one.kind, kept, known, label=one.label, bit_depth=one.bit_depth)
            )
    return replace(session, stacks=tuple(stacks), camera=load_camera("machine-vision"))


def test_a_real_camera_is_fitted_and_its_noise_and_pattern_simulated(basler):
    """K of the standard's reference implementation within 1 %; noise of frames, rows and neighbours
    pass.

    The frames have dust and columns, which no description contains: maps of the specimen do.
    """
    fitted = with_maps(basler, fit_sensor(basler, measure(basler, quick=True), seed=1))
    assert float(fitted.video.conversion_gain_dn_per_e) == pytest.approx(0.2804, rel=0.01)
    # A chequered pattern, one sign or the other in each frame, and row noise of half a DN.
    assert float(fitted.readout.interference_x_cy_per_px) == pytest.approx(0.5, abs=1e-3)
    assert float(fitted.readout.interference_y_cy_per_px) == pytest.approx(0.5, abs=1e-3)
    assert not any("model-misfit" in note for note in fitted.notes)
    found = {one.name: one for one in validate(basler, fitted, seed=1).statistics}
    for name in (
        "level",
        "covariance",
        "autocorrelation",
        "noise-spectrum",
        "rows-and-columns",
        "dark-events",
        "fixed-pattern",
        "defects",
        "shading",
    ):
        assert found[name].passed, (name, found[name].worst)
