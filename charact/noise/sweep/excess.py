"""Excess noise against gain, and MCP saturation against camera nonlinearity."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.noise.findings import Finding
from charact.noise.sweep.responsivity import SweepResponsivity
from charact.noise.sweep.settings import SweepSetting
from charact.noise.thresholds import SWEEP

Array = NDArray[np.float64]


def correct_saturation(
    settings: tuple[SweepSetting, ...], lit: tuple[int, ...], response: SweepResponsivity, *, seed: int
) -> tuple[SweepSetting, ...]:
    """Return the settings with their noise corrected to small signals, if MCP saturation was measured.

    The relative gain loss lowers covariance and variance over signal.
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
    """Return draws of F^2 of every setting over that of the most precise one, shape (draw, setting), and its index.

    Parameters
    ----------
    settings
        Settings of the responsivity fit.
    pulses_dn
        Draws of k F^2 at small signals, shape (draw, setting), DN.
    response
        Signal over light.
    seed
        Seed of the draws.

    Notes
    -----
    Noise and responsivity refer to the same signals with the same gain loss, so its uncertainty cancels.
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
    """Return whether the sweep reaches MCP saturation."""
    lost = response.posterior["lost"]
    return bool(
        response.bendable
        and np.quantile(lost, 0.025) > SWEEP.min_loss
        and np.median(lost) > SWEEP.loss_sd * np.std(lost)
    )


def saturation_limit(response: SweepResponsivity) -> str:
    """Return the refusal of MCP saturation, with its limit."""
    if not response.bendable:
        return "MCP saturation needs at least two lights at one setting, the brighter 1.5 times the other"
    most = float(np.quantile(response.lost_per_dn, 0.975))
    if most <= 0:
        return "the signal rises faster than the light: no MCP saturation"
    return (
        f"not reached in the sweep: {response.brightest_dn:.4g} DN above the dark lower the gain by less than "
        f"{100 * most * response.brightest_dn:.2g} %, so that the MCP saturates above {1 / most:.3g} DN"
    )


def bending_findings(settings: tuple[SweepSetting, ...], response: SweepResponsivity) -> list[Finding]:
    """Return the finding on MCP saturation against camera nonlinearity, from the noise."""
    told = _fall_of_noise(settings, float(np.median(response.lost_per_dn)))
    if told is None:
        return [
            ("nonlinear", "no setting has two levels whose noise separates MCP saturation from camera nonlinearity")
        ]
    fall, sd = told
    plate, camera = (
        abs(fall - SWEEP.mcp_exponent) < SWEEP.agreement_sd * sd,
        abs(fall - SWEEP.camera_exponent) < SWEEP.agreement_sd * sd,
    )
    seen = f"covariance over signal falls as the power {fall:.2g} +- {sd:.1g} of the relative response"
    if plate and not camera:
        return [(None, f"{seen}: MCP saturation (power 1), no camera nonlinearity (3)")]
    if plate:
        return [
            ("nonlinear", f"{seen}: too uncertain to separate MCP saturation (power 1) from camera nonlinearity (3)")
        ]
    return [("nonlinear", f"{seen}: expected is power 1 for MCP saturation, 3 for camera nonlinearity")]


def _fall_of_noise(settings: tuple[SweepSetting, ...], lost_per_dn: float) -> tuple[float, float] | None:
    """Return the slope of ln(covariance over signal) against ln(1 - S/S_s) within settings, and its standard error."""
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
