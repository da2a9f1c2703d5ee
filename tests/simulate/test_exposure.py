"""Pictures and radiance reach the plate, or the silicon, with all their light."""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, Conditions, Target, load_camera
from simulate import LabBench
from simulate.camera import (
    CameraModel,
    Ccd,
    Register,
    Slot,
    StageImage,
    camera_from_description,
    mcp_input_from_photoelectrons,
    mcp_input_from_radiance,
    pattern,
    tube_photometry,
)
from simulate.radiance import LUMENS_PER_WATT, RadianceCube, luminous_efficiency, planck

# Pictures and radiance reach the plate with all their light: flats stay flat, spots keep their
# sum, lux meets lux.


NM = np.arange(360.0, 1100.0, 10.0)
IDEAL_LENS = {
    "optics__vignetting_fraction": 0.0,
    "optics__distortion_fraction": 0.0,
    "optics__focal_length_mm": 1e6,
}


def _progressive(sensor):
    return replace(sensor, video=replace(sensor.video, interlaced=False))


@pytest.fixture
def silicon() -> CameraModel:
    description = load_camera("emccd-512")
    small = camera_from_description(
        replace(description, ccd=replace(description.ccd, rows=40, columns=56))
    )
    assert not small.has_tube
    return small


@pytest.fixture(params=["interlaced", "progressive", "silicon"])
def camera(request, plain, silicon):
    dark = {"photocathode__ebi_lm_per_cm2": 0.0}
    return {
        "interlaced": CameraModel(plain(40, 56, **dark)),
        "progressive": CameraModel(_progressive(plain(40, 56, **dark))),
        "silicon": silicon,
    }[request.param]


def _per_pixel(camera, light) -> np.ndarray:
    """Photoelectrons that every pixel as read collects."""
    from simulate.camera import Collection

    return Collection(row_pairs=camera.description.interlaced).mean(light).values


def test_a_flat_picture_of_x_gives_x_photoelectrons_per_pixel_as_read(camera):
    pixels = _per_pixel(
        camera, mcp_input_from_photoelectrons(camera, np.full(camera.shape, 3.0), Conditions())
    )
    assert pixels.shape == camera.shape
    assert pixels == pytest.approx(3.0, rel=1e-4)


def test_a_spot_keeps_its_photoelectrons(camera):
    """Those of an interlaced camera are each read twice, in the rows of two fields."""
    image = np.zeros(camera.shape)
    image[20, 30] = 1000.0
    light = mcp_input_from_photoelectrons(camera, image, Conditions())
    at_mcp = 500.0 if camera.description.interlaced else 1000.0
    assert light.values.sum(dtype=float) == pytest.approx(at_mcp, rel=1e-3)


def test_a_row_of_the_picture_is_read_by_its_own_row(plain):
    sharp = {
        "photocathode__halo_fraction": 0.0,
        "tube__post_gain_share": 1.0,
        "photocathode__ebi_lm_per_cm2": 0.0,
    }
    camera = CameraModel(plain(40, 56, **sharp))
    image = np.zeros(camera.shape)
    image[17] = 8.0
    rows = _per_pixel(camera, mcp_input_from_photoelectrons(camera, image, Conditions())).mean(
        axis=1
    )
    assert rows[16:19] == pytest.approx([2.0, 4.0, 2.0], abs=0.15)
    assert rows.sum() == pytest.approx(8.0, rel=1e-3)
    assert (rows * np.arange(40)).sum() / rows.sum() == pytest.approx(17.0, abs=0.01)


def test_dark_emission_is_added(plain):
    camera = CameraModel(plain(40, 56))
    nothing = mcp_input_from_photoelectrons(
        camera, np.zeros(camera.shape), Conditions(temperature_c=31.0)
    )
    cathode = camera.stage(Slot.PHOTOCATHODE, Conditions())
    expected = 2.0 * cathode.ebi_per_s_cm2 * cathode.open_s * camera.cells.cell_area_cm2
    assert nothing.values == pytest.approx(expected, rel=1e-4)


