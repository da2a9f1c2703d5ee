"""One thing that the doctor looked at: ok, or the fix."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing looked at.

    Parameters
    ----------
    area
        What it belongs to, such as "disk".
    says
        What was found, in a sentence.
    fix
        What to do about it; None where it is ok.
    core
        Whether not even measuring works without it.
    """

    area: str
    says: str
    fix: str | None = None
    core: bool = False

    @property
    def ok(self) -> bool:
        """Whether there is nothing to do."""
        return self.fix is None
