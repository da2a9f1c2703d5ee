"""The judge handed to acquisition: counts the saturated pixels of every frame, all of them."""

import numpy as np

from labdata.frames import FrameStack
from labdata.plan import Step

# A point source is meant to saturate; anything else with more than this share at the highest code was exposed too long.
SHARE_ALLOWED = 1e-3


class SaturationJudge:
    """Complains of stacks in which more pixels sit at the highest code than defects explain."""

    def complaint(self, stack: FrameStack, step: Step) -> str | None:
        """Return one sentence on what is wrong with the stack, or None."""
        if step.kind == "point" or stack.full_scale_dn is None:
            return None
        share = np.count_nonzero(stack.data >= stack.full_scale_dn) / stack.data.size
        if share <= SHARE_ALLOWED:
            return None
        return f"{100 * share:.2g} % of all pixels are at the highest code {stack.full_scale_dn:g} DN"
