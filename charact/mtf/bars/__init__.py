"""Targets of a few bars."""
