"""Virtual instruments, each with its model: one file an instrument."""
