"""How the numbers of noise came about."""

from charact.method import Context
from labdata.measurement import Provenance


def provenance(context: Context, **settings) -> Provenance:
    """Return version, seed and settings."""
    from charact import __version__

    known = {"interlaced": context.interlaced, "quick": context.quick, "pitch_ratio": context.pitch_ratio}
    return Provenance(version=__version__, seed=context.seed, settings=known | settings)
