"""Edges: each file that is named after a method is one."""
