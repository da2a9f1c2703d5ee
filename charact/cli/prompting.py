"""The operator of a real bench: a person, asked on the terminal to place targets and set the light."""

import sys

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.session import Kind
from labdata.target import Target


class PromptingOperator:
    """Asks a person and believes the meter that the person reads."""

    def darken(self) -> None:
        """Ask for the light to be blocked, waiting for nobody."""
        print("Block the light now.", file=sys.stderr)

    def place(self, *, kind: Kind, target: Target, illuminance_lux: float) -> Conditions:
        """Ask for a target and a light level; return what the meter reads."""
        if illuminance_lux == 0.0:
            self.darken()
            return Conditions(illuminance_lux=0.0)
        details = ", ".join(f"{name} {value}" for name, value in vars(target).items() if value is not None)
        print(f"Place the {kind} target ({details or 'no details'}); set {illuminance_lux:g} lux.", file=sys.stderr)
        print("What does the meter read, in lux? ", end="", file=sys.stderr, flush=True)
        answer = sys.stdin.readline().strip()
        try:
            return Conditions(illuminance_lux=float(answer))
        except ValueError:
            raise BadInput(f"the meter's reading must be a number in lux, got {answer!r}") from None
