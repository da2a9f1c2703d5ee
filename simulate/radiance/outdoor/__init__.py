"""A place out of doors: objects, lamps, camera, weather and time, read from TOML and meshes."""
