"""Gain sweep: joint analysis of flats and darks at all gain settings."""
