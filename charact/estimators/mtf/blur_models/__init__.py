"""Forms of the point spread that lenses and tubes have, and their transfers."""
