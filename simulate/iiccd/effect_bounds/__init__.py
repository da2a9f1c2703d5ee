"""Bounds on the influence of each camera effect, and the selection of effects."""
