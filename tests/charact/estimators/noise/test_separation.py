"""K, k and F2 come apart where a floor, a light of known size or single photoelectrons tell them,
and nowhere else.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.noise import (
    add_event_gains,
    fit_single_setting,
    photoelectrons_per_photon,
    posterior_of,
    read_levels,
    separate_gains,
    series_of,
    snr_from_specification,
    table_sensitivity_ua_per_lm,
)
from charact.method import Context
from labdata import Conditions, Result, load_sensor, measurement_from_draws
from tests.truth.counted_pulses import Pulses, errors, gaussian, one, session_of

ELECTRON_C = 1.602176634e-19
SECONDS = 0.016


def known_sensor(electron_gain_dn: float, sensitivity: float = 1350.0):
    """A description without doubt of its photocathode, its pixels and its K."""
    sensor = load_sensor("pulnix-ag5745ef3")
    return sensor.with_values(
        {
            "photocathode.luminous_sensitivity_ua_per_lm": sensitivity,
            "taper.demagnification": 1.6,
            "video.conversion_gain_dn_per_e": electron_gain_dn,
        }
    )


def photoelectrons_per_lux(sensor) -> float:
    """S A t / e of a pixel in one exposure."""
    side = [float(pitch) * 1e-6 * 1.6 for pitch in (sensor.ccd.pitch_x_um, sensor.ccd.pitch_y_um)]
    return (
        float(sensor.photocathode.luminous_sensitivity_ua_per_lm)
        * 1e-6
        / ELECTRON_C
        * side[0]
        * side[1]
        * SECONDS
    )


def flats(camera, rng, in_memory, light, levels=(3.0, 10.0, 30.0), frames=8):
    """Darks and flats; `light` gives the conditions of a level."""
    stacks = [("dark", "dark", camera.frames(rng, 0.0, 16), Conditions(exposure_s=SECONDS))]
    stacks += [
        (
            f"flat-{level:g}",
            "flat",
            camera.frames(rng, level, frames),
            replace(light(level), exposure_s=SECONDS),
        )
        for level in levels
    ]
    return in_memory(stacks)


def parted(session, **told) -> Result:
    """K, k and F2 of a session by its flats."""
    context = Context(seed=1, quick=True, **told)
    darks, lit, _ = read_levels(session, context=context, spectra=True)
    series = series_of(lit, darks)
    posterior = fit_single_setting(series, context=context, quick=True).posterior
    return Result(
        measurements=tuple(
            separate_gains(
                series,
                posterior,
                context=context,
                of_signal=(),
                of_noise=(),
                method="covariance-sum",
            )
        )
    )


def test_the_specified_ratio_of_a_tube():
    """Physics reference, 8: 21.0 at S 1350 and noise factor 1.8; 24.3 at 1800."""
    assert snr_from_specification(1350.0, 1.8**2) == pytest.approx(21.0, abs=0.05)
    assert snr_from_specification(1800.0, 1.8**2) == pytest.approx(24.3, abs=0.05)


def test_the_luminous_sensitivity_of_a_table_of_efficiencies():
    """Physics reference, 8: the table of a Gen III cathode as it stands has 1996 uA/lm."""
    cathode = load_sensor("pulnix-ag5745ef3").photocathode
    table = cathode.wavelength_nm, cathode.relative_quantum_efficiency
    scale = max(cathode.relative_quantum_efficiency) / 0.40
    assert table_sensitivity_ua_per_lm(*table) == pytest.approx(1996.0 * scale, rel=0.01)
    # Efficiency at 830 nm of a cathode of 1350 uA/lm: 154 mA/W.
    context = Context(camera=known_sensor(0.05))
    efficiency = photoelectrons_per_photon(context, 830.0, np.random.default_rng(1), 4)[0]
    assert efficiency * 830e-9 / 1.23984e-6 == pytest.approx(0.154, rel=0.02)


@pytest.mark.parametrize("meter", [1.0, 1.06])
def test_a_light_of_known_size_parts_k_from_f2(seed, meter):
    """Also where the meter reads 6 % low, twice its stated error: the interval knows."""
    camera = Pulses(transfer=gaussian(1.0))
    sensor = known_sensor(camera.electron_gain_dn)
    per_lux = photoelectrons_per_lux(sensor)

    def light(level):
        return Conditions(illuminance_lux=level / per_lux / meter, illuminance_relative_sd=0.03)

    session = flats(camera, np.random.default_rng(seed), session_of, light)
    result = parted(session, camera=sensor)
    tube = np.sqrt(1350e-6 * 108e-6 * np.pi * 1e-8 / (2.0 * ELECTRON_C * 10.0) / 2.0)
    for quantity, truth in (
        ("photoelectron_gain", 20.0),
        ("excess_noise_factor", 2.0),
        ("tube_snr", tube),
    ):
        assert one(result, quantity).status == "ok"
        assert abs(errors(one(result, quantity), truth)) < 4.5, one(result, quantity)
    assert errors(one(result, "photoelectron_gain"), 20.0) == pytest.approx(
        np.log(meter) / 0.03, abs=0.5
    )
    assert abs(errors(one(result, "pulse_gain"), 40.0)) < 4.5


def test_photons_of_one_wavelength_part_k_from_f2(seed):
    camera = Pulses(transfer=gaussian(1.0), shape=(128, 128))
    # At 700 nm the table has 0.40 at 1996 uA/lm.
    efficiency = 0.40 * 1350.0 / 1996.0
    session = flats(
        camera,
        np.random.default_rng(seed),
        session_of,
        lambda level: Conditions(
            photons_per_px=level / efficiency, wavelength_nm=700.0, illuminance_relative_sd=0.03
        ),
    )
    result = parted(session, camera=known_sensor(0.05))
    assert abs(errors(one(result, "photoelectron_gain"), 20.0)) < 4.5
    assert "lux" in one(result, "tube_snr").reason


@pytest.mark.parametrize(("sigma_px", "electrons_dn"), [(2.0, 1.0), (1.0, 2.0)])
def test_a_white_floor_under_wide_blur_is_k(seed, sigma_px, electrons_dn):
    """K stands out where blur leaves the pulses little at high frequency: at 1 px they have a
    seventh of it.
    """
    camera = Pulses(gain_dn=20.0, electron_gain_dn=electrons_dn, transfer=gaussian(sigma_px))
    session = flats(camera, np.random.default_rng(seed), session_of, lambda level: Conditions())
    result = parted(session)
    floor, gain = one(result, "conversion_gain"), one(result, "pulse_gain")
    assert floor.status == "ok" and 0.8 * electrons_dn < floor.value < 1.08 * electrons_dn, floor
    assert floor.interval95[0] < electrons_dn < floor.interval95[1]
    # The form of the blur is not believed so far out: half of what it says is in the interval.
    power = float(np.mean(gaussian(sigma_px)(0.35) ** 2)) * 40.0
    assert floor.interval95[1] - floor.interval95[0] > 0.5 * power
    assert abs(errors(gain, 40.0)) < 4.5, gain
    context = Context(seed=1, quick=True)
    darks, lit, _ = read_levels(session, context=context, spectra=True)
    whole = fit_single_setting(series_of(lit, darks), context=context, quick=True).posterior[
        "covariance_gain"
    ]
    assert np.median(whole) - gain.value == pytest.approx(floor.value, rel=0.1)
    for quantity in ("photoelectron_gain", "excess_noise_factor", "tube_snr"):
        assert one(result, quantity).status == "refused"
    reason = one(result, "photoelectron_gain").reason
    assert "illuminance_lux" in reason and "single photoelectrons" in reason


def test_where_no_floor_shows_k_f2_is_refused_unless_the_sensor_tells_k(seed):
    """Blur of 0.4 px leaves two fifths of the pulses' power at high frequency, and all of that
    might be K.
    """
    camera = Pulses(transfer=gaussian(0.4), shape=(128, 128))
    session = flats(camera, np.random.default_rng(seed), session_of, lambda level: Conditions())
    result = parted(session)
    assert one(result, "conversion_gain").status == "refused"
    assert (
        one(result, "pulse_gain").status == "refused"
        and "conversion gain" in one(result, "pulse_gain").reason
    )
    told = one(parted(session, camera=known_sensor(0.05)), "pulse_gain")
    assert abs(errors(told, 40.0)) < 4.5


def found(rng, flux: bool, heights_off: float = 1.0, flux_sd: float = 0.04) -> Result:
    """What flats and dark frames of a camera with k = 12, p = 0.6, F2 = 2 / p would have given."""

    def spread(value, sd):
        return value * np.exp(sd * rng.standard_normal(4000))

    out = [
        measurement_from_draws(
            "pulse_gain",
            "DN",
            (draws := spread(12.0 * 2.0 / 0.6, 0.02)),
            method="covariance-sum",
            posterior=posterior_of("pulse_gain", "DN", draws, 1),
        )
    ]
    heights = spread(heights_off * 12.0 / 0.6, 0.03)
    out.append(
        measurement_from_draws(
            "detected_photoelectron_gain",
            "DN",
            heights,
            method="pulse-law",
            stack="dark",
            posterior=posterior_of("height_dn", "DN", heights, 1),
        )
    )
    out.append(
        measurement_from_draws(
            "photoelectron_gain", "DN/pe", 0.8 * heights, method="pulse-law", stack="dark"
        )
    )
    if flux:
        gain = spread(12.0, flux_sd)
        out.append(
            measurement_from_draws(
                "photoelectron_gain",
                "DN/pe",
                gain,
                method="covariance-sum",
                posterior=posterior_of("photoelectron_gain", "DN/pe", gain, 1),
            )
        )
    return Result(measurements=tuple(out))


@pytest.fixture
def dark_and_flat():
    frames = Pulses(shape=(8, 8)).frames(np.random.default_rng(1), 1.0, 2)
    return session_of(
        [
            ("dark", "dark", frames, Conditions(mcp_v=800.0)),
            ("flat", "flat", frames, Conditions(mcp_v=800.0)),
        ]
    )


@pytest.mark.parametrize("flux", [False, True])
def test_single_photoelectrons_part_k_from_f2_with_the_share_that_they_start(
    seed, dark_and_flat, flux
):
    result = add_event_gains(
        found(np.random.default_rng(seed), flux), dark_and_flat, context=Context(seed=2)
    )
    heights, gain, factor = (
        one(result, name)
        for name in ("pulse_height_factor", "photoelectron_gain", "excess_noise_factor")
    )
    assert heights.value == pytest.approx(2.0, rel=0.01)
    assert abs(errors(heights, 2.0)) < 0.5
    # Without light p is anywhere from 0.45 to 1; with it, k is known to 4 %.
    assert gain.interval95[0] < 12.0 < gain.interval95[1]
    assert factor.interval95[0] < 2.0 / 0.6 < factor.interval95[1]
    width = (gain.interval68[1] - gain.interval68[0]) / gain.value
    assert width == pytest.approx(0.08 if flux else 0.51, rel=0.25)
    assert gain.status == "ok" and gain.method == "covariance-sum + pulse-law"


def test_the_tubes_share_narrows_a_poor_light_and_the_other_way_round(seed, dark_and_flat):
    """p is known to some 8 % from the sheet and k to 20 % from the light."""
    sensor = load_sensor("pulnix-ag5745ef3")
    context = Context(seed=2, camera=sensor)
    result = add_event_gains(
        found(np.random.default_rng(seed), True, flux_sd=0.2), dark_and_flat, context=context
    )
    gain = one(result, "photoelectron_gain")
    assert gain.interval95[0] < 12.0 < gain.interval95[1]
    assert 0.5 * (gain.interval68[1] - gain.interval68[0]) / gain.value < 0.12


def test_light_and_pulses_that_contradict_each_other_say_so(seed, dark_and_flat):
    """Heights of half the truth leave p above one."""
    result = add_event_gains(
        found(np.random.default_rng(seed), True, 0.5), dark_and_flat, context=Context(seed=2)
    )
    assert "model-misfit" in one(result, "photoelectron_gain").flags


def test_pulses_of_another_gain_or_none_change_nothing(seed, dark_and_flat):
    given = found(np.random.default_rng(seed), True)
    dark, flat = dark_and_flat.stacks
    other = replace(dark_and_flat, stacks=(replace(dark, conditions=Conditions(mcp_v=700.0)), flat))
    assert add_event_gains(given, other, context=Context()) is given
    without = replace(given, measurements=given.measurements[:1])
    assert add_event_gains(without, dark_and_flat, context=Context()) is without
