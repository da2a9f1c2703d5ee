"""Drivers of the test bench: instruments, cameras, interlock and acquisition."""
