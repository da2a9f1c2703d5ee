"""What the light adds: signal-to-noise ratio against it, and the gains that it parts."""
