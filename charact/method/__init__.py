"""Registry of estimation methods with their measured error and time."""

from charact.method.registry import METHODS, Context, Method, choose, register

__all__ = ["METHODS", "Context", "Method", "choose", "register"]
