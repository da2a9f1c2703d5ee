"""Resolution of a tube against light: closed forms, the published table, and what is missing by
name.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.tube import add_resolution, contrast_threshold, highest_resolved
from charact.method import Context
from labdata import Conditions, Curve, Result, load_sensor, measurement_from_sd

ELECTRON_C = 1.602176634e-19
FREQUENCY = np.linspace(0.0, 0.5, 101)


def tube_mtf(lp_per_mm):
    """Johnson's form of a tube of 64 lp/mm with a pixel of 18 um at the photocathode."""
    return np.exp(-((lp_per_mm / 26.25) ** 1.184)) * np.abs(np.sinc(0.018 * lp_per_mm))


# Limiting resolution, lp/mm, of a tube of 1350 uA/lm with F^2 = 3.3, against illuminance, lux, at
# two contrasts.
@pytest.mark.parametrize(
    ("contrast", "lux", "limit"),
    [
        (1.0, 1e-6, 7.8),
        (1.0, 1e-5, 16.7),
        (1.0, 1e-4, 25.6),
        (1.0, 1e-3, 33.9),
        (0.3, 1e-6, 2.9),
        (0.3, 1e-5, 8.3),
        (0.3, 1e-4, 16.4),
        (0.3, 1e-3, 25.3),
    ],
)
def test_the_limiting_resolution_is_that_of_the_published_table_within_a_step_of_the_usaf_target(
    contrast, lux, limit
):
    lit, dark = (light * 1350e-6 / ELECTRON_C * 1e-6 for light in (lux, 2.5e-7))
    frequency = np.geomspace(0.1, 60.0, 400)[None]
    threshold = contrast_threshold(
        tube_mtf(frequency), frequency, np.array([lit**2 / ((lit + dark) * 3.3)]), 0.2
    )
    assert highest_resolved(threshold / contrast, frequency) == pytest.approx(limit, rel=0.122)


def test_noise_limits_contrast_by_the_root_of_the_light_and_modulation_limits_bright_light():
    mtf, frequency = np.array([0.6]), np.array([8.0])
    dim, bright = (contrast_threshold(mtf, frequency, np.array([n])) for n in (1e4, 4e4))
    assert dim / bright == pytest.approx(2.0)
    assert contrast_threshold(mtf, frequency, np.array([1e14])) == pytest.approx(0.03 / 0.6)


def test_nothing_resolved_is_not_a_number_and_all_resolved_is_the_last_frequency():
    frequency = np.array([[1.0, 2.0, 4.0]] * 2)
    limit = highest_resolved(np.array([[2.0, 3.0, 4.0], [0.1, 0.2, 0.3]]), frequency)
    assert np.isnan(limit[0])
    assert limit[1] == 4.0


SIGMA_PX = 0.7  # Blur of the synthetic camera


def mtf_curve() -> Curve:
    value = np.exp(-2.0 * (np.pi * SIGMA_PX * FREQUENCY) ** 2)
    return Curve(
        frequency_cy_per_px=FREQUENCY,
        value=value,
        interval68=np.stack([0.995 * value, 1.005 * value]),
    )


def session_result(
    lux=(1e-5, 1e-4), gain_dn=12.0, per_lux_dn=4e5, **changes
) -> tuple[Result, dict[str, Conditions]]:
    """A camera of a Gaussian blur whose summed covariance is `gain_dn` times the signal."""
    signal = [per_lux_dn * one for one in lux]
    labels = [f"flat-{number}" for number, _ in enumerate(lux)]
    transfer = {
        "figure": "photon-transfer",
        "reference": "dark",
        "label": labels,
        "fitted": [True] * len(lux),
        "signal_dn": signal,
        "covariance_dn2": [gain_dn * one for one in signal],
        "covariance_sd_dn2": [0.01 * gain_dn * one for one in signal],
        "dark_variance_dn2": [0.0] * len(lux),
    }
    result = Result(
        measurements=(
            measurement_from_sd("mtf50", "cy/px", 0.19, 0.001, method="joint", orientation_deg=0.0),
            measurement_from_sd(
                "covariance_gain", "DN", gain_dn, 0.1, method="covariance-sum", flags=("drift",)
            ),
            measurement_from_sd("tube_snr", "1", 19.0, 0.3, method="covariance-sum"),
        ),
        curves={"mtf_joint": mtf_curve()},
        evidence={"photon-transfer": transfer},
    )
    conditions = {
        label: Conditions(
            **(
                {"illuminance_lux": one, "exposure_s": 0.016, "illuminance_relative_sd": 0.03}
                | changes
            )
        )
        for label, one in zip(labels, lux, strict=True)
    }
    return result, conditions


@pytest.fixture(scope="module")
def context() -> Context:
    return Context(camera=load_sensor("pulnix-ag5745ef3"), interlaced=True, seed=1)


