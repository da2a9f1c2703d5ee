"""Bars of known MTF: scenes, cases and what methods make of them."""