def _scene(lux: float, gathering_sr: float) -> RadianceCube:
    fine = np.arange(360.0, 1100.0, 1.0)
    per_unit = (
        LUMENS_PER_WATT
        * np.sum(luminous_efficiency(fine) * planck(fine, tube_photometry.LAMP_K))
        * gathering_sr
    )
    spectrum = lux / per_unit * planck(NM, tube_photometry.LAMP_K)
    return RadianceCube(wavelength_nm=NM, radiance=np.tile(spectrum[:, None, None], (1, 20, 28)))


def test_a_scene_of_known_radiance_meets_the_bench_of_known_illuminance(plain):
    sensor = plain(40, 56, **IDEAL_LENS)
    camera, lux = CameraModel(sensor), 2e-4
    scene = mcp_input_from_radiance(camera, _scene(lux, camera.lens().gathering_sr), Conditions())
    bench = LabBench(sensor).mcp_input("flat", Target(), Conditions(illuminance_lux=lux))
    assert scene.values == pytest.approx(bench.values, rel=1e-3)


def test_a_near_scene_is_dimmer_by_the_square_of_one_plus_magnification(plain):
    camera = CameraModel(
        plain(40, 56, optics__focal_length_mm=25.0, photocathode__ebi_lm_per_cm2=0.0)
    )
    scene = _scene(1e-4, camera.lens().gathering_sr)
    far, near = (
        mcp_input_from_radiance(camera, scene, Conditions(), distance_m=distance).values
        for distance in (None, 0.125)
    )
    centre = tuple(n // 2 for n in far.shape)
    assert near[centre] / far[centre] == pytest.approx(1.0 / 1.25**2, rel=2e-3)


def test_light_leaks_through_the_shut_gate(plain):
    camera = CameraModel(
        plain(40, 56, photocathode__gate_on_off_ratio=1e3, photocathode__ebi_lm_per_cm2=0.0)
    )
    scene = _scene(1e-4, camera.lens().gathering_sr)
    whole, short = (
        mcp_input_from_radiance(camera, scene, Conditions(gate_ns=gate)).values.mean(dtype=float)
        for gate in (None, 1e3)
    )
    assert short / whole == pytest.approx(
        (1e-6 + (camera.field_s - 1e-6) / 1e3) / camera.field_s, rel=1e-3
    )


def test_a_bright_scene_is_blurred_by_the_protected_gap(plain):
    camera = CameraModel(plain(40, 56, photocathode__halo_fraction=0.0))
    image = np.zeros(camera.shape)
    image[:, 28:] = 1.0
    per_lux = (
        tube_photometry.photoelectrons_per_lumen_s(camera.description) * 1e-4 * camera.field_s * 2.0
    )
    per_lux *= camera.cells.pitch_x_mm * camera.cells.pitch_y_mm * 1e-2
    dim, bright = (
        mcp_input_from_photoelectrons(camera, lux * per_lux * image, Conditions()).values[60]
        / np.float32(lux)
        for lux in (1e-3, 4.0)
    )
    assert np.diff(bright).max() < 0.99 * np.diff(dim).max()
    assert bright.sum() == pytest.approx(dim.sum(), rel=1e-2)


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        *(
            (
                lambda camera, value=value: mcp_input_from_photoelectrons(
                    camera, np.where(np.eye(*camera.shape), value, 0.0), Conditions()
                ),
                "finite and not negative",
            )
            for value in (np.nan, np.inf, -1.0)
        ),
        (
            lambda camera: mcp_input_from_photoelectrons(camera, np.zeros((4, 4)), Conditions()),
            "the frame's shape",
        ),
        (
            lambda camera: mcp_input_from_radiance(
                camera, _scene(1e-4, 1.0), Conditions(), distance_m=0.01
            ),
            "twice the focal length",
        ),
        (lambda _: Register(gain=0.5), "gain"),
        (lambda _: Register(gain=np.inf), "gain"),
        (lambda _: Register(stages=0), "stages"),
        (lambda _: Register(clock_induced_e=-1.0), "clock_induced_e"),
    ],
)
def test_impossible_light_and_registers_are_refused(camera, make, rule):
    with pytest.raises(BadInput, match=rule):
        make(camera)


