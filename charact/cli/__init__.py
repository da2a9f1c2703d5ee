"""Command line of charact; it imports all packages, and none imports it."""

import os


def main() -> None:
    """Run the command `charact`."""
    # The matrices are small: BLAS threads cost more processor time than they save.
    for library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(library, "1")
    # Child processes must not import from the working folder, such as a user's `serial.py`.
    os.environ["PYTHONSAFEPATH"] = "1"
    from charact.cli.application import run

    run()
