"""The intensified camera: a chain of physical stages from the light on the photocathode to digital numbers."""
