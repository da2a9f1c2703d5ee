"""`make bench`: every benchmark, one line each; exit code 1 if a promised time is missed."""

import sys

from benchmarks import command_line, mtf, noise, simulator, storage


def main() -> int:
    """Run all benchmarks and print a line for each."""
    kept = True
    for module in (command_line, storage, mtf, noise, simulator):
        for row in module.rows():
            print(row.text(), flush=True)
            kept &= row.kept
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
