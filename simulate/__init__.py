"""The model of the rig: radiance of a scene, the intensified camera that sees it, and virtual instruments."""

from labdata.numba_cache import keep_loops

keep_loops()
