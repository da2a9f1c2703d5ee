"""Transfer functions of the fit at the far ends of their parameters, where a climb to the peak
looks once.
"""

import numpy as np
import pytest

from charact.transfer import image_tube


def test_a_tube_of_any_exponent_passes_all_below_its_cut_off_and_nothing_above():
    passed = image_tube(np.array([0.0, 1.0, 10.0, 300.0]), np.array([10.0]), np.array([500.0]))
    assert passed == pytest.approx([1.0, 1.0, np.exp(-1.0), 0.0])


def test_a_tube_that_has_no_part_after_the_gain_passes_all():
    assert image_tube(np.array([300.0]), np.array([10.0]), np.array([500.0]), 0.0) == pytest.approx(
        [1.0]
    )
