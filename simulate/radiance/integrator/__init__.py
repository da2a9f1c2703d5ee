"""Monte Carlo integrator: light transport from lamps and sky over surfaces to a camera."""
