"""Lines to instruments: ports, bytes, answers, and the adapter between a port and GPIB."""
