"""What every driver must do with its instrument: the rules that each pair of driver and instrument is tried against.

A rule is a function of a `ConformancePair`; it returns when the pair keeps it and raises AssertionError, or whatever
the driver raises wrongly, when it does not. `rules_for` returns those of a model, so that the maker of a new driver can
run them in a test of their own, or by the command `charact conform MODEL`.
"""

from drivers.instruments.conformance import conformance_pair, roles  # noqa: F401  (their rules are entered)
from drivers.instruments.conformance.conformance_pair import ConformancePair, Rule, rules_for

__all__ = ["ConformancePair", "Rule", "rules_for"]
