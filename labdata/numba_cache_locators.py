"""Where numba keeps compiled loops, and until when: `labdata.numba_cache` names these classes to it."""

from pathlib import Path
from typing import Any

from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

from labdata.numba_cache import stamp_of


class _BySources:
    """Loops are those of a stamp that changes with all sources that may be compiled into them."""

    _py_file: str

    def get_source_stamp(self) -> Any:
        """Return what must be as it was for a kept loop to serve."""
        return stamp_of(Path(self._py_file)) or super().get_source_stamp()  # pyright: ignore[reportAttributeAccessIssue]


class Provided(_BySources, UserProvidedCacheLocator):
    """Kept where NUMBA_CACHE_DIR says."""


class NextToSources(_BySources, InTreeCacheLocator):
    """Kept beside the sources, where they can be written to."""


class OfTheUser(_BySources, UserWideCacheLocator):
    """Kept in the user's own cache."""
