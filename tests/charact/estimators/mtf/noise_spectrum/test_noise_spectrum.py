"""The noise of flats tells the MTF after the gain: pulses of closed form, whose transfer is known
exactly.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf import crossing_frequency
from charact.estimators.mtf.noise_spectrum import model, pooled_spectrum
from charact.estimators.mtf.noise_spectrum import result as of_spectrum
from charact.method import Context
from charact.transfer.blur_model import BlurModel
from labdata import BadInput
from tests.truth.counted_pulses import errors
from tests.truth.scintillating_flats import ScintillatingFlats


def measured(scene: ScintillatingFlats, seed: int, method: str = "auto", **more):
    context = Context(
        seed=1, quick=True, full_scale_dn=scene.full_scale_dn, interlaced=scene.interlaced, **more
    )
    return mtf.measure_flats(
        scene.session_drawn(np.random.default_rng(seed)), method=method, context=context
    )


def half(result, angle=0.0):
    (found,) = result.find("post_gain_mtf50", orientation_deg=angle)
    return found


@pytest.mark.parametrize(("frequency", "exponent"), [(0.15, 2.0), (0.3, 1.3)])
def test_the_transfer_is_found_along_rows_and_columns_with_its_pixel(seed, frequency, exponent):
    scene = ScintillatingFlats(
        half_frequency_cy_per_px=frequency, exponent=exponent, anisotropy=1.2
    )
    result = measured(scene, seed)
    for angle, name in ((0.0, "mtf_post_gain"), (90.0, "mtf_post_gain_vertical")):
        found = half(result, angle)
        assert found.status == "ok", found
        assert abs(errors(found, scene.mtf50(vertical=angle == 90.0))) < 4.5
        assert found.interval68[1] - found.interval68[0] < 0.1 * found.value
        curve = result.curves[name]
        truth = scene.mtf(curve.frequency_cy_per_px, vertical=angle == 90.0)
        sd = 0.5 * (curve.interval68[1] - curve.interval68[0])
        assert np.all(np.abs(curve.value - truth) < 4.5 * sd + 1e-4)


def test_the_white_floor_is_told_from_the_pulses_without_a_dark(seed):
    """K mu + r^2 + 1/12 over all noise at frequency 0: electrons as strong as a twentieth of the
    pulses.
    """
    scene = ScintillatingFlats(
        electron_gain_dn=2.0,
        read_noise_dn=4.0,
        photoelectrons=(8.0,),
        darks=False,
        rows=96,
        cols=96,
    )
    (found,) = measured(scene, seed).find("white_noise_fraction")
    light = 8.0 * scene.gain_dn
    white, pulses = scene.electron_gain_dn * light + 16.0, 2.0 * scene.gain_dn * light
    assert abs(errors(found, white / (white + pulses))) < 4.5
    assert "no-darks" in found.flags


def test_a_free_shape_agrees_with_the_form_and_is_less_sure(seed):
    scene = ScintillatingFlats(exponent=1.4, rows=96, cols=96)
    form, free = measured(scene, seed), measured(scene, seed, "noise-spectrum-free")
    assert abs(errors(half(free), scene.mtf50())) < 4.5
    assert np.ptp(half(free).interval68) > np.ptp(half(form).interval68)
    assert "mtf_post_gain_free" in form.curves


def test_fields_are_taken_apart_and_light_shared_by_them_is_allowed_for(seed):
    scene = ScintillatingFlats(interlaced=True, rows=192, cols=96, lag=0.3)
    found = half(measured(scene, seed), 90.0)
    assert found.status == "ok" and any("image lag between" in note for note in found.notes)
    assert any("are not detectable" in note for note in found.notes)
    # The square pixel of the fields here is one row high, as that of an undescribed camera is taken
    # to be.
    assert abs(errors(found, scene.mtf50(vertical=True))) < 4.5


STILL = {"gain_dn": 1e-3, "read_noise_dn": 0.0, "electron_gain_dn": 0.0, "black_dn": 60.3}


@pytest.mark.parametrize(
    ("knobs", "said"),
    [
        ({"gain_dn": 0.0}, "white"),
        ({"photoelectrons": (1e-9, 2e-9)}, ""),
        (STILL, ""),
        ({"frames": 1}, "flat-1"),
    ],
    ids=["white", "no light", "codes that never change", "single frames"],
)
def test_flats_without_pulses_are_refused(seed, knobs, said):
    found = half(measured(ScintillatingFlats(rows=96, cols=96, **knobs), seed))
    assert found.status == "refused" and said in found.reason


@pytest.mark.parametrize(
    ("flag", "knobs"),
    [
        ("gamma", {"gamma": 1.4}),
        ("too-few-frames", {"frames": 2}),
        ("too-few-frames", {"photoelectrons": (8.0,)}),
        ("clipped", {"read_noise_dn": 30.0}),
        ("no-darks", {"darks": False}),
        ("model-misfit", {"exponent": 3.8}),
        (
            "model-misfit",
            {"read_noise_dn": 20.0, "read_smoothing_px": 1.0, "darks": False, "black_dn": 300.0},
        ),
    ],
)
def test_what_breaks_it_is_said(seed, flag, knobs):
    assert (
        flag in half(measured(ScintillatingFlats(**{"rows": 96, "cols": 96, **knobs}), seed)).flags
    )


def test_images_too_small_for_a_spectrum_are_bad_input(seed):
    with pytest.raises(BadInput, match="48 x 48"):
        measured(ScintillatingFlats(rows=24, cols=24), seed)


def test_intervals_hold_what_they_promise(seed):
    """Four cameras: squared errors over variance, with room for the pair of families that both
    fit.
    """
    from tests.truth.cases.noise_spectrum import chart_cases

    off = []
    for case in chart_cases(seed, 4):
        scene = case.draw.__self__
        off.append(errors(half(measured(scene, case.seed)), scene.mtf50()))
    # Chi squared of 4 is beyond 18.5 once in a thousand.
    assert np.sum(np.square(off)) < 18.5


def test_the_whole_posterior_agrees_with_the_curvature(seed):
    scene = ScintillatingFlats(
        half_frequency_cy_per_px=0.2, exponent=2.0, rows=96, cols=96, frames=6
    )
    session = scene.session_drawn(np.random.default_rng(seed))
    whole, quick = (
        half(mtf.measure_flats(session, context=Context(seed=1, quick=way, full_scale_dn=4095.0)))
        for way in (False, True)
    )
    assert whole.posterior.sampler == "importance" and whole.status == "ok"
    assert abs(errors(quick, whole.value)) < 0.5


def peak(scene: ScintillatingFlats, seed: int) -> model.SpectrumOptimum:
    context = Context(seed=1, quick=True, full_scale_dn=scene.full_scale_dn)
    session = scene.session_drawn(np.random.default_rng(seed))
    spectrum = pooled_spectrum.spectrum_of(pooled_spectrum.select_flats(session, context), context)
    return model.optimum_under_model(
        spectrum, model.readout_of(context), BlurModel(core="exponential")
    )


def test_scattered_light_that_is_said_not_to_show_gains_what_is_said(seed):
    """A power with so much light scattered and no noise: the form fits it worse by 12 in ln L, and
    MTF50 is higher.
    """
    before = peak(ScintillatingFlats(half_frequency_cy_per_px=0.15, frames=16), seed)
    near, _ = of_spectrum.scatter_limits(before)
    veiled = of_spectrum.UndetectedComponent(
        shape=before.problem.shape, fraction=near.fraction, length_px=near.length_px
    )
    power = replace(before.problem, shape=veiled).model(before.point[None])[0]
    after = model.optimum_under_model(
        replace(before.problem.spectrum, power_dn2=power),
        before.problem.known,
        before.problem.shape,
    )
    assert -after.problem.log_likelihood_at(after.point) == pytest.approx(
        of_spectrum.SURE, rel=0.25
    )
    frequency = np.geomspace(0.01, 0.5, 4000)

    def curve(one: model.SpectrumOptimum):
        return of_spectrum.transfer_of(
            one, one.point[None], frequency, vertical=False, pitch_ratio=1.0
        )

    veil = (
        1.0
        - near.fraction
        + near.fraction / (1.0 + (2.0 * np.pi * frequency * near.length_px) ** 2)
    )
    told, true = (
        float(crossing_frequency(frequency, one, 0.5)[0])
        for one in (curve(after), curve(before) * veil)
    )
    assert 100.0 * (1.0 - true / told) == pytest.approx(near.lower_percent, rel=0.25)
