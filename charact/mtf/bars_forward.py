"""The forward method for bar targets: amplitudes at the fundamental and at zero, against the exact object spectrum."""

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf.bar_amplitudes import Amplitudes, amplitudes_of
from charact.mtf.bar_light import ground_of, lost_light, second_harmonic
from charact.mtf.bar_target import BarTarget, find, own_frequency
from charact.mtf.bar_window import fitting_margin, lost_share, margin_px
from charact.mtf.codes import code_flags
from charact.mtf.region import Region
from charact.posterior import laplace, sample
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Provenance, Result, from_draws, refused

Array = NDArray[np.float64]

METHOD = "bars-forward"
# A fundamental this many standard errors high is bars; the search over a frame of noise finds up to about five.
LEAST_SIGNAL = 9.0
# The zeros beside the fundamental, over it: more than this is another object, or bars of another frequency.
OTHER_OBJECT, DOUBTFUL = 0.5, 0.15
# Half way to the lower zero as many bars have at least their fundamental's share of light; twice as many have none.
LEAST_FLANK = 0.6
# Significance from which the zeros tell the bars' own frequency better than whoever asked, and a change worth telling.
TELLS_FREQUENCY, TOLD_FREQUENCY = 30.0, 0.01
FIELD_OFFSET_PX, UPRIGHT = 0.04, 0.5
SIGNIFICANT = 5.0
# Sampled frequency from which the alias is near, and the travel of the bars over the rows that averages it away.
NEAR_NYQUIST, LEAST_TRAVEL_PX = 0.42, 0.8
LARGEST_MTF = 1.5
# Second harmonic over the fundamental that bars and gaps a little unequal make, and its noise in standard errors.
STRAIGHT, STRAIGHT_SD = 0.006, 3.5
# A window that reaches less far beyond the bars cuts off their core's blur, not only a halo.
LEAST_CUT_PX = 5.0


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """A target found and reduced to its amplitudes."""

    target: BarTarget
    amplitudes: Amplitudes
    margin_px: float
    cut: bool
    lost: tuple[float, float]
    crowded: bool
    second: float


@register(
    "bars",
    METHOD,
    quantities=("mtf",),
    preferred=True,
    scope=(
        "Targets of two and more bars, seven times as long as wide, on an even ground, in any direction, the whole "
        "target and its blur inside the region; fundamental over 9 standard errors. Broken by clipping, motion "
        "between fields (not told of bars along rows), frequencies near the sampling limit untilted, and a curved "
        "response: an exponent within 0.9 to 1.1 changes the MTF by up to 8 % and shows only where the fundamental "
        "stands over 300 standard errors."
    ),
)
def bars_forward(
    stack: FrameStack, *, region: Region | None = None, bars: int, frequency_cy_per_px: float, context: Context
) -> Result:
    """Measure the MTF at the frequency of a bar target.

    Parameters
    ----------
    stack
        Frames of one target.
    region
        ROW, COL, HEIGHT, WIDTH that holds the whole target and its blur; None: the whole frame.
    bars
        Number of bars.
    frequency_cy_per_px
        Their frequency, cycles per column pitch across them.
    context
        Seed, whether a Markov chain is wanted, and the camera.

    Returns
    -------
    Result
        `mtf` at the fundamental, and the profile across the bars as evidence.

    Notes
    -----
    The spectrum of N bars of width w = 1/(2 f) at their own frequency is O(f) = N w 2/pi = O(0) 2/pi, exactly, so that
    MTF(f) = (pi/2) |I(f)| / I(0), I the spectrum of the image over its pedestal. I(0) holds all light, the halo
    included; what the tails carry beyond the window is a parameter with a prior from the camera's ranges.
    """
    began = time.perf_counter()
    used = stack if region is None else stack.region(*region)
    where = region or (0, 0, *used.shape[1:])
    found = _reduced(used, int(bars), float(frequency_cy_per_px), context)
    if isinstance(found, str):
        return _nothing(found, where, float(frequency_cy_per_px), context, began)
    posterior = _posterior(found.amplitudes, found.lost, context)
    # The share lost beyond the window leans on zero without harm.
    flags = (*_flags(found, used, context), *(flag for flag in posterior.flags if flag != "prior-bound"))
    if np.quantile(posterior["mtf"], 0.025) > 1.0:
        flags = (*flags, "model-misfit")
    measurement = from_draws(
        "mtf",
        "1",
        posterior["mtf"],
        method=METHOD,
        flags=flags,
        notes=_notes(found, float(frequency_cy_per_px), context),
        region=where,
        frequency_cy_per_px=found.target.frequency,
        orientation_deg=float(np.rad2deg(found.target.angle_rad)) % 180.0,
        posterior=posterior,
        provenance=Provenance(
            version=charact.__version__,
            seed=context.seed,
            settings={"quick": context.quick, "bars": bars, "margin_px": found.margin_px},
        ),
        seconds=time.perf_counter() - began,
    )
    return Result(measurements=(measurement,), evidence={"bars": profile(used, found.target, measurement.value or 0.0)})


