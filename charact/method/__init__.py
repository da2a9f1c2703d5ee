"""Registry of estimation methods with their measured error and time."""

from charact.method.registry import (
    METHODS,
    Context,
    Method,
    automatic,
    chart_table,
    choose,
    register,
)

__all__ = ["METHODS", "Context", "Method", "automatic", "chart_table", "choose", "register"]
