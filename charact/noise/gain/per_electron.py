"""Gain per electron of a camera without a tube.

EMVA 1288 assumes white noise. Charge diffusion between neighbours lowers the variance and leaves the covariance sum
unchanged: the standard's slope is reported with the size of that effect, and derived quantities use the covariance sum.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from charact.method import Context
from charact.noise.checks import light_findings
from charact.noise.findings import Finding, flags_of, notes_of
from charact.noise.gain import emva1288
from charact.noise.gain.excess import excess_of
from charact.noise.gain.single_setting import SingleSetting
from charact.noise.gain.white_floor import floor_of
from charact.noise.quantities import white_quantities
from charact.noise.thresholds import GAIN
from labdata import flags
from labdata.measurement import Measurement, measurement_from_draws


def gain_of(pooled: SingleSetting, allowance: float, context: Context) -> tuple[emva1288.GainLine, emva1288.GainLine]:
    """Return the slope of the standard, and the gain per electron used for derived quantities."""
    plain = emva1288.gain_line(pooled.series, context=context, allowance=allowance)
    if pooled.white:
        return plain, plain
    excess = excess_of(pooled.series.flats[0].conditions, context)
    draws = excess.divide(pooled.posterior["covariance_gain"], context.seed)
    return plain, replace(plain, posterior=pooled.posterior, slope=draws)


def electron_quantities(
    pooled: SingleSetting,
    gains: tuple[emva1288.GainLine, emva1288.GainLine],
    findings: list[Finding],
    covariance: list[Finding],
    context: Context,
    fields: dict[str, Any],
) -> list[Measurement]:
    """Return the system gain and derived quantities.

    Parameters
    ----------
    pooled
        Noise of the flats of one setting.
    gains
        See `gain_of`.
    findings, covariance
        Findings on the slope, and on the covariance sum.
    context, fields
        Settings; method and provenance.
    """
    series, (plain, gain) = pooled.series, gains
    excess = excess_of(series.flats[0].conditions, context)
    notes = () if excess.note is None else (excess.note,)
    own = findings if pooled.white else [*findings, _correlation_finding(pooled, plain, gain)]
    first = measurement_from_draws("system_gain", "DN/e-", plain.slope, flags=flags_of(own) + plain.posterior.flags,
                       notes=notes_of(own) + notes, posterior=plain.posterior, **fields)  # fmt: skip
    why = findings if pooled.white else [*covariance, *_blur_findings(pooled)]
    out = [first, *white_quantities(series, gain, context=context, findings=why, light=light_findings(series),
                                    notes=notes, factor=excess.factor, **fields)]  # fmt: skip
    return out if pooled.white else [*out, *_floor(pooled, covariance, context, fields)]


def _correlation_finding(pooled: SingleSetting, plain: emva1288.GainLine, gain: emva1288.GainLine) -> Finding:
    """Return the finding of correlated neighbours, relative to the gain."""
    low, right = float(np.median(plain.slope)), float(np.median(gain.slope))
    percent = 100.0 * (1.0 - low / right)
    return flags.Finding(
        flag="correlated-noise",
        effect=f"noise of neighbouring pixels is correlated, so that the slope of EMVA 1288 is {percent:.2g} % low",
        remedy=f"the covariance sum, which gives {right:.4g} DN/e- (covariance_gain)",
    )


def _blur_findings(pooled: SingleSetting) -> list[Finding]:
    """Return the finding of stronger correlation than charge diffusion allows."""
    blur = float(np.median(pooled.posterior["blur_factor"]))
    if blur >= GAIN.min_blur_factor:
        return []
    effect = (
        f"{100 * (1 - blur):.2g} % of the noise is correlated between pixels, so that the gain may not be per electron"
    )
    remedy = "a sensor in session.toml that describes the blur"
    return [flags.Finding(flag="correlated-noise", effect=effect, remedy=remedy)]


def _floor(
    pooled: SingleSetting, covariance: list[Finding], context: Context, fields: dict[str, Any]
) -> list[Measurement]:
    """Return the gain per electron behind the blur, if the white floor is detected."""
    if not _blur_findings(pooled):
        return []
    floor = floor_of(pooled.series, pooled.posterior, context=context)
    if not floor.seen:
        return []
    return [measurement_from_draws("conversion_gain", "DN/e-", floor.draws, flags=flags_of(covariance), **fields)]
