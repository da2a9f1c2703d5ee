"""Frames of a camera on the bench of a session, as small as the crops that are compared."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from charact.validation.frames import MatchedFrames, MatchedStacks
from labdata import Camera, Conditions, Target

if TYPE_CHECKING:
    from simulate.camera.stage_image import StageImage
    from simulate.lab import LabBench

# Half the side of the square about a point whose mean sets its light, px; side of a frame in which
# the light of a flat is found; first guess of an illuminance, lux, and steps of its search.
POINT_HALF_PX, FLAT_PX, FIRST_LUX, LIGHT_STEPS = 12, 32, 1e-3, 12


def simulate_frames(
    camera: Camera,
    shots: tuple[MatchedFrames, ...],
    *,
    seed: int,
    like: Camera | None = None,
) -> dict[str, NDArray]:
    """Simulate frames of a camera under the stacks' conditions by label, shape (frame, row, col),
    DN.

    The camera is as small as the crop, and its fixed patterns follow from its name. Targets lie as
    before `like`, if it is given: cameras of many draws use the same images.
    """
    camera = slow_enough(camera, shots)
    out, benches = {}, {}
    lit: dict[str, Conditions] = {}
    # The flat that sets the light of others comes before them.
    for index, shot in sorted(enumerate(shots), key=lambda item: item[1].like is not None):
        crop = shot.shape, shot.pitch_px, None if camera.maps is None else shot.first
        if crop not in benches:
            benches[crop] = bench_of(camera, shot, like=like)
        lit[shot.label] = light_of(benches[crop], shot, lit)
        shot = replace(shot, conditions=lit[shot.label])
        out[shot.label] = _expose(benches[crop], shot, seed + 1000 * index)
    return out


def in_parts(
    chosen: MatchedStacks, camera: Camera, frames: Mapping[str, NDArray]
) -> dict[str, dict[str, NDArray]]:
    """Return simulated frames of the dark and the brightest flat as other parts of the camera show
    them, by place: with the patterns of those parts in place of the crop's.
    """
    black_dn = np.float32(camera.video.black_level_dn)

    def patterns(shot: MatchedFrames) -> tuple[NDArray, NDArray]:
        known = bench_of(camera, shot).camera.specimen
        offset_dn, rate = known.offset_dn, known.dark_rate_dn_per_s
        if offset_dn is not None and rate is not None:
            offset_dn = offset_dn + rate * np.float32(shot.conditions.exposure_s or 0.0)
        lit = known.response if shot.kind == "flat" else None
        shading = 1.0 if known.shading is None else known.shading
        return (
            np.zeros(shot.shape, np.float32) if offset_dn is None else offset_dn,
            np.ones(shot.shape, np.float32) if lit is None else lit * shading,
        )

    out = {}
    for place, corner in chosen.corners.items():
        out[place] = {}
        for shot in (chosen.dark, chosen.flats[-1]):
            (offset, response), (new_offset, new_response) = (
                patterns(part) for part in (shot, replace(shot, corner=corner))
            )
            signal = frames[shot.label].astype(np.float32) - black_dn - offset
            out[place][shot.label] = signal * (new_response / response) + black_dn + new_offset
    return out


def light_of(bench: "LabBench", shot: MatchedFrames, lit: Mapping[str, Conditions]) -> Conditions:
    """Return the conditions of a stack with the illuminance at which a noiseless frame has its
    level, where the light is unknown; `lit`: conditions of the stacks before it.
    """
    conditions = shot.conditions
    if shot.like is not None:
        reference = lit[shot.like]
        photons, of_reference = (of.photons_per_px or 0.0 for of in (conditions, reference))
        open_s, open_of_reference = (bench.camera.open_s(of) for of in (conditions, reference))
        # Photons count over an exposure, an illuminance does not.
        rate = photons / of_reference * open_of_reference / open_s
        lux = (reference.illuminance_lux or 0.0) * rate
        return replace(conditions, illuminance_lux=lux)
    if (asked_dn := shot.level_dn) is None:
        return conditions
    if shot.kind == "flat" and bench.camera.description.maps is None:
        # Without a map the mean of a flat is that of a small one.
        shot = replace(shot, shape=(FLAT_PX, FLAT_PX))
        bench = bench_of(bench.camera.description, shot)
    dark_dn = float(mean_of(bench, replace(shot, kind="dark")).mean(dtype=float))
    lux = FIRST_LUX
    for _ in range(LIGHT_STEPS):
        conditions = replace(conditions, illuminance_lux=lux)
        level_dn = signal_dn(shot, mean_of(bench, replace(shot, conditions=conditions)), dark_dn)
        # Far from the level a frame is clipped, or rounding is all that it has.
        ratio = float(np.clip(asked_dn / max(level_dn, 1e-6), 0.01, 100.0))
        lux *= ratio
        if abs(ratio - 1.0) < 1e-4:
            break
    return replace(conditions, illuminance_lux=lux)


def bench_of(camera: Camera, shot: MatchedFrames, like: Camera | None = None) -> "LabBench":
    """Return a bench of a camera as small as the crop of a stack; `like` as in
    `simulate_frames`.
    """
    from simulate.lab import LabBench

    rows, columns = (length * shot.pitch_px for length in shot.shape)
    chip = replace(camera.ccd, rows=rows, columns=columns)
    maps = camera.maps and replace(camera.maps, corner=shot.first)
    return LabBench(replace(camera, ccd=chip, maps=maps), like=like and bench_of(like, shot))


def mean_of(bench: "LabBench", shot: MatchedFrames) -> NDArray:
    """Return the noiseless frame of a stack, shape (row, col), DN, within the digitiser's range."""
    from simulate.camera.chain import Slot

    if shot.pitch_px == 1:
        frame = bench.mean(shot.kind, _target_of(shot), shot.conditions)
    else:
        chain = bench.camera.chain(shot.conditions)
        frame = chain.between(Slot.CCD, Slot.VIDEO).mean(_light_on_plane(bench, shot)).values
    return np.clip(frame, 0.0, 2.0**bench.camera.description.video.bit_depth - 1.0)


