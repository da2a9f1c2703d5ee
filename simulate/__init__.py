"""Simulation: scene radiance, intensified and solid-state cameras, and virtual instruments."""

from labdata.numba_cache import keep_loops

keep_loops()
