"""Functions for scripts and notebooks: arrays, files and sessions in, results with plots and tables
out.
"""
