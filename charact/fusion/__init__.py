"""Fusion of visible and thermal frames: rules, registration, noise reduction and scores."""
