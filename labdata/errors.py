"""The error of invalid input."""


class BadInput(ValueError):
    """Invalid files, settings or parameters from outside; one sentence with rule and value, exit code 1."""
