"""Light that leaks through a target beside its pinhole is no veiling glare."""

from dataclasses import replace

import numpy as np

from charact.estimators import bloom
from charact.method import Context
from labdata import FrameStack
from tests.truth.bloom import bloom_session
from tests.truth.bloom_light import BloomScene

LEVELS = tuple(np.geomspace(0.5, 500.0, 5))


def glare_of(drawn):
    (found,) = bloom.measure(
        drawn, method="series-forward", context=Context(seed=1, quick=True)
    ).find("veiling_glare")
    return found


def with_leak(drawn, fraction, radius_px):
    """Add even light about the source, a fraction of the source's own at every level."""
    stacks = []
    for stack, overload in zip(drawn.stacks, (0.0, *LEVELS), strict=True):
        data = stack.read().data
        rows, cols = np.ogrid[: data.shape[1], : data.shape[2]]
        lit = np.hypot(rows - data.shape[1] / 2.0, cols - data.shape[2] / 2.0) < radius_px
        # Overload 1 puts the peak of a Gaussian core of 1.3 px at full scale.
        light = fraction * overload * 2.0 * np.pi * 1.3**2 * stack.read().full_scale_dn / lit.sum()
        leaked = np.random.default_rng(1).poisson(np.broadcast_to(light * lit, data.shape))
        codes = np.minimum(data + leaked, stack.read().full_scale_dn).astype(data.dtype)
        stacks.append(
            replace(stack, kept=FrameStack(data=codes, full_scale_dn=stack.read().full_scale_dn))
        )
    return replace(drawn, stacks=tuple(stacks))


def test_light_that_leaks_beside_the_pinhole_is_told_from_glare(seed):
    """Veiling glare of 56 % was ok."""
    drawn = bloom_session(BloomScene(rows=300, cols=400), list(LEVELS), np.random.default_rng(seed))
    found = glare_of(with_leak(drawn, 0.3, 90.0))
    assert found.status == "suspect" and "model-misfit" in found.flags
    assert any("opaque" in note for note in found.notes)


def test_even_glare_is_no_leak(seed):
    drawn = bloom_session(BloomScene(glare_fraction=0.1), list(LEVELS), np.random.default_rng(seed))
    assert not any("opaque" in note for note in glare_of(drawn).notes)
