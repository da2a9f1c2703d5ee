"""Infrared imagers: from the radiance of a scene to frames of a scanner, a bolometer array or a
cooled array.
"""
