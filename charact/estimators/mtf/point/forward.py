"""Forward method for points: the blur model of a described intensifier, or that of a tube, fitted
to the pixels.
"""

from dataclasses import replace

import numpy as np

from charact.estimators.mtf.curve import LEVELS
from charact.estimators.mtf.known_transfer import halo_diameters_px
from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.point.blur_models_2d import BANDWIDTH, BlurModel2D
from charact.estimators.mtf.point.parametric import PointMethod, measure_point
from charact.estimators.mtf.point.thresholds import PRIORS
from charact.estimators.mtf.session.stage_transfers import prior_sd_of
from charact.method import Context, register
from charact.transfer.extended import HaloComponent
from charact.transfer.video_filter import VideoFilter
from labdata import FrameStack, Result, has_tube

METHOD = "point-forward"


@register("point", METHOD)
def point_forward(
    stack: FrameStack,
    *,
    region: Region | None = None,
    pinhole_px: float | tuple[float, float] | None = None,
    context: Context,
) -> Result:
    """Measure the horizontal and vertical MTF from the image of a point by the blur model of a
    tube.

    Parameters
    ----------
    stack, region, pinhole_px, context
        As for "point-parametric".

    Returns
    -------
    Result
        `mtf50` and `mtf10` in both directions, and the curves "mtf" and "mtf_vertical", in cycles
        per column pitch.

    Notes
    -----
    With a description the transfer is video x exp(-(f/fc)^n - 2 (pi f s)^2) x [(1 - q) + q H_halo];
    the described ranges of all its parameters, the video bandwidth included, are their priors.
    """

    def forms(pinhole: float | tuple[float, float], holds_halo: bool, _reach_px: float):
        if has_tube(context.camera):
            return [tube_of_description(context, pinhole, halo=holds_halo)], None
        tube = BlurModel2D(core="exponential", pinhole_px=pinhole)
        return [replace(tube, core="gaussian"), tube, replace(tube, lens=True)], None

    method = PointMethod(name=METHOD, quantities=tuple(LEVELS), forms=forms)
    return measure_point(method, stack, region, pinhole_px, context)


def tube_of_description(
    context: Context, pinhole: float | tuple[float, float], *, halo: bool
) -> BlurModel2D:
    """Return the blur model of the described intensifier: exponential tube, Gaussian lens and
    fibres, halo, video.
    """
    sensor = context.camera
    assert sensor is not None
    pitch_um, demagnification = float(sensor.ccd.pitch_x_um), float(sensor.taper.demagnification)
    cut_off = float(sensor.tube.mtf_frequency_lp_per_mm) * pitch_um * demagnification * 1e-3
    exponent = float(sensor.tube.mtf_exponent)
    lens = float(sensor.optics.aberration_blur_um) / (pitch_um * demagnification)
    fibres = float(sensor.taper.fibre_pitch_um) / (4.0 * pitch_um)
    faces = 1e3 / (np.pi * np.sqrt(2.0) * float(sensor.taper.interface_mtf_lp_per_mm) * pitch_um)
    blur = float(np.sqrt(lens**2 + fibres**2 + faces**2))
    known = [
        (
            "ln_half_frequency",
            float(np.log(cut_off) + np.log(np.log(2.0)) / exponent),
            PRIORS.cut_off_sd,
        ),
        ("exponent", exponent, PRIORS.exponent_sd),
        ("blur_px", blur, PRIORS.blur_sd * blur),
        ("stretch", 0.0, PRIORS.described_stretch_sd),
    ]
    if halo:
        fraction, gap = sensor.photocathode.halo_fraction, sensor.photocathode.gap_mm
        px = 4e3 / (pitch_um * demagnification)
        known += [
            ("halo_fraction", float(fraction), prior_sd_of(fraction)),
            ("halo_diameter_px", px * float(gap), px * prior_sd_of(gap)),
        ]
    video = VideoFilter.of(sensor)
    if video is not None and video.ln_bandwidth_sd > 0.0:
        known.append((BANDWIDTH, 0.0, video.ln_bandwidth_sd))
    halo_component = (
        HaloComponent(size_px=halo_diameters_px(context, transposed=False)) if halo else None
    )
    return BlurModel2D(
        core="exponential", lens=True, wide=halo_component, pinhole_px=pinhole, known=tuple(known)
    )