def test_descriptions_become_cameras_with_or_without_a_tube(sheet, silicon):
    whole = camera_from_description(sheet)
    assert whole.has_tube
    assert whole.geometry and whole.local_depletion
    assert isinstance(camera_from_description(silicon.description), CameraModel)


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "gen3-digital-iccd", "emccd-512"])
def test_every_shipped_camera_takes_frames_that_average_to_its_mean(name, seed):
    description = load_camera(name)
    camera = camera_from_description(
        replace(description, ccd=replace(description.ccd, rows=36, columns=48))
    )
    conditions = Conditions(temperature_c=-70.0 if name == "emccd-512" else 25.0)
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 4.0), conditions)
    stream = camera.frames(light, conditions, seed=seed)
    means = np.array([next(stream).astype(float).mean() for _ in range(60)])
    blocks = means.reshape(10, 6).mean(axis=1)
    expected = float(camera.mean_frame(light, conditions).mean(dtype=float))
    assert abs(means.mean() - expected) < 4.5 * blocks.std(ddof=1) / np.sqrt(10) + 0.02


@pytest.mark.parametrize("tier", ["chain", "fast"])
def test_frames_of_a_depleted_core_average_to_its_mean(plain, tier, seed):
    """A core that the plate's own load compresses several times, its surroundings little."""
    from tests.simulate.samplers import drawn_by

    sensor = plain(36, 48, microchannel_plate__strip_current_ua_per_cm2=0.05, ccd__full_well_e=1e9)
    sensor = sensor.with_values({"video.conversion_gain_dn_per_e": 0.02})
    camera = CameraModel(sensor, local_depletion=True)
    image = np.full(camera.shape, 3.0)
    image[14:22, 20:28] = 3000.0
    light = mcp_input_from_photoelectrons(camera, image, Conditions())
    mean = camera.mean_frame(light, Conditions()).astype(float) - 400.0
    free = CameraModel(sensor.with_values({"microchannel_plate.strip_current_ua_per_cm2": 1e9}))
    undiminished = free.mean_frame(light, Conditions()).astype(float) - 400.0
    core, around = np.s_[15:21, 21:27], np.s_[2:8, 2:12]
    assert mean[core].mean() < 0.6 * undiminished[core].mean()
    assert mean[around].mean() > 0.85 * undiminished[around].mean()
    stream = drawn_by(tier, camera, light, Conditions(), seed=seed)
    taken = np.stack([next(stream) for _ in range(80)]).astype(float) - 400.0
    for place in (core, around):
        per_frame = taken[(slice(None), *place)].mean(axis=(1, 2)).reshape(10, 8).mean(axis=1)
        error = per_frame.std(ddof=1) / np.sqrt(10)
        assert abs(per_frame.mean() - mean[place].mean()) < 4.5 * error + 1e-3 * mean[place].mean()


# A camera without a tube: Poisson charge, a register that doubles the variance, dark patterns,
# clocked charge.


COLD = Conditions(temperature_c=-70.0)


@pytest.fixture
def description():
    shipped = load_camera("emccd-512")
    return replace(shipped, ccd=replace(shipped.ccd, rows=120, columns=160)).with_values(
        {"ccd.prnu": 0.0, "ccd.smear_fraction": 0.0}
    )


def _frames(
    camera: CameraModel, level: float, conditions: Conditions, seed: int, count: int = 20
) -> np.ndarray:
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, level), conditions)
    stream = camera.frames(light, conditions, seed=seed)
    return np.stack([next(stream) for _ in range(count)]).astype(float)


