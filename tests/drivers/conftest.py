"""Waits of the bench as short as the virtual instruments allow."""

import pytest

from drivers.bench import safe_state
from drivers.instruments import high_voltage


@pytest.fixture
def short_waits(monkeypatch):
    """The virtual output moves much faster than life; so may the waits for it."""
    monkeypatch.setattr(safe_state, "FOLLOW_S", 0.03)
    monkeypatch.setattr(high_voltage, "SETTLE_S", 0.03)
