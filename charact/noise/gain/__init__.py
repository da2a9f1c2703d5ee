"""The gain of the flats of one setting: pooled noise, and the ways of reading a gain from it."""
