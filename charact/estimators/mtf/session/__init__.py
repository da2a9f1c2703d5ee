"""What all targets of a session tell together."""
