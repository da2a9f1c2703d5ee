"""Point sources and pinholes."""
