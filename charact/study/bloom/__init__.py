"""Halos and blooms of known size, and what methods make of them."""
