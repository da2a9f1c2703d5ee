"""Figures of the documentation, by simulation."""
