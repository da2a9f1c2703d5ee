"""Representation of a record on one line, as a notebook shows it."""

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from textwrap import shorten
from typing import Any

WIDTH = 160  # Characters of a representation
SCALARS = (str, int, float, bool)


def short_repr(self: Any) -> str:
    """Return class and fields of a record that differ from their defaults, on one line.

    Arrays are shown by type and shape, containers of other than a few numbers or texts by their
    length, and records in it by their class. For use as the `__repr__` of a dataclass.

    Examples
    --------
    >>> from labdata import FrameStack
    >>> import numpy as np
    >>> FrameStack(data=np.zeros((4, 60, 80), np.uint16), full_scale_dn=255.0)
    FrameStack(data=uint16 (4, 60, 80), full_scale_dn=255)
    """
    shown = []
    for item in fields(self):
        value = getattr(self, item.name)
        if value is None or not item.repr or _is_default(value, item):
            continue
        shown.append(f"{item.name}={_short(value)}")
    return f"{type(self).__name__}({shorten(', '.join(shown), WIDTH, placeholder=' …')})"


def _is_default(value: Any, item: Any) -> bool:
    """Whether a field has its default, or is empty."""
    if hasattr(value, "dtype"):
        return 0 in value.shape
    return value == item.default if item.default is not MISSING else value in ("", (), {})


def _short(value: Any) -> str:
    if hasattr(value, "dtype"):
        return f"{value.dtype} {value.shape}"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list | Mapping):
        members = list(value.values() if isinstance(value, Mapping) else value)
        plain = len(members) <= 4 and all(isinstance(member, SCALARS) for member in members)
        return shorten(repr(value), 60) if plain else f"<{len(members)}>"
    return f"<{type(value).__name__}>" if is_dataclass(value) else shorten(repr(value), 60)