def _moments(gain: float, stages: int, inputs: int, seed: int, shape: float = 1.0) -> np.ndarray:
    register = Register(gain=gain, stages=stages, pulse_height_shape=shape)
    light = StageImage(values=np.full((400, 500), inputs, np.float32))
    return register.draw(light, np.random.default_rng(seed)).values.astype(float)


@pytest.mark.parametrize(
    ("gain", "stages"), [(1.0, 500), (1.3, 50), (4.0, 200), (300.0, 536), (1000.0, 536)]
)
@pytest.mark.parametrize("inputs", [1, 7])
def test_register_has_its_gain_and_the_excess_noise_of_its_stages(gain, stages, inputs, seed):
    """Robbins and Hadwen's F^2; each electron's output has the variance G^2 (F^2 - 1)."""
    out = _moments(gain, stages, inputs, seed)
    factor = Register(gain=gain, stages=stages).excess_noise_factor
    spread = np.sqrt(inputs * gain**2 * (factor - 1.0))
    assert (
        abs(out.mean() - gain * inputs) <= 4.5 * spread / np.sqrt(out.size) + 1e-6 * gain * inputs
    )
    squares = (out - gain * inputs) ** 2
    assert (
        abs(squares.mean() - spread**2)
        <= 4.5 * squares.std() / np.sqrt(out.size) + 1e-6 * spread**2
    )


def test_register_is_that_of_electrons_multiplied_stage_by_stage(seed):
    """Event by event: in each of 100 stages every electron frees another with the same small
    probability.
    """
    stages, gain, events = 100, 12.0, 60_000
    chance = gain ** (1.0 / stages) - 1.0
    rng = np.random.default_rng(seed)
    electrons = np.full(events, 3)
    for _ in range(stages):
        electrons = electrons + rng.binomial(electrons, chance)
    ours = _moments(gain, stages, 3, seed).ravel()
    relative = (electrons - 3 * gain) ** 2
    variance = 3 * gain**2 * (Register(gain=gain, stages=stages).excess_noise_factor - 1.0)
    assert abs(relative.mean() - variance) < 4.5 * relative.std() / np.sqrt(events)
    for level in (0.05, 0.5, 0.95, 0.99):
        assert np.quantile(ours, level) == pytest.approx(
            np.quantile(electrons, level), rel=0.04, abs=1.0
        )


def test_clamp_takes_the_mean_of_dark_and_clocked_charge_and_leaves_their_noise(seed):
    register = Register(gain=50.0, stages=536, clock_induced_e=2.0, dark_e=3.0)
    wells = StageImage(
        values=np.random.default_rng(seed).poisson(3.0, (500, 500)).astype(np.float32)
    )
    out = register.draw(wells, np.random.default_rng(seed + 1)).values.astype(float)
    expected = 50.0**2 * register.excess_noise_factor * 5.0
    assert abs(out.mean()) < 4.5 * np.sqrt(expected / out.size)
    squares = out**2
    assert abs(squares.mean() - expected) < 4.5 * squares.std() / np.sqrt(out.size)


def test_excess_noise_grows_from_one_to_two():
    factors = [Register(gain=gain).excess_noise_factor for gain in (1.0, 2.0, 10.0, 1000.0)]
    assert factors == sorted(factors)
    assert factors[0] == pytest.approx(1.0, abs=1e-12)
    assert factors[-1] == pytest.approx(2.0, abs=0.04)


@pytest.mark.parametrize("em_gain", [1.0, 300.0])
@pytest.mark.parametrize("level", [0.5, 20.0])
def test_photon_transfer_of_an_emccd(description, em_gain, level, seed):
    """Variance K^2 (G^2 F^2 (n + dark + clocked) + r^2) + 1/12, with F^2 = 1 where nothing
    multiplies.
    """
    camera = CameraModel(description)
    conditions = replace(COLD, em_gain=em_gain)
    frames = _frames(camera, level, conditions, seed)
    dn_per_e = float(description.video.conversion_gain_dn_per_e)
    register = camera.chain(conditions).stages[4]
    assert isinstance(register, Register)
    electrons = level + register.dark_e + register.clock_induced_e
    expected = dn_per_e**2 * (
        em_gain**2 * register.excess_noise_factor * electrons
        + float(description.ccd.read_noise_e) ** 2
    )
    black = float(description.video.black_level_dn)
    signal = frames.mean() - black
    assert (
        abs(signal - dn_per_e * em_gain * level)
        < 4.5 * np.sqrt(expected / frames.size) + 1e-4 * signal
    )
    squares = (frames - frames.mean()) ** 2
    assert (
        abs(squares.mean() - expected - 1 / 12)
        < 4.5 * squares.std() / np.sqrt(squares.size) + 1e-3 * expected
    )


