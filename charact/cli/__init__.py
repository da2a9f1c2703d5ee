"""The command line: it wires the rooms together, and nothing imports it."""


def main() -> None:
    """Run the command `charact`."""
    from charact.cli.application import run

    run()
