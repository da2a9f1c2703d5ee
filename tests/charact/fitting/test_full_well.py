"""Wells hold the charge that frames show, whatever else of them is unknown."""

from dataclasses import replace

import numpy as np
import pytest

from charact.fitting import (
    ShownLevel,
    fit_sensor,
    full_well_draws,
    levels_of,
    prior_of,
    shown_levels,
)
from charact.session_measurement import measure
from labdata import Camera, Conditions, FrameStack, Session, load_camera, load_sensor
from tests.truth.sessions import session_in_memory, stack_in_memory

WELL, GAIN = "ccd.full_well_e", "video.conversion_gain_dn_per_e"
BLACK = "video.black_level_dn"
K_DN_PER_E, BLACK_DN, READ_DN, BITS = 0.33, 30.0, 2.0, 12
EXPOSED = Conditions(exposure_s=0.02)


@pytest.fixture
def sheet() -> Camera:
    return load_sensor("pulnix-ag5745ef3")


def test_every_draw_fills_the_scale_and_is_the_prior_where_it_does_anyway(sheet, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gain = rng.uniform(0.0035, 0.006, 4000)
    black = np.array([float(sheet.video.black_level_dn)])
    shown = ShownLevel(label="point", level_dn=255.0, conditions=Conditions())
    well = full_well_draws(sheet, {GAIN: gain, BLACK: black}, (shown,), rng)
    assert well is not None
    level = well * gain + black
    assert level.min() >= 255.0 * (1 - 1e-9)
    free = gain > 0.0059
    prior = prior_of(sheet, (WELL,)).draw(rng, 4000)[:, 0]
    least = 243.0 / 0.0059
    kept = prior[prior > least]
    error = kept.std() * np.sqrt(1.0 / kept.size + 1.0 / free.sum())
    assert abs(well[free].mean() - kept.mean()) < 4.0 * error


def test_without_lit_frames_nothing_is_said(sheet, seed: int) -> None:
    assert full_well_draws(sheet, {}, (), np.random.default_rng(seed)) is None


def linear_session(charges_e: tuple[float, ...], well_e: float, seed: int) -> Session:
    """Return a dark and flats of a linear camera in plain NumPy, whose wells hold `well_e`."""
    rng, stacks = np.random.default_rng(seed), []
    for index, charge in enumerate((0.0, *charges_e)):
        electrons = np.minimum(rng.poisson(charge, (12, 90, 110)), well_e)
        codes = np.rint(BLACK_DN + K_DN_PER_E * electrons + rng.normal(0.0, READ_DN, (12, 90, 110)))
        frames = FrameStack(data=np.clip(codes, 0, 2**BITS - 1).astype(np.uint16))
        light = {"photons_per_px": charge / 0.6, "wavelength_nm": 530.0} if charge else {}
        stacks.append(
            stack_in_memory(
                "flat" if charge else "dark",
                frames,
                replace(EXPOSED, **light),
                label=f"stack {index}",
                bit_depth=BITS,
            )
        )
    return session_in_memory(stacks, camera=load_camera("machine-vision"), bit_depth=BITS)


@pytest.mark.parametrize(("well_e", "full"), [(3000.0, 2), (6500.0, 1), (1e6, 0)])
def test_flats_of_full_wells_below_full_scale_are_left_out(
    well_e: float, full: int, seed: int
) -> None:
    """Their level does not follow the light: the gain was a hundredth of the true one."""
    session = linear_session((500.0, 1500.0, 2500.0, 5000.0, 8000.0), well_e, seed)
    levels = levels_of(session)
    assert len(levels) == 6 - full
    fitted = fit_sensor(session, measure(session, quick=True), seed=seed)
    gain = fitted.parameters()[GAIN]
    assert gain.low < K_DN_PER_E < gain.high < 1.2 * K_DN_PER_E
    assert any("of full wells" in note for note in fitted.notes) == bool(full)


def test_a_dark_is_no_full_well_for_having_less_noise_than_one_of_long_exposure(seed: int) -> None:
    """Behind a clamp both have one level, and either may be the lower one."""
    rng = np.random.default_rng(seed)
    session = linear_session((500.0, 2500.0), 1e6, seed)
    noise_dn = rng.normal(0.0, 4.0 * READ_DN, (12, 90, 110))
    codes = np.rint(BLACK_DN - 0.2 + noise_dn).clip(0).astype(np.uint16)
    long = stack_in_memory(
        "dark",
        FrameStack(data=codes),
        replace(EXPOSED, exposure_s=1.0),
        label="long",
        bit_depth=BITS,
    )
    assert len(levels_of(replace(session, stacks=(*session.stacks, long)))) == 4


@pytest.mark.parametrize(
    ("brightest_e", "well_e"), [(6000.0, 9000.0), (9500.0, 14000.0), (12800.0, 30000.0)]
)
def test_no_draw_holds_less_than_the_brightest_flat(
    brightest_e: float, well_e: float, seed: int
) -> None:
    """Also of one that clips at full scale; the true well, to the error of the gain within 4 %, is
    not excluded.
    """
    charges = tuple(brightest_e * part for part in (0.05, 0.2, 0.45, 0.7, 1.0))
    session = linear_session(charges, well_e, seed)
    fitted = fit_sensor(session, measure(session, quick=True), seed=seed)
    drawn = dict(zip(fitted.draws.names, np.array(fitted.draws.values).T, strict=True))
    flat_dn = float(np.quantile(session.stacks[-1].read().data, 0.99))
    bend = drawn["readout.compression_fraction"]
    signal_dn = drawn[WELL] * drawn[GAIN] / (1.0 - 2.1 * bend)
    # A bent response does not turn back beyond its maximum.
    signal_dn = np.minimum(signal_dn, (2**BITS - 1) / np.maximum(2.0 * bend, 1e-9))
    well_dn = drawn[BLACK] + signal_dn * (1.0 - bend * signal_dn / (2**BITS - 1))
    assert well_dn.min() > 0.999 * flat_dn
    well = fitted.parameters()[WELL]
    assert well.standing == "prior" and "charge that frames show" in well.source
    assert drawn[WELL].min() < 1.04 * well_e


def test_levels_are_those_of_lit_frames_of_fixed_gain(seed: int) -> None:
    session = linear_session((500.0, 3000.0, 1500.0), 20000.0, seed)
    automatic = replace(EXPOSED, automatic_gain=True)
    edge = FrameStack(data=np.full((1, 90, 110), 2000, np.uint16))
    others = (
        stack_in_memory("edge", edge, EXPOSED, label="edge", bit_depth=BITS),
        stack_in_memory("edge", edge, automatic, label="automatic", bit_depth=BITS),
    )
    session = replace(session, stacks=(*session.stacks, *others))
    shown = {level.label: level.level_dn for level in shown_levels(session, levels_of(session))}
    assert shown.keys() == {"stack 2", "edge"}
    # The thousandth of Poisson and read noise is 3.1 sd above the mean, of which 3 of the read
    # noise are taken off.
    sd_dn = np.hypot(K_DN_PER_E * np.sqrt(3000.0), READ_DN)
    expected = BLACK_DN + K_DN_PER_E * 3000.0 + 3.09 * sd_dn - 3.0 * READ_DN - 0.5
    assert shown["stack 2"] == pytest.approx(expected, abs=0.5 * sd_dn)
    assert 2000.0 - shown["edge"] == pytest.approx(3.0 * READ_DN + 0.5, abs=1.0)
