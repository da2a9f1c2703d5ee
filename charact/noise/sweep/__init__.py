"""Noise against gain: the flats and darks of all settings together."""
