"""The forward model of a point series: rings of all levels, forms of the light, and which of them the data bear."""
