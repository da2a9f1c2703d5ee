"""Full wells clip below full scale: a plateau as quiet as the dark, at any level and width."""

import numpy as np
import pytest

from charact.frames.clipping import full_wells

BLACK_DN, READ_DN, GAIN = 100.0, 1.5, 0.2  # DN, DN, DN/e-


def spot(
    rng: np.random.Generator, peak_dn: float, well_dn: float, width_px: float, moves_px: float = 0.0
) -> np.ndarray:
    """Return eight frames of a spot whose charge is cut at a level, moving from frame to frame."""
    y, x = np.indices((48, 56)) - np.array([[[23.3]], [[27.6]]])
    frames = []
    for shift in moves_px * rng.standard_normal(8):
        # Steeper than a Gaussian: a disc with a blur.
        light_e = peak_dn / GAIN * np.exp(-((np.hypot(y, x - shift) / width_px) ** 4))
        charge_dn = np.minimum(GAIN * rng.poisson(light_e), well_dn)
        frames.append(BLACK_DN + charge_dn + READ_DN * rng.standard_normal(y.shape))
    return np.rint(frames).astype(np.uint16)


@pytest.mark.parametrize(("well_dn", "width_px"), [(900.0, 3.0), (2500.0, 6.0), (3300.0, 12.0)])
def test_full_wells_are_a_ceiling(seed: int, well_dn: float, width_px: float) -> None:
    rng = np.random.default_rng(seed)
    ceiling_dn = full_wells(spot(rng, 6.0 * well_dn, well_dn, width_px))
    assert ceiling_dn is not None
    assert BLACK_DN + well_dn - 9.0 * READ_DN < ceiling_dn < BLACK_DN + well_dn
    assert full_wells(spot(rng, 0.9 * well_dn, well_dn, width_px)) is None


def test_a_flat_top_that_moves_is_no_full_well(seed: int) -> None:
    """Its flanks are noisier than its shot noise, its top is not as quiet as the dark."""
    rng = np.random.default_rng(seed)
    assert full_wells(spot(rng, 2500.0, 1e9, 8.0, moves_px=0.3)) is None
