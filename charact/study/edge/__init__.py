"""Edges of known MTF: scenes, cases, the bound on errors, and what methods make of them."""
