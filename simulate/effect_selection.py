"""Selection of optional effects: neglect those whose summed influence stays below a tolerance.

An effect has a name, a bound on its influence and a cost. The caller defines the unit of the
influence (for cameras: the temporal noise of the affected pixel) and how an effect is neglected.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from labdata.errors import BadInput

# A change of a tenth of the temporal noise is 0.5 % of its variance.
DEFAULT_TOLERANCE = 0.1


@dataclass(frozen=True, kw_only=True)
class OptionalEffect:
    """Effect that a model may neglect: the largest change that leaving it out makes, and its cost
    once and a frame.
    """

    name: str
    influence: float
    setup_s: float = 0.0
    frame_s: float = 0.0

    def __post_init__(self) -> None:
        if not self.influence >= 0.0:
            raise BadInput(
                f"the influence of {self.name} must not be negative, got {self.influence:g}"
            )


@dataclass(frozen=True, kw_only=True)
class EffectSelection:
    """Retained and neglected effects, the least influence first, and the limit of what those left
    out sum up to.
    """

    tolerance: float
    kept: tuple[OptionalEffect, ...]
    left_out: tuple[OptionalEffect, ...]

    @property
    def influence(self) -> float:
        """Bound on the summed influence of the neglected effects."""
        return sum(effect.influence for effect in self.left_out)

    @property
    def names(self) -> frozenset[str]:
        """Names of the neglected effects."""
        return frozenset(effect.name for effect in self.left_out)

    def text(self, measure: str = "at most, of the noise") -> str:
        """Return the selection as a text table; `measure` is the heading of the influences."""
        effects = sorted((*self.kept, *self.left_out), key=lambda effect: -effect.influence)
        width = max((len(effect.name) for effect in effects), default=6)
        head = f"{'effect':{width}}  {measure:>21}  {'':8}  {'once, ms':>9}  {'a frame, ms':>11}"
        lines = [
            f"{effect.name:{width}}  {_percent(effect.influence):>21}  "
            f"{'left out' if effect in self.left_out else 'kept':8}  {1e3 * effect.setup_s:9.0f}  "
            f"{1e3 * effect.frame_s:11.2f}"
            for effect in effects
        ]
        total = (
            f"left out together: at most {_percent(self.influence)} of the temporal noise, "
            f"of {_percent(self.tolerance)} allowed"
        )
        return "\n".join((head, *lines, total))

    def document(self) -> dict[str, Any]:
        """Return the plan as plain values, for a file."""
        rows = [
            {**asdict(effect), "kept": effect in self.kept}
            for effect in (*self.kept, *self.left_out)
        ]
        return {"tolerance": self.tolerance, "left_out_together": self.influence, "effects": rows}


def _percent(fraction: float) -> str:
    return f"{100.0 * fraction:.3g} %" if fraction < 100.0 else "beyond all bounds"


def select_effects(
    effects: Iterable[OptionalEffect], tolerance: float = DEFAULT_TOLERANCE
) -> EffectSelection:
    """Neglect effects in the order of their influence while the sum stays within the tolerance.

    The tolerance has the unit of the influences; 0 neglects only effects without influence.
    """
    if not tolerance >= 0.0:
        raise BadInput(f"a tolerance must not be negative, got {tolerance:g}")
    retained: list[OptionalEffect] = []
    left_out: list[OptionalEffect] = []
    total = 0.0
    for effect in sorted(effects, key=lambda candidate: (candidate.influence, candidate.name)):
        total += effect.influence
        (left_out if total <= tolerance else retained).append(effect)
    return EffectSelection(tolerance=tolerance, kept=tuple(retained), left_out=tuple(left_out))
