"""A region of a frame: ROW, COL, HEIGHT, WIDTH in pixels."""

Region = tuple[int, int, int, int]
