"""3-D noise: a stack as a cube of frames, rows and columns."""
