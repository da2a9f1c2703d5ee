"""Closed-form pairs of an intensified and a thermal frame: truth, cases and what fusion makes of
them.
"""
