"""Draws of what others make, each a table: how often the tool is right on it."""
