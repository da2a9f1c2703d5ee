"""Spectral radiance of scenes: light sources, materials, geometry, integrator and renderers."""
