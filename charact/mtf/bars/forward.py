"""Forward method for bar targets: the exact spectrum of N finite bars, fitted to the pixels."""

import numpy as np

import charact
from charact.method import Context, register
from charact.mtf.bars import findings
from charact.mtf.bars.bar_measurement import BarRefusal, StatedBars, measure_bars_in
from charact.mtf.bars.motion import measure_bar_motion
from charact.mtf.bars.profile import bar_profile
from charact.mtf.bars.thresholds import MIN_FUNDAMENTAL_SD
from charact.mtf.region import Region
from charact.mtf.target_motion import MAX_UNFLAGGED_SD
from labdata.frames import FrameStack
from labdata.measurement import Provenance, Result, make_refusal, measurement_from_draws

METHOD = "bars-forward"


@register(
    "bars",
    METHOD,
    quantities=("mtf",),
    scope=(
        "Two to sixty bars, brighter or darker than an even ground and as wide as their gaps, in any direction, whole "
        "with their blur inside the region, or running through it within 12 degrees of an axis; fundamental over 5 "
        "standard errors. Number and frequency are found from three bars on where they are not stated. A camera that "
        "is not described is taken to blur as a tube, a lens, a Moffat or two Gaussians do. Broken by clipping and "
        "motion between fields (not seen of bars along rows). A curved response is seen in the picture and in noise "
        "that does not grow as the light, and what neither shows of it is in the interval. A camera that sharpens is "
        "flagged where what it takes off stands over 3.5 standard errors. "
        "Untilted bars near the sampling limit are refused; one bar more or fewer than stated is flagged where each "
        "can be seen."
    ),
)
def bars_forward(
    stack: FrameStack,
    *,
    region: Region | None = None,
    bars: int | None = None,
    frequency_cy_per_px: float | None = None,
    context: Context,
) -> Result:
    """Measure the MTF at the frequency of a bar target.

    Parameters
    ----------
    stack
        Frames of one target.
    region
        ROW, COL, HEIGHT, WIDTH that contains the complete target and its blur, or a strip across all bars; None: the
        whole frame.
    bars
        Number of bars; None: counted in the image.
    frequency_cy_per_px
        Bar frequency, cycles per column pitch across the bars, at which the MTF is reported; None: measured.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf` at the fundamental, and the profile across the bars as figure data.

    Notes
    -----
    The spectrum of N bars of width w = 1/(2 f) and pitch P is O(v) = w sinc(v w) sin(pi N v P) / sin(pi v P). At the
    bar frequency it is (2/pi) O(0), so that MTF(f) = (pi/2) |I(f)| / I(0), I the spectrum of the image above its
    pedestal. O times a blur model, with a free departure at f, and the pixel aperture is fitted to the pixels. For a
    camera with a description, whose halo is wide and known, complete targets are summed instead; the light beyond the
    window is a parameter with a prior from the description.
    """
    used = stack if region is None else stack.region(*region)
    where = region or (0, 0, *used.shape[1:])
    asked = StatedBars(bars=bars, frequency=frequency_cy_per_px)
    found = measure_bars_in(used, asked, context)
    if isinstance(found, BarRefusal):
        return _nothing(found, where, asked, context)
    doubts = [*found.findings, *findings.posterior_findings(found.posterior.flags)]
    if np.quantile(found.mtf, 0.025) > 1.0:
        doubts.append(
            findings.misfit_finding(f"the MTF is {100 * found.mtf.mean() - 100:.1f} % over one, which no blur has")
        )
    if found.mtf.mean() < MIN_FUNDAMENTAL_SD * found.mtf.std():
        doubts.append(findings.faintness_finding(float(found.mtf.mean()), float(found.mtf.std())))
    wander = measure_bar_motion(used, found.target)
    if wander.moves and wander.mtf_loss(found.target.frequency) * found.mtf.mean() > MAX_UNFLAGGED_SD * found.mtf.std():
        doubts.append(findings.motion_finding(wander, found.target.frequency))
    measurement = measurement_from_draws(
        "mtf",
        "1",
        found.mtf,
        method=METHOD,
        notes=found.notes,
        region=where,
        frequency_cy_per_px=found.target.frequency,
        orientation_deg=float(np.rad2deg(found.target.angle_rad)) % 180.0,
        posterior=found.posterior,
        provenance=Provenance(
            version=charact.__version__,
            seed=context.seed,
            settings={"quick": context.quick, "bars": found.target.bars, "margin_px": found.margin_px},
        ),
    ).with_(findings=dict.fromkeys(doubts))
    return Result(
        measurements=(measurement,), evidence={"bars": bar_profile(used, found.target, measurement.value or 0.0)}
    )


def _nothing(found: BarRefusal, where: Region, asked: StatedBars, context: Context) -> Result:
    provenance = Provenance(version=charact.__version__, seed=context.seed)
    one = make_refusal(
        "mtf", "1", found.reason, method=METHOD, flags=(found.flag,), region=where,
        frequency_cy_per_px=asked.frequency, provenance=provenance,
    )  # fmt: skip
    return Result(measurements=(one,))
