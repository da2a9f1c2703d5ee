"""Whatever bytes a kernel answers with, the V4L2 driver ends in frames or in a sentence, soon and
in little memory.
"""

import random

import pytest

from tests.fuzz import kernel_answers


@pytest.mark.parametrize("block", range(4))
def test_any_answer_of_the_kernel_ends_in_frames_or_in_a_sentence(block, tmp_path):
    came = [
        kernel_answers.once(random.Random(seed), tmp_path)
        for seed in range(60 * block, 60 * (block + 1))
    ]
    assert 0 < sum(came) < len(came), "some noise is harmless and some is not"
