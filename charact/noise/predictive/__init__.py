"""Frames drawn from what was fitted to the flats, beside those measured: is the model of the noise the right one?"""
