"""Transfer functions of blurs: one class a form, its equation first, with its parameters."""

from charact.transfer.blur_model import BlurModel
from charact.transfer.cores import (
    AIRY,
    CORES,
    EXPONENTIAL,
    GAUSSIAN,
    MOFFAT,
    ON_BARS,
    ON_EDGES,
    ON_POINTS,
    TwoGaussians,
)
from charact.transfer.extended import (
    DiscComponent,
    ExtendedComponent,
    HaloComponent,
    ScatterComponent,
    UnresolvedGlareComponent,
    disc,
    halo,
)
from charact.transfer.form import Core, Parameter
from charact.transfer.pupil import pupil
from charact.transfer.stages import aperture, image_tube
from charact.transfer.video_filter import VideoFilter, powers

__all__ = [
    "AIRY",
    "CORES",
    "EXPONENTIAL",
    "GAUSSIAN",
    "MOFFAT",
    "ON_BARS",
    "ON_EDGES",
    "ON_POINTS",
    "BlurModel",
    "Core",
    "DiscComponent",
    "ExtendedComponent",
    "HaloComponent",
    "Parameter",
    "ScatterComponent",
    "TwoGaussians",
    "UnresolvedGlareComponent",
    "VideoFilter",
    "aperture",
    "disc",
    "halo",
    "image_tube",
    "powers",
    "pupil",
]
