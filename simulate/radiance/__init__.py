"""Spectral radiance of a described scene, by casting rays at its surfaces."""
