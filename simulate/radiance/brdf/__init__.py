"""Bidirectional reflectance distribution functions (BRDFs), reciprocal and energy-conserving."""
