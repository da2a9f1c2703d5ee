"""The operator of a real bench: a person, asked on the terminal to place targets, and to set the light by hand."""

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

    def place(
        self, *, kind: Kind, target: Target, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        """Ask for a target, a filter and a light level; return what the meter reads."""
        if illuminance_lux == 0.0:
            self.darken()
            return Conditions(illuminance_lux=0.0)
        behind = "" if filter_density is None else f" behind a filter of density {filter_density:g}"
        print(f"Place the {_words(kind, target)}; set {illuminance_lux:g} lux{behind}.", file=sys.stderr)
        print("What does the meter read, in lux? ", end="", file=sys.stderr, flush=True)
        answer = sys.stdin.readline().strip()
        try:
            return Conditions(illuminance_lux=float(answer), filter_density=filter_density)
        except ValueError:
            raise BadInput(f"the meter's reading must be a number in lux, got {answer!r}") from None


class TargetPlacer:
    """Asks a person to place targets before a lamp that the bench itself lights and puts out."""

    def __init__(self) -> None:
        self._placed: tuple[Kind, Target] | None = None

    def darken(self) -> None:
        """Nothing: the bench puts its lamp out."""

    def place(
        self, *, kind: Kind, target: Target, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        """Ask for a target where another one stands, and wait until it is there; a dark needs none."""
        if kind != "dark" and (kind, target) != self._placed:
            print(f"Place the {_words(kind, target)}, then press Enter. ", end="", file=sys.stderr, flush=True)
            if not sys.stdin.readline():
                raise BadInput(f"somebody must place the {kind} target, got the end of the input")
            self._placed = (kind, target)
        return Conditions(illuminance_lux=0.0)


def _words(kind: Kind, target: Target) -> str:
    details = ", ".join(f"{name} {value}" for name, value in vars(target).items() if value is not None)
    return f"{kind} target ({details or 'no details'})"
