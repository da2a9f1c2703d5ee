"""Gain of the flats of one setting: pooled noise and its models."""
