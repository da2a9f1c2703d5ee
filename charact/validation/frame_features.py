"""Groups of numbers by which measured frames are compared with simulated ones, and the stage that
each depends on.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from numpy.typing import NDArray

from charact.method import Context
from charact.validation import stack_features as of_stacks
from charact.validation.frames import MatchedStacks
from charact.validation.stack_features import StackView
from charact.validation.target_features import edge_features, mtf_features, point_features

Numbers = Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class FeatureGroup:
    """Numbers that one statistic compares.

    `title`: what they are; `cause`: stages of the camera, or faults of the session, that move them;
    `least_sd`: least standard deviation of each, for counts of which all simulated sets hold the
    same; `over_frame`: whether they are compared in all parts of the frame, as faults may lie
    anywhere.
    """

    title: str
    cause: str
    least_sd: float = 0.0
    over_frame: bool = False
    # None: of edge or point
    of_stacks: Callable[[StackView, list[StackView]], Numbers] | None = None


GROUPS: dict[str, FeatureGroup] = {
    "level": FeatureGroup(
        title="Level of the dark, and signal of the brightest flat",
        of_stacks=of_stacks.level_features,
        cause="sensitivity, gain, black level, EBI, dark current, or the light meter",
    ),
    "photon-transfer": FeatureGroup(
        title="Variance of the dark, and variance over signal of the brightest flat",
        of_stacks=of_stacks.transfer_features,
        cause="gain, excess noise, read noise, or blur after the gain",
    ),
    "linearity": FeatureGroup(
        title="Signal, and variance over signal, of dimmer flats over the brightest",
        of_stacks=of_stacks.linearity_features,
        cause=(
            "a nonlinear response, saturation of the microchannel plate, automatic gain, or "
            "light other than stated"
        ),
    ),
    "covariance": FeatureGroup(
        title="Covariance summed within 6 px over signal, of each flat",
        of_stacks=of_stacks.covariance_features,
        cause="gain and excess noise",
    ),
    "autocorrelation": FeatureGroup(
        title="Correlation of neighbouring pixels in time",
        of_stacks=of_stacks.correlation_features,
        cause="blur after the gain, video bandwidth, sharpening, or interpolation",
        over_frame=True,
    ),
    "field": FeatureGroup(
        title="Noise near the corners of the brightest flat against that near its centre",
        of_stacks=of_stacks.field_features,
        cause=(
            "blur after the gain that grows off axis, or interpolation such as a correction of "
            "distortion"
        ),
    ),
    "noise-spectrum": FeatureGroup(
        title="Horizontal and vertical cuts of the noise spectrum, and its peak",
        of_stacks=of_stacks.spectrum_features,
        cause="interference, banding, or blur after the gain",
        least_sd=0.001,
    ),
    "rows-and-columns": FeatureGroup(
        title="Frame, row and column means in time",
        of_stacks=of_stacks.row_and_column_features,
        cause="line noise of the read-out, flicker of the lamp, or hum",
    ),
    "histogram": FeatureGroup(
        title="Tails of the noise in time, and low bits",
        of_stacks=of_stacks.histogram_features,
        cause="pulse heights, clipping, rounding, stuck bits, or a nonlinear response",
        least_sd=0.002,
    ),
    "dark-events": FeatureGroup(
        title="Bright and dark events of the dark frames",
        of_stacks=of_stacks.event_features,
        cause="EBI, ion feedback, cosmic rays, or clock-induced charge",
        least_sd=0.5,
    ),
    "fixed-pattern": FeatureGroup(
        title="Fixed noise of pixels, rows and columns, and its spectrum",
        of_stacks=of_stacks.pattern_features,
        cause=(
            "DSNU, PRNU, fibre pattern, dust, ghost images, or interference in step with the frames"
        ),
        least_sd=0.001,
        over_frame=True,
    ),
    "defects": FeatureGroup(
        title="Most deviating pixels and spots of the mean frames",
        of_stacks=of_stacks.defect_features,
        cause="hot, dead or stuck pixels, dust, or blemishes",
        least_sd=0.05,
        over_frame=True,
    ),
    "shading": FeatureGroup(
        title="Slope and curvature of the mean frames over the picture",
        of_stacks=of_stacks.shading_features,
        cause="vignetting, uneven light, glow of an amplifier, or stray light",
        over_frame=True,
    ),
    "time": FeatureGroup(
        title="Correlation of frames and fields with each other, and drift",
        of_stacks=of_stacks.time_features,
        cause="image lag, repeated or averaged frames, or drift of lamp or gain",
    ),
    "mtf": FeatureGroup(
        title="MTF of the edge up to 0.8 of the sampling limit",
        cause="lens, focus, tube, fibres, video bandwidth, or sharpening",
        least_sd=1e-4,
    ),
    "edge": FeatureGroup(
        title="Levels on both sides of the edge",
        cause="veiling glare, halo, ghost images, sharpening, or a nonlinear response",
        least_sd=1e-4,
    ),
    "point": FeatureGroup(
        title="Profile of the point source",
        cause="halo, lens, or saturation of the microchannel plate",
        least_sd=0.01,
    ),
}


@dataclass(frozen=True, kw_only=True)
class FrameFeatures:
    """Numbers of one set of frames by group, and curves for the overlays."""

    groups: Mapping[str, Numbers]
    mean_dn: tuple[float, ...]  # signal of each flat above the dark, DN
    variance_dn2: tuple[float, ...]  # variance in time of each flat above the dark's, DN^2
    covariance_dn2: tuple[float, ...]  # its summed covariance above the dark's, DN^2


def features_of(
    frames: Mapping[str, NDArray], chosen: MatchedStacks, *, context: Context
) -> FrameFeatures:
    """Return the numbers of frames given by label; a group that frames cannot give is empty."""
    dark, *flats = (
        StackView(shot.label, frames[shot.label], interlaced=context.interlaced)
        for shot in (chosen.dark, *chosen.flats)
    )
    groups: dict[str, Numbers] = {
        name: group.of_stacks(dark, flats)
        for name, group in GROUPS.items()
        if group.of_stacks is not None
    }
    if chosen.edge is not None:
        edge = frames[chosen.edge.label]
        groups["mtf"] = mtf_features(edge, context)
        groups["edge"] = edge_features(edge, dark.level)
    if chosen.point is not None:
        groups["point"] = point_features(
            frames[chosen.point.label], dark.level, context.full_scale_dn
        )
    return FrameFeatures(
        groups=groups,
        mean_dn=tuple(stack.level - dark.level for stack in flats),
        variance_dn2=tuple(stack.variance - dark.variance for stack in flats),
        covariance_dn2=tuple(
            float(stack.covariance.sum() - dark.covariance.sum()) for stack in flats
        ),
    )


def features_of_parts(
    chosen: MatchedStacks, *, context: Context
) -> dict[str, Mapping[str, Numbers]]:
    """Return the numbers of the measured frames in the other parts of the frame by part, of groups
    that are compared over the frame.
    """
    features = {}
    for part, frames in chosen.parts.items():
        dark, flat = (
            StackView(shot.label, frames[shot.label], interlaced=context.interlaced)
            for shot in (chosen.dark, chosen.flats[-1])
        )
        features[part] = {
            name: group.of_stacks(dark, [flat])
            for name, group in GROUPS.items()
            if group.of_stacks is not None and group.over_frame
        }
    return features
