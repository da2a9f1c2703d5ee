"""Bands of the closed-form pair, with the bloom map of its first frame."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from charact.fusion import Band
from tests.truth.fusion import Pair, bands_of


@pytest.fixture(scope="session")
def pair() -> Pair:
    return Pair(seed=1)


@pytest.fixture(scope="session")
def bands(pair: Pair) -> tuple[Band, Band]:
    return bands_of(pair, pair.frames(np.random.default_rng(100)))


@pytest.fixture(scope="session")
def redraw(bands) -> Callable[..., list[Band]]:
    """Return bands of new frames of a pair, with the noise laws and the bloom map of the first."""

    def draw(pair: Pair, rng: np.random.Generator) -> list[Band]:
        return [
            replace(band, image=image) for band, image in zip(bands, pair.frames(rng), strict=True)
        ]

    return draw