def test_limits_and_contrasts_of_a_known_camera_lie_in_their_intervals(context):
    found = add_resolution(*session_result(), context=context)
    sensor = context.camera
    pitch_mm = 1e-3 * float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification)
    area_mm2 = (
        2.0 * pitch_mm * 1e-3 * float(sensor.ccd.pitch_y_um) * float(sensor.taper.demagnification)
    )
    fine = np.linspace(0.1, 0.5 / pitch_mm, 20_000)
    mtf = np.exp(-2.0 * (np.pi * SIGMA_PX * fine * pitch_mm) ** 2)
    for label, lux in (("flat-0", 1e-5), ("flat-1", 1e-4)):
        effective = 4e5 * lux / 12.0 / (area_mm2 * 0.016)
        # Signal of a bar of 1/2f by 7/2f at contrast 1 over the noise of bar and space, in 0.1 s.
        bar = 7.0 / (4.0 * fine**2)
        snr = (
            2.0
            * mtf
            * 8.0
            / np.pi**2
            * effective
            * bar
            * 0.1
            / np.sqrt(2.0 * bar * 0.1 * effective)
        )
        (limit,) = found.find("limiting_resolution", stack=label)
        low, high = limit.interval95
        assert low < fine[snr > 2.8].max() < high
        assert limit.unit == "lp/mm"
        assert limit.flags == ("drift",)
        for m in found.find("mrc", stack=label):
            contrast = 2.8 / np.interp(m.frequency_cy_per_px / pitch_mm, fine, snr)
            assert (m.value is None and contrast > 1.0) or m.interval95[
                0
            ] < contrast < m.interval95[1]
    (bright,) = found.find("limiting_resolution", stack=None)
    limit = np.sqrt(np.log(1 / 0.03) / 2) / (np.pi * SIGMA_PX) / pitch_mm
    low, high = bright.interval95
    assert min(low, limit) <= min(limit, 0.5 / pitch_mm) <= high
    (merit,) = found.find("figure_of_merit")
    assert merit.value == pytest.approx(bright.value * 19.0, rel=0.01)


def test_the_rate_of_counted_photoelectrons_is_that_of_the_tubes_signal_to_noise_ratio(context):
    """Spot of 0.2 mm at 108 microlux in 1/20 s has that ratio, by its definition."""
    result, conditions = session_result()
    one = add_resolution(result, conditions, context=context).find("mrc", stack="flat-1")[0]
    sensor = context.camera
    pitch_mm = (
        1e-3
        * float(sensor.taper.demagnification)
        * np.array([float(sensor.ccd.pitch_x_um), 2.0 * float(sensor.ccd.pitch_y_um)])
    )
    snr_108 = np.sqrt(4e5 * 108e-6 / 12.0 / pitch_mm.prod() / 0.016 * np.pi * 0.1**2 / 20.0)
    frequency = one.frequency_cy_per_px / pitch_mm[0]
    mtf = np.exp(-2.0 * (np.pi * SIGMA_PX * one.frequency_cy_per_px) ** 2)
    in_bar = snr_108 * np.sqrt(
        (1e-4 / 108e-6) * (1.75 / frequency**2) * 0.1 / (np.pi * 0.1**2 / 20.0)
    )
    assert (
        one.interval95[0] < 2.8 / (np.sqrt(2.0) * mtf * 8.0 / np.pi**2 * in_bar) < one.interval95[1]
    )


def test_pixels_that_limit_the_resolution_are_told(context):
    result, conditions = session_result()
    flat = Curve(
        frequency_cy_per_px=FREQUENCY,
        value=1.0 - FREQUENCY,
        interval68=np.stack([1 - FREQUENCY] * 2),
    )
    found = add_resolution(replace(result, curves={"mtf_joint": flat}), conditions, context=context)
    (bright,) = found.find("limiting_resolution", stack=None)
    assert any("Nyquist" in note for note in bright.notes)
    (merit,) = found.find("figure_of_merit")
    assert merit.status == "suspect" and "aliased" in merit.flags


@pytest.mark.parametrize(
    ("lacking", "word"),
    [
        ("curves", "edge, bars or a point source"),
        ("noise", "darks and flats"),
        ("light", "illuminance_lux"),
    ],
)
def test_what_is_missing_is_named(lacking, word, context):
    result, conditions = session_result()
    if lacking == "curves":
        result = replace(result, curves={})
    if lacking == "noise":
        result = replace(result, evidence={})
    if lacking == "light":
        conditions = {label: Conditions(exposure_s=0.016) for label in conditions}
    found = add_resolution(result, conditions, context=context)
    (refused,) = found.find("mrc")
    assert word in refused.reason
    assert refused.refusal == "missing"
    assert bool([m for m in found.find("limiting_resolution") if m.value is not None]) == (
        lacking != "curves"
    )


def test_a_camera_without_a_tube_has_no_such_quantity():
    result, conditions = session_result()
    assert add_resolution(result, conditions, context=Context(seed=1)) is result
