"""Flats and darks of known gain and noise, and what methods make of them."""
