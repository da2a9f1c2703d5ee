"""3-D noise of a stack of frames, rows and columns."""
