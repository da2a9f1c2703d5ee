"""Cache locators for numba, named to it by `labdata.numba_cache`."""

from pathlib import Path
from typing import Any

from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

from labdata.numba_cache import stamp_of


class _BySources:
    """Cached loops are valid while none of their sources changes."""

    _py_file: str

    def get_source_stamp(self) -> Any:
        """Return the stamp of the sources of a cached loop."""
        return stamp_of(Path(self._py_file)) or super().get_source_stamp()  # pyright: ignore[reportAttributeAccessIssue]


class Provided(_BySources, UserProvidedCacheLocator):
    """Cache in NUMBA_CACHE_DIR."""


class NextToSources(_BySources, InTreeCacheLocator):
    """Cache next to the sources, where these are writable."""


class OfTheUser(_BySources, UserWideCacheLocator):
    """Cache in the user's cache folder."""
