"""The registry: every estimator that has an alternative, in one place, with its measured error and time."""

from charact.method.registry import METHODS, Context, Method, choose, register

__all__ = ["METHODS", "Context", "Method", "choose", "register"]
