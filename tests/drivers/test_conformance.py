"""Every pair of driver and virtual instrument keeps the same rules, over a pseudo-terminal."""

from contextlib import ExitStack
from functools import cache

import pytest

from charact.cli.reference import VirtualPair
from drivers.conformance import rules_for
from drivers.instruments.models import models
from simulate.virtual_bench.instrument import virtual_models

pytestmark = pytest.mark.wires

TRIALS = [(name, rule) for name, model in models().items() for rule in rules_for(model)]


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with ExitStack() as pairs:
        yield cache(
            lambda name: pairs.enter_context(VirtualPair(name, tmp_path_factory.mktemp(name)))
        )


@pytest.mark.parametrize(
    ("name", "rule"), TRIALS, ids=[f"{name}-{rule.__name__}" for name, rule in TRIALS]
)
def test_a_pair_keeps_the_rule(running, name, rule):
    pair = running(name)
    pair.heal()
    rule(pair)


def test_every_driver_has_its_virtual_instrument():
    assert set(models()) == set(virtual_models())
