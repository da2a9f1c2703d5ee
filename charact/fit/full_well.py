"""The CCD's full well: no frame measures it, but one that reaches full scale says what it holds at least."""

import numpy as np
from numpy.typing import NDArray

from charact.fit.prior import prior_of
from labdata.sensor import Sensor
from labdata.session import Session

Array = NDArray[np.float64]

PATH = "ccd.full_well_e"
GAIN, BLACK = "video.conversion_gain_dn_per_e", "video.black_level_dn"
CANDIDATES = 400


def fills_the_scale(session: Session) -> bool:
    """Tell whether a point source's frames reach the highest code: the well then holds that much."""
    if session.bit_depth is None:
        return False
    return any(int(entry.read().data.max()) >= 2**session.bit_depth - 1 for entry in session.of_kind("point"))


def full_well_draws(sensor: Sensor, drawn: dict[str, Array], rng: np.random.Generator) -> Array | None:
    """Return the full well that goes with each draw of gain and black level, e-; None where nothing ties it to them.

    Parameters
    ----------
    drawn
        Joint draws by path, shape (draw,) each.

    Notes
    -----
    The prior, cut off below (full scale - black level) / gain. Where a draw's gain leaves nothing of it, that charge.
    """
    prior = prior_of(sensor, (PATH,))
    if not prior.names or GAIN not in drawn:
        return None
    black = drawn.get(BLACK, np.array([float(sensor.video.black_level_dn)]))
    least = (2**sensor.video.bit_depth - 1 - black) / drawn[GAIN]
    tried = np.sort(prior.parameters(prior.draw(rng, CANDIDATES))[:, 0])
    first = np.searchsorted(tried, least)
    picked = first + np.floor(rng.random(least.size) * (CANDIDATES - first)).astype(int)
    return np.where(first < CANDIDATES, tried[np.minimum(picked, CANDIDATES - 1)], least)
