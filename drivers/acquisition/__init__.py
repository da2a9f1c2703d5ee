"""Acquisition of a plan's stacks into a session."""