def test_frames_follow_from_their_number_alone(description):
    camera = CameraModel(description)
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 2.0), COLD)
    run = camera.frames(light, COLD, seed=3)
    third = [next(run) for _ in range(4)][3]
    alone = next(camera.frames(light, COLD, seed=3, first_frame=3))
    assert third.tobytes() == alone.tobytes()
    assert alone.dtype == np.uint16


def test_dark_signal_is_fixed_positive_and_of_its_spread():
    dark = pattern.dark_signal_map((400, 500), 16.0, 5.0, 9)
    assert dark.mean(dtype=float) == pytest.approx(16.0, rel=0.01)
    assert dark.std(dtype=float) == pytest.approx(5.0, rel=0.02)
    assert dark.min() > 0.0
    assert np.array_equal(dark, pattern.dark_signal_map((400, 500), 16.0, 5.0, 9))


def test_dark_pattern_stays_from_frame_to_frame_and_is_in_the_mean(seed):
    ccd = Ccd(quantum_efficiency=0.5, full_well_e=1e5, dark_e=40.0, dsnu_e=5.0, pattern_seed=2)
    nothing = StageImage(values=np.zeros((60, 80), np.float32))
    rng = np.random.default_rng(seed)
    average = np.mean([ccd.draw(nothing, rng).values for _ in range(400)], axis=0)
    mean = ccd.mean(nothing).values
    assert mean.std(dtype=float) == pytest.approx(5.0, rel=0.05)
    assert (average - mean).std() == pytest.approx(np.sqrt(40.0 / 400), rel=0.05)


def test_dark_pattern_doubles_with_the_dark_current(description):
    doubling = float(description.ccd.dark_current_doubling_k)
    camera = CameraModel(description)
    cold, warm = (camera.chain(Conditions(temperature_c=t)).stages[3] for t in (0.0, doubling))
    assert isinstance(cold, Ccd) and isinstance(warm, Ccd)
    assert warm.dsnu_e == pytest.approx(2.0 * cold.dsnu_e) and warm.dark_e == pytest.approx(
        2.0 * cold.dark_e
    )


def test_exposure_and_gain_out_of_reach_are_refused(description):
    camera = CameraModel(description)
    for conditions in (
        Conditions(em_gain=2000.0),
        Conditions(exposure_s=0.0),
        Conditions(exposure_s=1.0),
        Conditions(automatic_gain=True),
        Conditions(mcp_v=800.0),
        Conditions(gain_control=100.0),
    ):
        with pytest.raises(BadInput):
            camera.chain(conditions)


def test_a_pattern_beyond_the_dark_charge_is_of_offsets_without_hot_pixels():
    ccd = Ccd(quantum_efficiency=0.5, full_well_e=1e5, dark_e=0.6, dsnu_e=1.2, pattern_seed=2)
    level = ccd.mean(StageImage(values=np.zeros((300, 400), np.float32))).values.astype(float)
    assert level.std() == pytest.approx(1.2, rel=0.02)
    # Exponential charge of 0.6 e- has an excess kurtosis of 6, offsets none: 6 (0.6 / 1.2)^4
    # together.
    assert np.mean((level - level.mean()) ** 4) / level.var() ** 2 - 3.0 == pytest.approx(
        6.0 / 16.0, abs=0.15
    )
