"""Estimators of MTF, noise, blooming, infrared quantities and tube resolution."""
