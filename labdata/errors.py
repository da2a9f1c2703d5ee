"""The one error a user can cause: input that breaks a stated rule."""


class BadInput(ValueError):
    """Input that breaks a rule.

    The message is one sentence that names the rule and the value that broke it; the command line prints it
    and exits with 1. Use it for files, settings and parameters that come from outside.
    """
