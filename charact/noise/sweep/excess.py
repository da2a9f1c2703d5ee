"""What a sweep tells besides the law: excess noise against gain, and whether the plate or the camera saturates."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.noise.findings import Finding
from charact.noise.sweep.responsivity import SweepResponsivity
from charact.noise.sweep.settings import SweepSetting

Array = NDArray[np.float64]

# The loss at the brightest level is seen where its interval begins above this and it is so many standard errors.
LEAST_LOST = 0.01
LOST_ERRORS = 4.0
# How the covariance over signal falls as the response bends: with the gain lost in the plate, as its cube where the
# camera bends (its slope squared, as the variance, over the signal).
PLATE, CAMERA = 1.0, 3.0
# Standard errors within which noise agrees with either.
AGREES = 2.5


def correct_saturation(settings: tuple[SweepSetting, ...], lit: tuple[int, ...], response: SweepResponsivity, *, seed: int
            ) -> tuple[SweepSetting, ...]:  # fmt: skip
    """Return the settings with their noise carried to small signals, where the response shows how the plate tires.

    The pulses of a tired plate are lower, and with them covariance and variance over signal, by the share of gain lost.
    """
    if not response.bendable:
        return settings

    def corrected(s: SweepSetting) -> SweepSetting:
        left = 1.0 - response.lost_per_dn * s.mean_signal_dn
        return replace(
            s,
            gain_dn=s.gain_dn / np.resize(np.random.default_rng(seed).permutation(left), len(s.gain_dn)),
            log_variance=s.log_variance - float(np.log(np.median(left))),
            log_variance_sd=float(np.hypot(s.log_variance_sd, np.std(left) / np.median(left))),
        )

    return tuple(corrected(s) if i in lit else s for i, s in enumerate(settings))


def relative_excess(settings: tuple[SweepSetting, ...], pulses_dn: Array, response: SweepResponsivity, *, seed: int
                    ) -> tuple[Array, int]:  # fmt: skip
    """Return draws of F^2 of every setting over that of the one known best, shape (draw, setting), and which it is.

    Parameters
    ----------
    settings
        The settings of the response.
    pulses_dn
        Draws of the pulses' part k F^2 of their covariance gain, carried to small signals, shape (draw, setting).
    response
        Signal over light.
    seed
        Seed of the draws.

    Notes
    -----
    Noise and response were seen at the same signals, where a tired plate has lost the same share of both: what is not
    known of that share drops out.
    """
    order = np.random.default_rng([seed, 10]).permutation(len(response.settings))
    left = 1.0 - response.lost_per_dn[:, None] * np.array([s.mean_signal_dn for s in settings])
    carried = np.median(left, axis=0) if response.bendable else 1.0
    seen = (response.settings * left / carried)[order]
    ratio = pulses_dn[np.resize(np.arange(len(pulses_dn)), len(order))] / seen
    away = np.log(ratio) - np.log(ratio).mean(axis=1, keepdims=True)
    reference = int(np.argmin(np.std(away, axis=0)))
    return ratio / ratio[:, reference : reference + 1], reference


def reaches_saturation(response: SweepResponsivity) -> bool:
    """Whether the sweep reaches the saturation of the plate."""
    lost = response.posterior["lost"]
    return bool(
        response.bendable and np.quantile(lost, 0.025) > LEAST_LOST and np.median(lost) > LOST_ERRORS * np.std(lost)
    )


def saturation_limit(response: SweepResponsivity) -> str:
    """Why the saturation of the plate is refused, with its limit."""
    if not response.bendable:
        return "saturation of the plate takes two lights at one setting at least, the brighter 1.5 times the other"
    most = float(np.quantile(response.lost_per_dn, 0.975))
    if most <= 0:
        return "the response bends the other way: no sign of a plate that tires"
    return (
        f"not reached in the sweep: {response.brightest_dn:.4g} DN above the dark cost less than "
        f"{100 * most * response.brightest_dn:.2g} % of the gain, so that the plate saturates above {1 / most:.3g} DN"
    )


def bending_findings(settings: tuple[SweepSetting, ...], response: SweepResponsivity) -> list[Finding]:
    """Whether the noise says that the plate tires, or that the camera behind it bends."""
    told = _fall_of_noise(settings, float(np.median(response.lost_per_dn)))
    if told is None:
        return [("nonlinear", "no setting has two levels whose noise could tell a plate that tires from a bent camera")]
    fall, sd = told
    plate, camera = abs(fall - PLATE) < AGREES * sd, abs(fall - CAMERA) < AGREES * sd
    seen = f"covariance over signal falls as the power {fall:.2g} +- {sd:.1g} of the response"
    if plate and not camera:
        return [(None, f"{seen}: the plate tires (power 1), the camera does not bend (3)")]
    if plate:
        return [("nonlinear", f"{seen}: too uncertain to tell a plate that tires (power 1) from a bent camera (3)")]
    return [("nonlinear", f"{seen}: that of a plate that tires falls as the power 1, that of a bent camera 3")]


def _fall_of_noise(settings: tuple[SweepSetting, ...], lost_per_dn: float) -> tuple[float, float] | None:
    """Slope of ln(covariance over signal) against ln(1 - S/S_s) within settings, and its standard error."""
    top = square = cross = 0.0
    freedom = -1
    for s in settings:
        good = s.levels_dn > 3.0 * s.levels_sd_dn
        if good.sum() < 2:
            continue
        bent, noise = np.log1p(-lost_per_dn * s.signal_dn[good]), np.log(s.levels_dn[good])
        weight = (s.levels_dn[good] / s.levels_sd_dn[good]) ** 2
        bent, noise = bent - weight @ bent / weight.sum(), noise - weight @ noise / weight.sum()
        cross, square, top = cross + weight @ (bent * noise), square + weight @ bent**2, top + weight @ noise**2
        freedom += int(good.sum()) - 1
    if freedom < 0 or not square > 0:
        return None
    slope = float(cross / square)
    excess = max(1.0, float(top - slope * cross) / max(1, freedom))
    return slope, float(np.sqrt(excess / square))
