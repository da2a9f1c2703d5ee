"""Scenes whose light is rendered by plan and in full."""
