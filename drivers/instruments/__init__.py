"""Drivers of serial instruments: gates, high-voltage supplies, light sources, filter wheels,
meters.
"""
