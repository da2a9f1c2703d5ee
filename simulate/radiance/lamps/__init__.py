"""Lamps: spectra and intensity distributions."""
