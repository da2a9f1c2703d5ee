"""Statistics of one stack of dark or uniformly illuminated frames."""
