"""The shipped camera: what the sheet says follows from its numbers, and draws inside its ranges are
cameras.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import (
    BadInput,
    Camera,
    load_camera,
    load_sensor,
    save_sensor,
    sensor_names,
    to_mapping,
)
from labdata.camera import Draws, Parameter, camera_from_mapping

ELECTRON_C = 1.602176634e-19


@pytest.fixture(scope="module")
def sensor() -> Camera:
    return load_sensor("pulnix-ag5745ef3")


def photons_of(camera: Camera) -> float:
    """Photons of a photoelectron: lm/lm over lumens per photon and photoelectrons per lumen."""
    lumen_s = float(camera.phosphor.luminous_efficacy_lm_per_w) * float(
        camera.phosphor.photon_energy_ev
    )
    per_lumen_s = float(camera.photocathode.luminous_sensitivity_ua_per_lm) * 1e-6
    return float(camera.tube.luminous_gain) / lumen_s / per_lumen_s


def test_the_luminous_gain_is_ten_thousand_photons_a_photoelectron(sensor):
    """Regression truth 3: 15,000 lm/lm at 1350 uA/lm is 10,229 photons per photoelectron."""
    assert photons_of(sensor) == pytest.approx(10229.0, rel=1e-3)


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "gen3-digital-iccd"])
def test_what_is_derived_follows_from_its_factors(name):
    camera = load_sensor(name)
    plate, taper, video = camera.microchannel_plate, camera.taper, camera.video
    open_area = float(plate.open_area_ratio)
    detected = float(plate.film_transmission) * (
        open_area + (1 - open_area) * float(plate.web_recovery)
    )
    assert detected == pytest.approx(float(plate.detection_probability), rel=1e-3)
    fibres = float(taper.core_fraction) * float(taper.bulk_transmission)
    collected = (float(taper.numerical_aperture) / float(taper.demagnification)) ** 2 * fibres
    assert collected == pytest.approx(float(taper.transmission), rel=0.01)
    assert photons_of(camera) / float(plate.electron_gain) == pytest.approx(
        float(camera.phosphor.photons_per_electron), rel=5e-3
    )
    full_scale = 2**video.bit_depth - 1
    filled = (full_scale - float(video.black_level_dn)) / float(camera.ccd.full_well_e)
    assert filled == pytest.approx(float(video.conversion_gain_dn_per_e), rel=1e-3)


def test_the_stages_resolve_together_what_the_tube_resolves(sensor):
    """Regression truth 7: limits of 140, 85 and 120 lp/mm add in quadrature to 62 lp/mm."""
    stages = (
        sensor.photocathode.gap_resolution_lp_per_mm,
        sensor.microchannel_plate.resolution_lp_per_mm,
        sensor.phosphor.resolution_lp_per_mm,
    )
    together = sum(float(stage) ** -2 for stage in stages) ** -0.5
    assert together == pytest.approx(62.15, abs=0.05)
    assert together == pytest.approx(float(sensor.tube.limiting_resolution_lp_per_mm), rel=0.05)


def test_the_tube_keeps_the_contrast_asked_of_its_type(sensor):
    """Regression truth 6: 92, 80, 61 and 38 % at 2.5, 7.5, 15 and 25 lp/mm, within 2.1 %."""
    frequency = np.array([2.5, 7.5, 15.0, 25.0])
    fc, n = float(sensor.tube.mtf_frequency_lp_per_mm), float(sensor.tube.mtf_exponent)
    assert np.abs(np.exp(-((frequency / fc) ** n)) - [0.92, 0.80, 0.61, 0.38]).max() < 0.021


def test_the_sheet_is_quoted_as_it_stands(sensor):
    sheet = {
        "tube.luminous_gain": 15000,
        "tube.limiting_resolution_lp_per_mm": 64,
        "tube.magnification": 1,
        "tube.life_h": 20000,
        "photocathode.ebi_lm_per_cm2": 3.5e-11,
        "photocathode.diameter_mm": 18,
        "ccd.pitch_x_um": 11,
        "ccd.pitch_y_um": 13,
        "video.resolution_horizontal_tvl": 570,
        "video.resolution_vertical_tvl": 359,
        "video.signal_to_noise_db": 50,
        "video.sensitivity_lux": 0.5,
        "video.output_vpp": 1.0,
        "video.impedance_ohm": 75,
        "video.gamma": 1.0,
        "optics.f_number": 1.4,
    }
    parameters = sensor.parameters()
    assert {path: parameters[path].value for path in sheet} == sheet
    assert all(parameters[path].standing == "sheet" for path in sheet)
    assert (sensor.ccd.columns, sensor.ccd.rows, sensor.video.lines) == (768, 493, 525)
    assert sensor.photocathode.spectral_range_nm == (500, 925)
    assert (sensor.photocathode.material, sensor.phosphor.name) == ("GaAs", "P20")
    assert sensor.video.interlaced
    assert sensor.video.automatic_gain


def test_what_is_neither_sheet_nor_definition_has_a_range(sensor):
    exact = {
        "microchannel_plate.reference_v",
        "microchannel_plate.gain_control_counts",
        "taper.numerical_aperture",
        "video.pixel_clock_mhz",
        "video.aperture_correction_db",
        "video.setup_ire",
    }
    unsure = {
        path
        for path, one in sensor.parameters().items()
        if one.standing != "sheet" and one.low is None
    }
    # Limits are what is allowed, which is not known more or less well.
    assert {path for path in unsure if not path.startswith("limits.")} == exact


def test_draws_inside_the_ranges_are_cameras_that_see(sensor, seed):
    rng = np.random.default_rng(seed)
    for _ in range(200):
        drawn = sensor.with_values(
            {
                p: rng.uniform(q.low, q.high)
                for p, q in sensor.parameters().items()
                if q.low is not None
            }
        )
        electrons = float(drawn.taper.transmission) * float(drawn.ccd.quantum_efficiency)
        electrons *= photons_of(drawn)
        filled_by = float(drawn.ccd.full_well_e) / electrons
        # photoelectrons that fill a field pixel; the reference says 40 to 160
        assert 10 < filled_by < 500
        at_64 = np.exp(
            -((64 / float(drawn.tube.mtf_frequency_lp_per_mm)) ** float(drawn.tube.mtf_exponent))
        )
        assert 0.01 < at_64 < 0.12
        assert float(drawn.phosphor.slow_decay_ms) > 5 * float(drawn.phosphor.fast_decay_ms)


@pytest.mark.parametrize("name", sensor_names())
def test_a_description_written_and_read_is_the_same(name, tmp_path):
    camera = load_camera(name)
    path = next(path for path, one in camera.parameters().items() if one.low is not None)
    for one in (camera, camera.with_values({path: camera.parameters()[path].low})):
        save_sensor(one, tmp_path / "s.toml")
        assert load_camera("s.toml", relative_to=tmp_path) == one


def test_posterior_draws_survive_the_file_to_the_last_bit(sensor, seed, tmp_path):

    values = np.random.default_rng(seed).normal(size=(50, 2))
    draws = Draws(
        names=("tube.post_gain_share", "tube.mtf_exponent"),
        values=tuple(map(tuple, values.tolist())),
    )
    fitted = replace(sensor, draws=draws)
    save_sensor(fitted, tmp_path / "f.toml")
    assert load_sensor(tmp_path / "f.toml").draws == draws


def test_a_bare_number_is_an_exact_parameter(sensor):
    for path, parameter in sensor.parameters().items():
        mapping, (stage, name) = to_mapping(sensor), path.split(".")
        mapping[stage][name] = parameter.value
        assert camera_from_mapping(mapping).parameters()[path] == Parameter(
            value=parameter.value
        ), path


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        (
            ("optics", "fnumber"),
            1.4,
            "unknown key 'fnumber' in optics of s.toml; did you mean 'f_number'?",
        ),
        (
            ("tube", "luminous_gain"),
            "high",
            'luminous_gain must be a number or a table, got "high", in tube of s.toml',
        ),
        (
            ("tube", "luminous_gain"),
            True,
            "luminous_gain must be a number or a table, got true, in tube of s.toml",
        ),
        (("ccd", "rows"), 12.5, "rows must be a whole number, got 12.5, in ccd of s.toml"),
        (
            ("tube", "luminous_gain"),
            {"value": 1.0, "low": 2.0, "high": 3.0},
            (
                "a value must lie between its low and high, got 1 for 2..3, in luminous_gain of "
                "tube of s.toml"
            ),
        ),
        (
            ("tube", "luminous_gain"),
            {"value": 1.0, "sorce": "x"},
            "unknown key 'sorce' in luminous_gain of tube of s.toml; did you mean 'source'?",
        ),
    ],
)
def test_what_is_wrong_in_a_sensor_file_is_named_with_its_place(sensor, path, value, sentence):
    mapping = to_mapping(sensor)
    mapping[path[0]][path[1]] = value
    with pytest.raises(BadInput) as error:
        camera_from_mapping(mapping, "s.toml")
    assert str(error.value) == sentence


IMPOSSIBLE = [
    ("optics.f_number", 0.0, "f_number must be positive, got 0"),
    ("optics.vignetting_fraction", 1.5, "vignetting_fraction must lie between 0 and 1, got 1.5"),
    (
        "optics.distortion_fraction",
        -0.6,
        "distortion_fraction must lie between -0.5 and 0.5, got -0.6",
    ),
    ("photocathode.gate_on_off_ratio", 0.5, "gate_on_off_ratio must be at least 1, got 0.5"),
    (
        "photocathode.bright_source_v",
        900.0,
        "bright_source_v must not exceed gap_v, got 900 over 800",
    ),
    ("photocathode.halo_fraction", -0.1, "halo_fraction must lie between 0 and 1, got -0.1"),
    (
        "microchannel_plate.detection_probability",
        1.01,
        "detection_probability must lie between 0 and 1, got 1.01",
    ),
    (
        "microchannel_plate.detection_probability",
        0.0,
        "detection_probability must be positive, got 0",
    ),
    ("microchannel_plate.gain_control_ratio", 1.0, "gain_control_ratio must exceed 1, got 1"),
    ("tube.luminous_gain", float("nan"), "value of a parameter must be a finite number, got nan"),
    ("phosphor.slow_decay_ms", 0.0, "slow_decay_ms must be positive, got 0"),
    ("taper.demagnification", -1.0, "demagnification must be positive, got -1"),
    ("ccd.dsnu_e", -1.0, "dsnu_e must not be negative, got -1"),
    ("ccd.full_well_e", 0.0, "full_well_e must be positive, got 0"),
    ("video.sync_jitter_ns", -1.0, "sync_jitter_ns must not be negative, got -1"),
    ("video.gamma", 0.0, "gamma must be positive, got 0"),
]


@pytest.mark.parametrize(("path", "value", "sentence"), IMPOSSIBLE)
def test_what_no_camera_can_have_is_refused_when_the_camera_is_made(sensor, path, value, sentence):
    with pytest.raises(BadInput) as error:
        sensor.with_values({path: value})
    assert str(error.value) == sentence


@pytest.mark.parametrize(
    ("section", "change", "words"),
    [
        (
            "photocathode",
            lambda cathode: {"wavelength_nm": cathode.wavelength_nm[::-1]},
            "the wavelengths of an efficiency table must rise",
        ),
        (
            "photocathode",
            lambda cathode: {"wavelength_nm": cathode.wavelength_nm[1:]},
            "as many efficiencies, got 20 and 21",
        ),
        ("microchannel_plate", {"stages": 0}, "stages must be at least 1, got 0"),
        ("video", {"bit_depth": 17}, r"bit_depth must lie between 1 and 16, got 17"),
        (
            "video",
            {"bandwidth_mhz": None},
            "without bandwidth_mhz must have no analog video, got lines, pixel_clock_mhz",
        ),
        (
            "video",
            {"sync_jitter_ns": None},
            "with bandwidth_mhz must have all its analog video, got no sync_jitter_ns",
        ),
        (
            "video",
            {"automatic_gain_s": None},
            "with automatic_gain must have automatic_gain_range_db",
        ),
    ],
)
def test_what_no_section_can_be_is_refused(sensor, section, change, words):
    part = getattr(sensor, section)
    with pytest.raises(BadInput, match=words):
        replace(part, **(change(part) if callable(change) else change))


def test_the_analog_camera_has_the_filter_of_its_sheet(sensor):
    assert not sensor.video.digital
    assert sensor.video.low_pass == (6.5, 14.318, 3)


def test_the_digital_intensified_camera_has_its_peak_efficiency_and_fits_the_ccd():
    """0.50 at the peak; more than its 18 mm do not fall on the CCD."""
    camera = load_sensor("gen3-digital-iccd")
    peak = max(camera.photocathode.relative_quantum_efficiency)
    scale = float(camera.photocathode.luminous_sensitivity_ua_per_lm) / 1996.0
    assert peak * scale == pytest.approx(0.50, rel=0.01)
    assert camera.video.digital and camera.video.low_pass is None
    diagonal_mm = 1e-3 * np.hypot(camera.ccd.columns * 13.0, camera.ccd.rows * 13.0)
    assert diagonal_mm == pytest.approx(18.0, rel=0.05)


def test_every_number_of_every_shipped_camera_says_where_it_comes_from_and_draws_are_cameras(seed):
    rng = np.random.default_rng(seed)
    for name in sensor_names():
        camera = load_camera(name)
        known = camera.parameters()
        assert all(
            one.source and one.standing in ("sheet", "default", "derived") for one in known.values()
        ), name
        ranged = {
            path: one
            for path, one in known.items()
            if one.low is not None and path != "ccd.quantum_efficiency"
        }
        for _ in range(20):
            camera.with_values(
                {path: rng.uniform(one.low, one.high) for path, one in ranged.items()}
            )