def _reduced(used: FrameStack, bars: int, frequency: float, context: Context) -> Reduced | str:
    """Find and reduce the target; a sentence where there is none."""
    mean = used.data.mean(axis=0, dtype=np.float64)
    if min(mean.shape) < 2.0 / frequency:
        size = f"{mean.shape[0]} x {mean.shape[1]} px"
        return f"no target: {bars} bars at {frequency:g} cy/px need a larger region than {size}"
    target = find(mean, bars=bars, frequency=frequency, pitch_ratio=context.pitch_ratio)
    if target is None:
        return f"no target: nothing in the region answers to {bars} bars at {frequency:g} cy/px"
    wanted = margin_px(context, frequency)
    margin, cut = fitting_margin(target, mean.shape, wanted)
    window = target.box(mean.shape, margin)
    if np.count_nonzero(~window) < 50:
        return "no target: the region ends at the bars, and their pedestal cannot be told"
    ground = ground_of(mean, target, margin)
    amplitudes = amplitudes_of(used.data, target, window, ground.beyond)
    if amplitudes.signal_to_noise > TELLS_FREQUENCY:
        target = replace(target, frequency=own_frequency(mean, target, margin))
        amplitudes = amplitudes_of(used.data, target, window, ground.beyond)
    if not amplitudes.light > 0 or amplitudes.signal_to_noise < LEAST_SIGNAL:
        return (
            f"no target: the fundamental stands {amplitudes.signal_to_noise:.1f} standard errors out of the noise, "
            f"fewer than {LEAST_SIGNAL:g}"
        )
    if amplitudes.zeros > OTHER_OBJECT:
        return f"no target: the object's spectrum is not that of {bars} bars at {frequency:g} cy/px"
    if context.sensor is None:
        lost = lost_light(used.data, target, window, ground.beyond, amplitudes)
    else:
        lost = lost_share(context, margin)
    second = second_harmonic(mean, target, window, float(mean[ground.beyond].mean()), amplitudes)
    return Reduced(
        target=target, amplitudes=amplitudes, margin_px=margin, cut=cut, lost=lost, crowded=ground.crowded,
        second=second,
    )  # fmt: skip


def _posterior(found: Amplitudes, lost: tuple[float, float], context: Context) -> Posterior:
    """Draw light, MTF and the share of light lost beyond the window.

    Priors: light and MTF even over (0, 2 I(0)) and (0, 1.5); the share lost normal as the camera's ranges say, not
    negative. Student's t with the freedom of the estimated covariance.
    """
    inverse = np.linalg.inv(found.covariance)
    share, share_sd = lost
    known = share_sd == 0.0
    bounds = np.array([(0.0, 2.0), (0.0, LARGEST_MTF), (max(0.0, share - 8 * share_sd), share + 8 * share_sd)])
    bounds = bounds[:2] if known else bounds

    def log_probability(theta: Array) -> Array:
        light, mtf = theta[:, 0], theta[:, 1]
        beyond = np.full(len(theta), share) if known else theta[:, 2]
        inside = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        expected = found.light * light[:, None] * np.stack([1.0 - beyond, 2.0 / np.pi * mtf], axis=1)
        off = np.array([found.light, found.fundamental]) - expected
        chi2 = np.einsum("ni,ij,nj->n", off, inverse, off)
        likelihood = -0.5 * (found.freedom + 2.0) * np.log1p(chi2 / found.freedom)
        prior = 0.0 if known else -0.5 * ((beyond - share) / share_sd) ** 2
        return np.where(inside, likelihood + prior, -np.inf)

    ratio = min(np.pi / 2 * found.fundamental / found.light * (1.0 - share), LARGEST_MTF - 0.01)
    start = np.array([1.0 / (1.0 - share), ratio, share])
    relative = found.covariance / found.light**2
    spread = np.diag([relative[0, 0], (np.pi / 2) ** 2 * relative[1, 1] + ratio**2 * relative[0, 0], share_sd**2])
    count = len(bounds)
    asked = {
        "names": ("light", "mtf", "lost_share")[:count],
        "units": ("1", "1", "1")[:count],
        "start": start[:count],
        "covariance": spread[:count, :count],
    }
    if context.quick:
        return laplace(log_probability, **asked, seed=context.seed, bounds=bounds)
    return sample(log_probability, **asked, seed=context.seed, bounds=bounds)


