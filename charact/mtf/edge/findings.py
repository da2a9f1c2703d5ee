"""What an edge gives to distrust, each with the size of its effect on MTF50 and what settles it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from charact.mtf.edge.checks import noise_of
from charact.mtf.edge.nonlinearity import CurvatureEstimate, contrast, max_bias_of
from charact.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.mtf.edge.sharpening import noise_gain_of, overshoot_of
from labdata.flags import FLAGS, Finding
from labdata.measurement import Measurement

LINEAR = "linear frames (raw, without a gamma), or --sensor with a description"


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What effects are computed from.

    Parameters
    ----------
    edge
        The edge.
    half
        MTF50, cy/px; NaN: not known.
    response
        Curvature that the profile asks for, and its error; None: not looked for.
    misfit
        Largest departure of the profile from its model, share of the step; None: there is no model.
    """

    edge: PreparedEdge
    half: float
    response: CurvatureEstimate | None = None
    misfit: float | None = None

    @property
    def step(self) -> float:
        return max(abs(self.edge.profile.step), 1e-300)


def with_findings(found: Measurement, facts: Facts) -> Measurement:
    """Return a measurement whose flags say how large their effect may be and what settles them."""
    known = [flag for flag in found.flags if flag in EFFECTS]
    return found.with_(
        findings=[Finding(flag=flag, effect=EFFECTS[flag](facts), remedy=REMEDIES[flag]) for flag in known]
    )


def sharpening_flags(edge: PreparedEdge, half: float) -> tuple[str, ...]:
    """Return `processed` where an edge overshoots or its noise was differenced."""
    sharpened = noise_gain_of(edge.picture, edge.profile) > 1.0 or (half > 0 and overshoot_of(edge.profile, half) > 0.0)
    return ("processed",) if sharpened else ()


def _clipping(facts: Facts) -> str:
    data = facts.edge.used.data
    top, bottom = (100.0 * float(np.mean(data == end)) for end in (data.max(), data.min()))
    return (
        f"{top:.0f} % of the pixels sit at {data.max():g} DN, {bottom:.0f} % at {data.min():g} DN: what was cut off "
        "is the plateau, and MTF50 may be high by tens of percent"
    )


def _gamma(facts: Facts) -> str:
    most = 100.0 * max_bias_of(facts.response, contrast(facts.edge.profile))
    return f"a curved response may have moved MTF50 by up to {most:.1f} %"


def _misfit(facts: Facts) -> str:
    return f"the form misses the profile by up to {100.0 * (facts.misfit or 0.0):.1f} % of the step"


def _defects(facts: Facts) -> str:
    profile = facts.edge.profile
    used = int(np.count_nonzero(profile.gathered.used))
    return (
        f"{profile.defects} of {used} pixels were left out; as many more that do not stand out may move MTF50 by "
        f"{100.0 * profile.defects / max(used, 1):.2g} %"
    )


def _gradient(facts: Facts) -> str:
    profile = facts.edge.profile
    sides = [profile.value[side] for side in (profile.distance < 0, profile.distance > 0)]
    changes = max(float(np.ptp(one[np.abs(one - np.median(one)) < 0.3 * facts.step])) for one in sides if one.size)
    return f"light changes by {100.0 * changes / facts.step:.0f} % of the step over a side, as glare would"


def _low_signal(facts: Facts) -> str:
    noise = max(noise_of(facts.edge.profile), 1e-300)
    return f"the step is {facts.step / noise:.1f} times the noise of a pixel: the interval's own ends are unsure"


def _quantisation(facts: Facts) -> str:
    return f"either plateau may lie half a code off, {50.0 / facts.step:.2g} % of the step, and MTF50 about as much"


def _window(facts: Facts) -> str:
    half_width = facts.edge.profile.gathered.half_width_px
    return f"light beyond {half_width:.0f} px from the edge is not seen: MTF50 is high by the share it has"


def _drift(facts: Facts) -> str:
    wander = facts.edge.target_motion
    return f"the edge moves by {wander.rms_px:.2g} px rms: MTF50 is {100.0 * wander.mtf_loss(facts.half):.2g} % low"


def _edge_roughness(facts: Facts) -> str:
    rough = facts.edge.roughness
    return (
        f"an edge that wanders by {rough.rms_px:.2g} px rms lowers MTF50 by {100.0 * rough.mtf_loss(facts.half):.2g} %"
    )


def _processing(facts: Facts) -> str:
    edge, half = facts.edge, facts.half
    over = overshoot_of(edge.profile, half) if half > 0 else 0.0
    gain = noise_gain_of(edge.picture, edge.profile)
    if over > 0.0 or gain > 1.0:
        return (
            f"sharpened: it overshoots by {100.0 * over:.1f} % of the step and noise is {100.0 * (gain - 1.0):.0f} % "
            "larger for it; MTF50 is the processed picture's, and may be as many percent above the camera's"
        )
    return (
        f"noise on the edge is {edge.slope_noise.ratio:.1f} times that of its plateaus: noise reduction sparing edges "
        "may have sharpened or blurred this one"
    )


def _interlace(facts: Facts) -> str:
    return "the two fields of the frame lie apart, and their mean is blurred by that"


def _tilt(facts: Facts) -> str:
    travel = abs(facts.edge.rows.line.slope) * facts.edge.picture.value.shape[0]
    return f"the edge crosses {travel:.1f} pixels along its length: between them nothing is sampled"


def _several(facts: Facts) -> str:
    return "light of another step is taken for this one's"


def _modes(facts: Facts) -> str:
    return "two values explain the edge about as well: the interval holds both, its middle may be neither"


def _chain(facts: Facts) -> str:
    return "the interval follows from the curvature at the peak, and may be a third too narrow"


EFFECTS: dict[str, Callable[[Facts], str]] = {
    "clipped": _clipping,
    "gamma": _gamma,
    "model-misfit": _misfit,
    "defects": _defects,
    "gradient": _gradient,
    "low-signal": _low_signal,
    "quantised": _quantisation,
    "window-too-small": _window,
    "drift": _drift,
    "curved-edge": _edge_roughness,
    "processed": _processing,
    "interlace-motion": _interlace,
    "tilt-too-small": _tilt,
    "several-targets": _several,
    "several-modes": _modes,
    "prior-bound": _chain,
    "not-converged": _chain,
}
REMEDIES: dict[str, str] = {
    "clipped": "less light or a shorter exposure",
    "gamma": f"--black-dn, {LINEAR}",
    "model-misfit": "--method auto or edge-free, which need no form",
    "defects": "--roi on a part without them, or defect correction switched on",
    "gradient": "even light, --black-dn, or a --roi nearer to the edge",
    "low-signal": "more frames, more light or a longer edge",
    "quantised": "more frames with noise of half a code, or a higher bit depth",
    "window-too-small": "a larger --roi",
    "drift": "a steadier mount, or fewer frames",
    "curved-edge": "a straight target, or a shorter --roi along the edge",
    "processed": "frames with sharpening and noise reduction switched off (raw)",
    "interlace-motion": "a target at rest, or a progressive read-out",
    "tilt-too-small": "an edge tilted by 3 to 10 degrees",
    "several-targets": "--roi around one edge",
    "several-modes": "more frames or more light",
    "prior-bound": "more frames or more light",
    "not-converged": "another --seed, or more frames",
}
assert EFFECTS.keys() == REMEDIES.keys() <= FLAGS.keys()
