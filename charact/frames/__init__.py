"""What a stack of frames holds, measured once for every method."""