def _flags(found: Reduced, used: FrameStack, context: Context) -> tuple[str, ...]:
    target, amplitudes = found.target, found.amplitudes
    full_scale = context.full_scale_dn or used.full_scale_dn
    flags = list(code_flags(used.data[:, target.box(used.shape[1:], 1.0)], full_scale))
    noise = SIGNIFICANT / amplitudes.signal_to_noise
    if amplitudes.zeros > DOUBTFUL + noise or amplitudes.flank < LEAST_FLANK - noise:
        flags.append("model-misfit")
    apart = abs(amplitudes.fields_apart_px)
    # Bars that lie along rows are aliased in each field alone, which looks like motion.
    upright = abs(np.sin(target.angle_rad)) < UPRIGHT
    if upright and apart > max(SIGNIFICANT * amplitudes.fields_apart_sd_px, FIELD_OFFSET_PX):
        flags.append("interlace-motion")
    if near_alias(target):
        flags.append("aliased")
    if abs(found.second) > STRAIGHT + STRAIGHT_SD / amplitudes.signal_to_noise:
        flags.append("gamma")
    if found.crowded:
        flags.append("several-targets")
    if found.cut and found.margin_px < LEAST_CUT_PX:
        flags.append("window-too-small")
    return tuple(flags)


def near_alias(target: BarTarget) -> bool:
    """Return whether the alias of the fundamental is near and the bars are too little tilted to average it away."""
    cosine, sine = abs(np.cos(target.angle_rad)), abs(np.sin(target.angle_rad))
    per_column, per_row = target.frequency * cosine, target.frequency * sine * target.pitch_ratio
    if per_column > NEAR_NYQUIST and target.length_px * sine < LEAST_TRAVEL_PX:
        return True
    return per_row > NEAR_NYQUIST and target.length_px * cosine / target.pitch_ratio < LEAST_TRAVEL_PX


def _notes(found: Reduced, asked: float, context: Context) -> tuple[str, ...]:
    notes = []
    if abs(found.target.frequency / asked - 1.0) > TOLD_FREQUENCY:
        notes.append(f"The bars repeat at {found.target.frequency:.4g} cy/px, asked were {asked:.4g}.")
    if context.sensor is None or found.cut:
        notes.append(f"Normalised to the light within {found.margin_px:.0f} px of the bars.")
    if found.amplitudes.frame_correlation > 1.2:
        factor = np.sqrt(found.amplitudes.frame_correlation)
        notes.append(
            f"Light lingers from frame to frame: the error of the mean is {factor:.2f} times that of fresh frames."
        )
    if context.sensor is None and context.pitch_ratio == 1.0:
        notes.append("Pixels taken as square.")
    return tuple(notes)


def profile(used: FrameStack, target: BarTarget, mtf: float) -> dict:
    """Return the mean profile across the bars and the model through the measured MTF, as numbers for a figure.

    The figure's model has the form exp(-(f/fc)^1.2) of a tube with the measured value at the fundamental: one point
    fixes one number of it.
    """
    across, along = target.coordinates(used.shape[1:])
    mean = used.data.mean(axis=0, dtype=np.float64)
    near = (np.abs(along) < 0.3 * target.length_px) & (np.abs(across) < target.width_px / 2 + 1.5 / target.frequency)
    edges = np.arange(across[near].min(), across[near].max() + 0.25, max(0.25, 0.04 / target.frequency))
    place = np.digitize(across[near], edges)
    count = np.bincount(place, minlength=len(edges) + 1)[1:-1]
    filled = count > 0
    value = np.bincount(place, mean[near], minlength=len(edges) + 1)[1:-1][filled] / count[filled]
    distance = (0.5 * (edges[1:] + edges[:-1]))[filled]
    shape = _modelled(distance, target, mtf)
    scale, level = np.polyfit(shape, value, 1) if shape.std() > 0 else (0.0, float(value.mean()))
    model = level + scale * shape
    return {
        "figure": "bars",
        "distance_px": distance.tolist(),
        "value_dn": value.tolist(),
        "model_dn": model.tolist(),
        "residual_dn": (value - model).tolist(),
        "frequency_cy_per_px": target.frequency,
        "mtf": mtf,
    }


def _modelled(distance: Array, target: BarTarget, mtf: float) -> Array:
    """Return N blurred bars at distances from their centre, 1 on a wide bar."""
    frequency = (np.arange(4096) + 0.5) * target.frequency / 256.0
    contrast = np.clip(mtf, 1e-3, 0.999)
    blur = np.exp(np.log(contrast) * (frequency / target.frequency) ** 1.2)
    width, pitch = 0.5 / target.frequency, 1.0 / target.frequency
    comb = np.sin(np.pi * target.bars * frequency * pitch) / np.sin(np.pi * frequency * pitch)
    spectrum = width * np.sinc(frequency * width) * comb * blur
    return 2.0 * np.cos(2.0 * np.pi * np.outer(distance, frequency)) @ spectrum * (frequency[1] - frequency[0])


def _nothing(reason: str, where: Region, frequency: float, context: Context, began: float) -> Result:
    provenance = Provenance(version=charact.__version__, seed=context.seed)
    one = refused(
        "mtf", "1", reason, method=METHOD, flags=("no-target",), region=where, frequency_cy_per_px=frequency,
        seconds=time.perf_counter() - began, provenance=provenance,
    )  # fmt: skip
    return Result(measurements=(one,))
