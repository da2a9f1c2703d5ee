"""MTF of slanted edges; every registered method has a module of its name."""
