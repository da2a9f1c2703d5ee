"""The error of invalid input."""


class BadInput(ValueError):
    """Invalid input.

    The message is one sentence with the rule and the offending value; the command line prints it
    and exits with 1. Use it for files, settings and parameters that come from outside.
    """
