"""How light gets from lamps and sky by way of surfaces into a camera."""
