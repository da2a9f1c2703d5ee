"""Conformance tests of pairs of driver and instrument.

A rule is a function of a `ConformancePair`; it returns if the pair obeys it and raises
AssertionError, or the error of the driver, if it does not. `rules_for` returns the rules of a
model, so that the author of a new driver can run them in a test, or by the command `charact conform
MODEL`.
"""

from drivers.conformance import conformance_pair, roles  # noqa: F401  (their rules are entered)
from drivers.conformance.conformance_pair import ConformancePair, Rule, rules_for

__all__ = ["ConformancePair", "Rule", "rules_for"]
