"""Lamps: their spectra, and where they shine."""