def slow_enough(camera: Camera, shots: tuple[MatchedFrames, ...]) -> Camera:
    """Return the camera with frames as long as the exposures: without a tube nothing else depends
    on their rate.
    """
    longest_s = max((shot.conditions.exposure_s or 0.0 for shot in shots), default=0.0)
    rate = camera.video.field_rate_hz
    if camera.has_tube or longest_s * float(rate) <= 1.0:
        return camera
    return camera.with_parameters(
        {"video.field_rate_hz": replace(rate, value=1.0 / longest_s, low=None, high=None)}
    )


def _target_of(shot: MatchedFrames) -> Target:
    """Return the target of a stack at its place, in pixels of the camera."""
    from simulate.radiance.lab_target import PlacedTarget

    target, pitch_px = shot.target, shot.pitch_px
    frequency, pinhole_px = target.frequency_cy_per_px, target.pinhole_px
    target = replace(
        target,
        frequency_cy_per_px=frequency and frequency / pitch_px,
        pinhole_px=pinhole_px and pinhole_px * pitch_px,
        region=None,
    )
    offset_px = shot.offset_px[0] * pitch_px, shot.offset_px[1] * pitch_px
    return PlacedTarget(**vars(target), offset_px=offset_px)


def _light_on_plane(bench: "LabBench", shot: MatchedFrames) -> "StageImage":
    """Return the light of a plane of a mosaic, that of pixels `pitch_px` apart, as its rows and
    columns.
    """
    from simulate.camera.chain import Slot

    light = bench.mcp_input(shot.kind, _target_of(shot), shot.conditions)
    pixels = bench.camera.chain(shot.conditions)[Slot.PIXELS].mean(light)
    return pixels.with_values(pixels.values[:: shot.pitch_px, :: shot.pitch_px])


def _expose(bench: "LabBench", shot: MatchedFrames, seed: int) -> NDArray:
    """Return the frames of a stack, shape (frame, row, col), DN."""
    if shot.course:
        return np.concatenate(
            [
                _expose_from(
                    bench, replace(shot, frames=1, conditions=_dimmed(shot, relative)), seed, frame
                )
                for frame, relative in enumerate(shot.course[: shot.frames])
            ]
        )
    return _expose_from(bench, shot, seed, 0)


def _dimmed(shot: MatchedFrames, relative: float) -> Conditions:
    """Return the conditions of a stack with its light times a factor."""
    amounts = {
        name: getattr(shot.conditions, name) for name in ("illuminance_lux", "photons_per_px")
    }
    return replace(
        shot.conditions,
        **{name: amount and amount * relative for name, amount in amounts.items()},
    )


def _expose_from(bench: "LabBench", shot: MatchedFrames, seed: int, first_frame: int) -> NDArray:
    """Return the frames of a stack in constant light from a number on, shape (frame, row, col),
    DN.
    """
    from simulate.camera.chain import Slot

    if shot.pitch_px == 1:
        target = _target_of(shot)
        return bench.expose(
            shot.kind,
            target,
            shot.conditions,
            frames=shot.frames,
            seed=seed,
            first_frame=first_frame,
        ).data
    pixels = _light_on_plane(bench, shot)
    reading = bench.camera.chain(shot.conditions).between(Slot.CCD, Slot.VIDEO)
    return np.stack(
        [
            reading.draw(pixels, np.random.default_rng([seed, 1, frame])).values
            for frame in range(first_frame, first_frame + shot.frames)
        ]
    )


def signal_dn(shot: MatchedFrames, frame: NDArray, dark_dn: float) -> float:
    """Return the mean signal of a frame above the dark, DN: of a point that about its place,
    where it exceeds an error of the dark.
    """
    if shot.kind == "point":
        row, col = (
            round(length / 2.0 + offset)
            for length, offset in zip(shot.shape, shot.offset_px, strict=True)
        )
        frame = frame[
            max(row - POINT_HALF_PX, 0) : row + POINT_HALF_PX,
            max(col - POINT_HALF_PX, 0) : col + POINT_HALF_PX,
        ]
    return float(frame.mean(dtype=float)) - dark_dn
