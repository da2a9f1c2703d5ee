"""One law of noise against signal."""

import numpy as np
import pytest

from charact.frames import NoiseLaw
from labdata.errors import BadInput

LAW = NoiseLaw(gain_dn=2.0, read_dn=3.0, bend=-1e-4, pattern=4e-4)


def test_variance_is_read_shot_bend_and_pattern():
    signal = np.array([-5.0, 0.0, 10.0, 1e3])
    shot = np.maximum(signal, 0.0)
    assert LAW.sd(signal) ** 2 == pytest.approx(9.0 + 2.0 * shot - 1e-4 * shot**2)
    assert LAW.sd(signal, pattern=True) ** 2 == pytest.approx(9.0 + 2.0 * shot + 3e-4 * shot**2)


def test_the_signal_at_an_snr_has_that_snr_where_the_pattern_allows_it():
    signal = LAW.signal_at(5.0)
    assert signal / LAW.sd(signal, pattern=True) == pytest.approx(5.0)
    assert LAW.signal_at(1.0 / np.sqrt(3e-4)) == np.inf


def test_draws_of_a_law_have_their_own_noise_at_every_signal():
    draws = NoiseLaw(gain_dn=np.array([[1.0], [4.0]]), read_dn=np.array([[0.0], [2.0]]))
    assert draws.sd(np.array([4.0, 9.0, 16.0])).shape == (2, 3)
    assert draws.sd(4.0)[:, 0] == pytest.approx([2.0, np.sqrt(20.0)])
    assert draws.signal_at(2.0)[0, 0] == pytest.approx(4.0)


def test_power_scales_with_the_law():
    assert LAW.scaled(0.25).sd(0.0) == pytest.approx(1.5)
    with pytest.raises(BadInput, match="read_dn of a noise law must not be negative, got -1"):
        NoiseLaw(gain_dn=1.0, read_dn=-1.0)
