"""Economy: effects that stay below a tolerance together are left out, and the plan says which, why and what it saves.

Generic: an effect is a name, a bound on its influence and its cost. What the influence is measured in (here and for
cameras, the temporal noise of the pixel it acts on) is the caller's affair, as is what leaving out means.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from labdata.errors import BadInput

# A tenth of the temporal noise is lost in it: 0.5 % of its variance.
DEFAULT_TOLERANCE = 0.1


@dataclass(frozen=True, kw_only=True)
class OptionalEffect:
    """Something that a model may leave out.

    Parameters
    ----------
    name
        What it is called.
    influence
        Bound on the largest change that leaving it out makes, in the unit of the tolerance.
    setup_s, frame_s
        Estimated time that it costs once and for each frame, s.
    """

    name: str
    influence: float
    setup_s: float = 0.0
    frame_s: float = 0.0

    def __post_init__(self) -> None:
        if not self.influence >= 0.0:
            raise BadInput(f"the influence of {self.name} must not be negative, got {self.influence:g}")


@dataclass(frozen=True, kw_only=True)
class EffectSelection:
    """Which effects are kept.

    Parameters
    ----------
    tolerance
        What all effects left out may change together, in the unit of their influence.
    kept, left_out
        The effects, the least influence first.
    """

    tolerance: float
    kept: tuple[OptionalEffect, ...]
    left_out: tuple[OptionalEffect, ...]

    @property
    def influence(self) -> float:
        """Bound on what the effects left out change together."""
        return sum(effect.influence for effect in self.left_out)

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects left out."""
        return frozenset(effect.name for effect in self.left_out)

    def text(self, measure: str = "at most, of the noise") -> str:
        """Return the plan as a table for people, under the heading that says what influences are."""
        everything = sorted((*self.kept, *self.left_out), key=lambda effect: -effect.influence)
        width = max((len(effect.name) for effect in everything), default=6)
        head = f"{'effect':{width}}  {measure:>21}  {'':8}  {'once, ms':>9}  {'a frame, ms':>11}"
        lines = [
            f"{effect.name:{width}}  {_percent(effect.influence):>21}  "
            f"{'left out' if effect in self.left_out else 'kept':8}  "
            f"{1e3 * effect.setup_s:9.0f}  {1e3 * effect.frame_s:11.2f}"
            for effect in everything
        ]
        together = (
            f"left out together: at most {_percent(self.influence)} of the temporal noise, "
            f"of {_percent(self.tolerance)} allowed"
        )
        return "\n".join((head, *lines, together))

    def document(self) -> dict[str, Any]:
        """Return the plan as plain values, for a file."""
        rows = [{**asdict(effect), "kept": effect in self.kept} for effect in (*self.kept, *self.left_out)]
        return {"tolerance": self.tolerance, "left_out_together": self.influence, "effects": rows}


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %" if share < 100.0 else "beyond all bounds"


def select_effects(effects: Iterable[OptionalEffect], tolerance: float = DEFAULT_TOLERANCE) -> EffectSelection:
    """Leave out effects, the least first, as long as their influences add up to no more than the tolerance.

    Parameters
    ----------
    effects
        What may be left out.
    tolerance
        What may change, in the unit of the influences; 0 leaves out what has no influence at all.
    """
    if not tolerance >= 0.0:
        raise BadInput(f"a tolerance must not be negative, got {tolerance:g}")
    kept: list[OptionalEffect] = []
    left_out: list[OptionalEffect] = []
    total = 0.0
    for effect in sorted(effects, key=lambda each: (each.influence, each.name)):
        total += effect.influence
        (left_out if total <= tolerance else kept).append(effect)
    return EffectSelection(tolerance=tolerance, kept=tuple(kept), left_out=tuple(left_out))
