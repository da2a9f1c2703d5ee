"""How long the light of a source that goes out stays on the screen, from stacks in which it does."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.over_time import FrameSeries
from labdata.measurement import Measurement, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

# Shares of the source's light to which it is to fall, by quantity.
SHARES = {"recovery_time_10": 0.1, "recovery_time_1": 0.01}
# Share of the brightest frame above which the source is on; below it in all later frames it is out.
ON_SHARE = 0.6
LEAST_ON, LEAST_OUT = 2, 2
# Standard deviations of the lit frames, and their least share of the light, by which a frame has begun to fade.
FADED, LEAST_SCATTER = 4.0, 0.005
# Noise over the share to be read at which it can still be read.
NOISE_SHARE = 0.35
DRAWS = 2000


def frames_before_switch_off(watched: FrameSeries) -> int | None:
    """Return the number of frames before the source goes out for good, or None where it does not."""
    light = watched.light_by_frame
    if len(light) < LEAST_ON + LEAST_OUT or not np.isfinite(light).all() or light.max() <= 0:
        return None
    on = light > ON_SHARE * light.max()
    count = int(np.argmin(on)) if not on.all() else len(on)
    if count < LEAST_ON or count > len(on) - LEAST_OUT or on[count:].any() or light[-1] > 0.5 * light[:count].mean():
        return None
    # Frames that have begun to fade are no longer lit ones.
    early = light[: max(LEAST_ON, count // 2)]
    least = early.mean() - FADED * max(float(early.std(ddof=1)), LEAST_SCATTER * float(early.mean()))
    while count > LEAST_ON and light[count - 1] < least:
        count -= 1
    return count


def recoveries(watched: tuple[FrameSeries, ...], seed: int, **fields: Any) -> list[Measurement]:
    """Return the times until 10 % and 1 % of a source's light are left, of each stack in which it goes out.

    Notes
    -----
    When it went out is known to lie between two frames: the interval holds it. Between frames the light falls like an
    exponential. Pixels that the lit source saturates are left out.
    """
    found = [(one, count) for one in watched if (count := frames_before_switch_off(one)) is not None]
    if not found:
        reason = "no stack shows the source going out: it must be lit in two frames at least and out in all that follow"
        return [make_refusal(name, "s", reason, **fields) for name in SHARES]
    return [_time(one, count, name, seed, **fields) for one, count in found for name in SHARES]


def _time(watched: FrameSeries, count: int, name: str, seed: int, **fields: Any) -> Measurement:
    common = {"stack": watched.label, **fields}
    if len(watched.time_s) == 0:
        return make_refusal(name, "s", "the times of the frames are unknown", **common)
    share, lit = SHARES[name], float(watched.light_by_frame[:count].mean())
    noise = watched.light_noise / lit
    if noise > NOISE_SHARE * share:
        reason = f"noise is {100 * noise:.2g} % of the source's light: {100 * share:g} % cannot be told from none"
        return make_refusal(name, "s", reason, **common)
    left = watched.light_by_frame[count:] / lit
    if left[-1] > share - 2.0 * noise:
        reason = f"at the end of the stack {100 * max(left[-1], 0.0):.2g} % of the light is left"
        return make_refusal(name, "s", reason, **common)
    rng = np.random.default_rng(seed)
    draws = np.array([_crossing(watched.time_s, left, count, share, noise, rng) for _ in range(DRAWS)])
    return measurement_from_draws(name, "s", draws[np.isfinite(draws)], **common)


def _crossing(time_s: Array, left: Array, count: int, share: float, noise: float, rng: np.random.Generator) -> float:
    """One draw of the time from going out to a share."""
    out = float(rng.uniform(time_s[count - 1], time_s[count]))
    times = np.concatenate([[out], time_s[count:]])
    light = np.concatenate([[1.0], left + noise * rng.standard_normal(len(left))])
    below = np.flatnonzero(light < share)
    if not len(below):
        return float("nan")
    last = int(below[0])
    high, low = np.log(light[last - 1]), np.log(max(light[last], 0.1 * share))
    part = (high - np.log(share)) / (high - low)
    return float(times[last - 1] + part * (times[last] - times[last - 1]) - out)
