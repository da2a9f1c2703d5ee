"""The cameras and sessions of `counted_pulses` as fixtures."""

from collections.abc import Callable

import pytest

from labdata import Session
from tests.truth.counted_pulses import Pulses, flat_series, memory_of, session_of


@pytest.fixture(scope="session")
def pulses() -> type[Pulses]:
    return Pulses


@pytest.fixture(scope="session")
def keeping() -> Callable[[float], tuple[float, ...]]:
    return memory_of


@pytest.fixture(scope="session")
def series() -> Callable[..., Session]:
    return flat_series


@pytest.fixture(scope="session")
def in_memory() -> Callable[..., Session]:
    return session_of
