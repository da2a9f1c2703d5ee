"""Instruments behind lines: gates, high-voltage supplies, filter wheels and lights, each by its maker's commands."""
