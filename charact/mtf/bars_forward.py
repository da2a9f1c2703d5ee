"""The forward method for bar targets: amplitudes at the fundamental and at zero, against the exact object spectrum."""
