"""Virtual bench: instruments that answer on real wires, with a simulated tube and camera."""
