"""Signal-to-noise ratio, minimum illumination, and gains that need the illumination."""
