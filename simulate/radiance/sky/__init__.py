"""Natural light: sun, moon and the sky around them."""
