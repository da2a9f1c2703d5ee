"""Likely causes of what deviates: stages of the camera and faults of the frames, and what settles them."""

from dataclasses import dataclass

from labdata.flags import Finding


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Stage of the camera, or fault of its frames, that may be the cause of a deviation, and what settles it."""

    stage: str
    remedy: str

    def finding(self, flag: str, seen: str) -> Finding:
        """Return the finding of a flag by what was seen."""
        return Finding(flag=flag, effect=f"{self.stage}: {seen}", remedy=self.remedy)


AVERAGED = Cause(
    stage="frames averaged with earlier ones, in the grabber or by noise reduction in time",
    remedy="frames without averaging or noise reduction",
)
LAGGING = Cause(
    stage="image lag, as of a phosphor unlike its description, or frames averaged with earlier ones",
    remedy="frames without averaging, or a description of the phosphor's decay",
)
UNSTEADY = Cause(
    stage="drift or a step of lamp or gain within a stack, as of automatic gain",
    remedy="automatic gain off, and a lamp that has settled",
)
AUTOMATIC = Cause(stage="automatic gain or brightness control", remedy="both switched off")
COARSE = Cause(
    stage="a digitiser of fewer bits than the session says, or a bit that is stuck",
    remedy="the camera's mode of full depth, or frames divided by the step and their bit_depth",
)
CURVED = Cause(
    stage="a nonlinear response or gamma of amplifier, digitiser or grabber, saturation of the microchannel plate, or "
    "light other than stated",
    remedy="a gamma of 1, flats of the linear range only, and the light of each as it was",
)
PROCESSING = Cause(
    stage="sharpening, noise reduction or averaging of frames in camera or grabber",
    remedy="frames with processing switched off (raw)",
)
SHARPENED = Cause(
    stage="sharpening in camera or grabber, or a wider video band than described",
    remedy="frames with sharpening switched off (raw)",
)
SPREAD = Cause(
    stage="blur, interpolation or a correction of distortion in camera or grabber, or noise of rows",
    remedy="frames without processing (raw)",
)
OFF_AXIS = Cause(
    stage="blur after the gain that grows off axis, or a correction of distortion in the camera",
    remedy="frames without correction of distortion; the description of a fibre taper",
)
LENS_OFF_AXIS = Cause(
    stage="blur of lens or tube that grows off axis",
    remedy="edges of which each lies at one distance from the axis",
)
