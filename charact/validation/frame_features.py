"""Numbers by which measured frames are compared with simulated ones: statistics of darks and flats,
and of targets.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.observables import Numbers, Observable, observables
from charact.observables.frame_view import FrameView
from charact.observables.size import Size
from charact.validation.frames import MatchedFrames, MatchedStacks, known_pattern
from charact.validation.simulated_frames import in_parts
from charact.validation.target_features import SetStacks
from labdata import Camera

# Statistics that are compared, by name.
GROUPS: dict[str, Observable[Any]] = {
    statistic.name: statistic for statistic in observables() if statistic.title
}
# Stacks besides the dark that some of them are of; the others are of the flats.
TARGETS = {"dark-events": "", "mtf": "edge", "edge": "edge", "point": "point"}


@dataclass(frozen=True, kw_only=True)
class FrameFeatures:
    """Numbers of one set of frames by group, and curves for the overlays.

    `sizes`: what departures of the numbers are measured in, by group and beginning of the label.
    """

    groups: Mapping[str, Numbers]
    sizes: Mapping[str, Mapping[str, Size]]
    mean_dn: tuple[float, ...]  # signal of each flat above the dark, DN
    variance_dn2: tuple[float, ...]  # variance in time of each flat above the dark's, DN^2
    covariance_dn2: tuple[float, ...]  # its summed covariance above the dark's, DN^2


def stacks_for(names: Sequence[str], chosen: MatchedStacks) -> MatchedStacks:
    """Return those of the compared stacks that groups of numbers are of."""
    kinds = {TARGETS.get(name, "flat") for name in names}
    edge, point = (
        shot if kind in kinds else None
        for kind, shot in (("edge", chosen.edge), ("point", chosen.point))
    )
    # A flat may set the light of a target.
    lit_by_flat = any(shot is not None and shot.like for shot in (edge, point))
    flats = chosen.flats if "flat" in kinds or lit_by_flat else ()
    return replace(chosen, flats=flats, edge=edge, point=point)


def features_of(
    frames: Mapping[str, NDArray],
    chosen: MatchedStacks,
    *,
    context: Context,
    names: Sequence[str] = tuple(GROUPS),
) -> FrameFeatures:
    """Return the numbers of frames given by label; a group that frames cannot give is empty.

    `names`: groups whose numbers are wanted.
    """
    targets: dict[str, Any] = {
        name: frames[shot.label]
        for name, shot in (("edge", chosen.edge), ("point", chosen.point))
        if shot is not None
    }
    stacks = _stacks(frames, chosen, chosen.flats, context, **targets)
    dark = stacks.dark
    return FrameFeatures(
        groups={
            name: {
                label: value
                for label, value in group.numbers(stacks).items()
                if label not in chosen.fitted
            }
            for name, group in GROUPS.items()
            if name in names
        },
        sizes={name: GROUPS[name].sizes(stacks) for name in names},
        mean_dn=tuple(flat.mean_dn - dark.mean_dn for flat in stacks.flats),
        variance_dn2=tuple(flat.variance_dn2 - dark.variance_dn2 for flat in stacks.flats),
        covariance_dn2=tuple(
            float(flat.covariance.sum() - dark.covariance.sum()) for flat in stacks.flats
        ),
    )


def _stacks(
    frames: Mapping[str, NDArray],
    chosen: MatchedStacks,
    flats: tuple[MatchedFrames, ...],
    context: Context,
    corner: tuple[int, int] | None = None,
    **targets: Any,
) -> SetStacks:
    """Return the stacks of a set of frames; `corner`: of another part of the frame."""
    dark = chosen.dark
    dark_dn = float(frames[dark.label].mean())
    views = {
        shot.label: FrameView(
            shot.label,
            frames[shot.label],
            interlaced=context.interlaced,
            known=known_pattern(
                chosen.maps,
                replace(shot, corner=corner or shot.corner),
                float(frames[shot.label].mean()) - dark_dn if shot.kind == "flat" else 0.0,
            ),
        )
        for shot in (dark, *flats)
    }
    return SetStacks(
        darks=(views[dark.label],),
        flats=tuple(views[shot.label] for shot in flats),
        context=context,
        **targets,
    )


def features_of_parts(
    chosen: MatchedStacks,
    sets: Sequence[tuple[Camera, Mapping[str, NDArray]]] = (),
    *,
    context: Context,
) -> dict[str, Mapping[str, Numbers]]:
    """Return the numbers of the measured frames in the other parts of the frame by part, of groups
    that are compared over the frame.

    With maps of the specimen parts differ: what `sets`, simulated cameras and their frames, show
    there beyond the crop is taken off, so that numbers of parts compare with those of the crop.
    """

    def numbers_of(
        frames: Mapping[str, NDArray], corner: tuple[int, int] | None = None
    ) -> dict[str, dict[str, float]]:
        stacks = _stacks(frames, chosen, chosen.flats[-1:], context, corner)
        over_frame = {name: group for name, group in GROUPS.items() if group.over_frame}
        return {name: dict(group.numbers(stacks)) for name, group in over_frame.items()}

    features = {
        part: numbers_of(frames, chosen.corners.get(part)) for part, frames in chosen.parts.items()
    }
    known = [(camera, frames) for camera, frames in sets if camera.maps is not None]
    for camera, frames in known if features else ():
        crop = numbers_of(frames)
        for part, of_part in in_parts(chosen, camera, frames).items():
            shown = numbers_of(of_part, chosen.corners[part])
            for name, numbers in features[part].items():
                for label in numbers.keys() & shown[name].keys():
                    beyond = shown[name][label] - crop[name].get(label, np.nan)
                    numbers[label] -= beyond / len(known)
    return dict(features)
