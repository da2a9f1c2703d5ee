"""The command line: it wires the rooms together, and nothing imports it."""

import os


def main() -> None:
    """Run the command `charact`."""
    # Our matrices are small: threads of the linear algebra library cost more processor time than they save.
    for library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(library, "1")
    # A child process imports nothing from the folder in which the user works, such as a `serial.py` of theirs.
    os.environ["PYTHONSAFEPATH"] = "1"
    from charact.cli.application import run

    run()
