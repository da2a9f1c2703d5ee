"""Economy: what the simulator leaves out changes less than it was allowed to, in everything that a
lab measures.

The tolerance is a share of the temporal noise of each pixel. That noise is computed here from
pulses and blurs, apart from the bounds that are on trial, and agrees with drawn frames. Means and
variances of both cameras, the one with all effects and the one without those left out, are compared
pixel by pixel without drawing; what must be drawn is drawn with the same random numbers for both,
and its standard errors come from leaving out blocks of frames.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import islice
from typing import Any

import numpy as np
import pytest

from labdata import Array, BadInput, Camera, Conditions, Mask
from simulate import EffectSelection, OptionalEffect, select_effects
from simulate.camera import (
    CameraModel,
    PixelAperture,
    Slot,
    StageImage,
    filter_lines,
    pattern,
    photoelectrons_from_image,
    product,
    select_camera_effects,
)
from tests.simulate.random_scenes import random_scene
from tests.simulate.samplers import drawn_by

SHAPE = (72, 96)
SCENES = 12
DRAWN = (15, 30)
# By how much of itself the tolerance may be broken.
BROKEN = 1.1
BLOCKS = 8
ONE_IN_A_THOUSAND, NORMAL_LEVEL = 0.999, 3.09


def effects(*influences: float) -> list[OptionalEffect]:
    """Effects called a, b, c, ... of these influences."""
    return [
        OptionalEffect(name=chr(ord("a") + i), influence=influence)
        for i, influence in enumerate(influences)
    ]


def test_the_least_influences_are_left_out_first_and_only_as_far_as_together_they_are_allowed() -> (
    None
):
    plan = select_effects(effects(0.06, 0.01, 0.05, 0.2), 0.1)
    assert [effect.name for effect in plan.left_out] == ["b", "c"]
    assert [effect.name for effect in plan.kept] == ["a", "d"]
    assert plan.influence == pytest.approx(0.06) and plan.names == {"b", "c"}


def test_of_equal_influences_the_first_by_name_is_left_out_whatever_the_order_they_come_in() -> (
    None
):
    for order in (effects(0.07, 0.07), effects(0.07, 0.07)[::-1]):
        assert select_effects(order, 0.1).names == {"a"}


def test_without_tolerance_only_what_has_no_influence_is_left_out() -> None:
    plan = select_effects(effects(0.0, 1e-12, 0.0), 0.0)
    assert plan.names == {"a", "c"} and plan.influence == 0.0


@pytest.mark.parametrize("wrong", [-1e-9, float("nan")])
def test_negative_influences_and_tolerances_are_refused(wrong: float) -> None:
    with pytest.raises(BadInput, match="must not be negative"):
        OptionalEffect(name="halo", influence=wrong)
    with pytest.raises(BadInput, match="must not be negative"):
        select_effects([], wrong)


@pytest.mark.parametrize("number", range(20))
def test_influences_left_out_never_add_up_beyond_the_tolerance_and_no_more_would_fit(
    number: int,
) -> None:
    rng = np.random.default_rng([number, 7])
    influences = np.exp(rng.uniform(-12.0, 2.0, rng.integers(0, 30)))
    tolerance = float(np.exp(rng.uniform(-6.0, 1.0)))
    plan = select_effects(
        [OptionalEffect(name=str(i), influence=float(x)) for i, x in enumerate(influences)],
        tolerance,
    )
    assert plan.influence <= tolerance
    assert len(plan.kept) + len(plan.left_out) == len(influences)
    if plan.kept:
        assert plan.influence + plan.kept[0].influence > tolerance
        assert all(out.influence <= plan.kept[0].influence for out in plan.left_out)


def test_the_plan_says_what_is_kept_what_is_left_out_and_what_it_costs() -> None:
    halo = OptionalEffect(name="halo", influence=0.004, setup_s=0.25, frame_s=0.0015)
    plan = select_effects([halo, OptionalEffect(name="smear", influence=300.0)], 0.05)
    head, smear, left, together = plan.text().splitlines()
    assert "of the noise" in head
    assert smear.startswith("smear") and "beyond all bounds" in smear and "kept" in smear
    assert (
        left.startswith("halo")
        and "0.4 %" in left
        and "left out" in left
        and "250" in left
        and "1.50" in left
    )
    assert "0.4 %" in together and "of 5 % allowed" in together
    document = plan.document()
    assert document["tolerance"] == 0.05 and document["left_out_together"] == 0.004
    assert {row["name"]: row["kept"] for row in document["effects"]} == {
        "halo": False,
        "smear": True,
    }


@dataclass(frozen=True)
class Pair:
    """A scene before the camera with everything and before the one that a plan has thinned."""

    whole: CameraModel
    thin: CameraModel
    plan: EffectSelection
    conditions: Conditions
    at_mcp: tuple[StageImage, StageImage]

    @classmethod
    def of(
        cls,
        camera: CameraModel,
        image: Array,
        conditions: Conditions,
        tolerance: float,
    ) -> "Pair":
        """Plan a picture in photoelectrons."""
        freed = photoelectrons_from_image(camera, image)
        thin, plan = select_camera_effects(camera, freed, conditions, tolerance)
        light = camera.to_mcp_input(freed, conditions), thin.to_mcp_input(freed, conditions)
        return cls(camera, thin, plan, conditions, light)

    @cached_property
    def means(self) -> tuple[Array, Array]:
        """Mean frames of both, DN, as the digitiser ends them."""
        top = 2**self.whole.description.video.bit_depth - 1
        whole, thin = (
            c.mean_frame(light, self.conditions).astype(float) for c, light in self._both
        )
        return np.clip(whole, 0.0, top), np.clip(thin, 0.0, top)

    @cached_property
    def variances(self) -> tuple[Array, Array]:
        """Temporal variance of both, DN^2."""
        whole, thin = (
            temporal_variance(camera, light, self.conditions) for camera, light in self._both
        )
        return whole, thin

    @property
    def noise(self) -> Array:
        """Temporal noise of the camera with everything, DN."""
        return np.sqrt(self.variances[0])

    @property
    def _both(
        self,
    ) -> tuple[tuple[CameraModel, StageImage], tuple[CameraModel, StageImage]]:
        return (self.whole, self.at_mcp[0]), (self.thin, self.at_mcp[1])

    def frames(self, count: int, seed: int) -> Iterator[Array]:
        """Frames of both, the whole one by the exact law of pulses, from the same random numbers,
        (frame, row, col).
        """
        for (camera, light), tier in zip(self._both, ("fast", "fast"), strict=True):
            drawn = drawn_by(tier, camera, light, self.conditions, seed=seed)
            yield np.stack([frame.astype(float) for frame in islice(drawn, count)])

    def moved(self) -> tuple[float, float]:
        """By how much means, in the noise, and noise itself, relative, differ at most."""
        (whole, thin), (variance, thinned) = self.means, self.variances
        spread = np.abs(np.sqrt(thinned / variance) - 1.0)[self.in_scale()]
        return float(np.max(np.abs(thin - whole) / self.noise)), float(np.max(spread, initial=0.0))

    def in_scale(self) -> Mask:
        """Pixels whose noise neither wells nor the digitiser cut off."""
        video, ccd = self.whole.description.video, self.whole.description.ccd
        well = float(ccd.full_well_e) * float(video.conversion_gain_dn_per_e)
        top = min(2**video.bit_depth - 1, float(video.black_level_dn) + well)
        return self.means[0] + 6.0 * self.noise < top


def temporal_variance(camera: CameraModel, at_mcp: StageImage, conditions: Conditions) -> Array:
    """Temporal variance of every pixel, DN^2, rounding included, wells and digitiser without end,
    shape (row, col).

    Notes
    -----
    Pulses: sum over cells of m <q^2> h^2, m their expected number, q their charge, h what of a
    pulse in that cell the pixel reads, times the mean over pulses of the squared shares of fields.
    """
    chain, grid, height = camera.chain(conditions), at_mcp.grid, camera.fields_per_frame
    assert grid is not None
    plate, ccd, video = chain[Slot.MCP], chain[Slot.CCD], chain[Slot.VIDEO]
    behind = chain.between(Slot.PHOSPHOR, Slot.TAPER)
    wider = 1.0 + 1.0 / plate.pulse_height_shape
    size, p = plate.ion_event_size_pe, plate.detection_probability
    number = np.maximum(at_mcp.values.astype(float), 0.0) * p * wider
    number += plate.ions_per_cell(at_mcp) * (size**2 + size * wider)
    left = np.broadcast_to(plate.gain_under_load(at_mcp) / plate.gain, at_mcp.values.shape).astype(
        np.float32
    )
    evenly = at_mcp.with_values(np.ones_like(at_mcp.values))
    screen = behind.mean(replace(plate, gain_map=left, ion_events_per_s_cm2=0.0).mean(evenly))
    charge = screen.values.astype(float) * ccd.quantum_efficiency / p
    decay = float(np.mean(np.sum(chain[Slot.DECAY].pulse_shares ** 2, axis=1)))
    taps = np.asarray(video.low_pass.impulse_response(), float)
    kernel = _read_of_a_pulse(screen.pending_blurs, grid, height, tuple(taps))
    pulses = np.fft.irfft2(
        np.fft.rfft2(number * charge**2 * decay) * np.fft.rfft2(kernel**2), grid.shape
    )
    rows = slice(2 * grid.margin_rows, 2 * (grid.margin_rows + camera.shape[0]), 2)
    cols = slice(2 * grid.margin_columns, 2 * (grid.margin_columns + camera.shape[1]), 2)
    response = pattern.prnu_map(camera.shape, ccd.prnu, ccd.pattern_seed) if ccd.prnu > 0.0 else 1.0
    light = ccd.mean_charge(chain[Slot.PIXELS].mean(behind.mean(plate.mean(at_mcp))).values)
    own = filter_lines(light + ccd.dark(camera.shape) + ccd.read_noise_e**2, taps**2)
    variance = (
        pulses[rows, cols] * response**2 + own
    ) * video.conversion_gain_dn_per_e**2 + 1.0 / 12.0
    slope = np.gradient(filter_lines(light, taps), axis=1) * video.conversion_gain_dn_per_e
    return variance + (video.sync_jitter_px * slope) ** 2 + video.line_noise_dn**2


@lru_cache(maxsize=8)
def _read_of_a_pulse(owed: Any, grid: Any, height: int, taps: tuple[float, ...]) -> Array:
    """Share of a pulse in a cell that a pixel reads, by the cell's place before it, shape of the
    grid.
    """
    fx, fy = np.broadcast_arrays(*grid.frequencies())
    aperture = PixelAperture(width_mm=grid.pitch_x_mm, height_mm=height * grid.pitch_y_mm)
    x, y = fx * grid.pitch_x_mm, fy * grid.pitch_y_mm
    line = np.exp(-2j * np.pi * np.multiply.outer(x, np.arange(len(taps)))) @ np.array(taps)
    centre = np.exp(2j * np.pi * (0.25 * x + (0.5 * height - 0.25) * y))
    transfer = product((*owed, aperture), fx, fy) * line * centre
    return np.fft.irfft2(transfer, grid.shape) * 4.0 * height


def small(sensor: Camera, shape: tuple[int, int] = SHAPE) -> Camera:
    """The sensor with a smaller chip."""
    return replace(sensor, ccd=replace(sensor.ccd, rows=shape[0], columns=shape[1]))


def dim_picture(shape: tuple[int, int] = SHAPE) -> Array:
    """Hills under starlight: soft, about one photoelectron a pixel."""
    row, col = np.mgrid[: shape[0], : shape[1]]
    return 1.0 + 0.2 * np.sin(2.0 * np.pi * col / 180.0) + 0.15 * np.cos(2.0 * np.pi * row / 150.0)


def by_blocks(
    statistic: Callable[[Array, Array], Array], one: Array, other: Array
) -> tuple[Array, Array]:
    """A statistic of two runs of frames and its standard error, by leaving out blocks of frames."""
    block = np.arange(len(one)) * BLOCKS // len(one)
    without = np.stack([statistic(one[block != b], other[block != b]) for b in range(BLOCKS)])
    scatter = np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    return statistic(one, other), np.sqrt(scatter * (BLOCKS - 1) / BLOCKS)


def test_the_noise_that_tolerances_are_shares_of_is_that_of_drawn_frames() -> None:
    for number in (4, 16):
        scene = random_scene(number, SHAPE)
        pair = Pair.of(scene.camera, scene.image_pe, scene.conditions, 0.0)
        mean, variance = pair.means[0], pair.variances[0]
        frames, _ = pair.frames(64, seed=2)
        inside = pair.in_scale()
        assert inside.mean() > 0.5
        squared = ((frames - mean) ** 2)[:, inside] / variance[inside]
        blocks = squared.reshape(BLOCKS, -1).mean(axis=1)
        assert abs(squared.mean() - 1.0) < 0.03 + 4.0 * blocks.std() / np.sqrt(BLOCKS - 1.0)


def test_a_dim_scene_is_simulated_without_halo_overflow_and_smear_and_moves_less_than_allowed(
    sheet: Camera,
) -> None:
    tolerance = 0.1
    pair = Pair.of(CameraModel(small(sheet)), dim_picture(), Conditions(mcp_v=800.0), tolerance)
    assert {"halo", "column blooming", "smear"} <= pair.plan.names
    said = {line.split("  ")[0]: line for line in pair.plan.text().splitlines()}
    assert all("left out" in said[name] for name in ("halo", "column blooming", "smear"))
    assert max(pair.moved()) < tolerance


def test_with_one_bright_lamp_in_view_they_are_kept(sheet: Camera) -> None:
    lit = dim_picture()
    lit[60:63, 40:43] += 1e5
    pair = Pair.of(CameraModel(small(sheet)), lit, Conditions(mcp_v=800.0), 0.1)
    assert not {"halo", "column blooming", "smear"} & pair.plan.names


def test_a_control_that_will_lower_the_gain_keeps_the_noise_that_then_shows(sheet: Camera) -> None:
    # This supply holds the screen at what a fiftieth of the light would give.
    camera = CameraModel(small(sheet).with_values({"tube.brightness_control_lux": 1e-6}))
    off = Conditions(mcp_v=840.0, brightness_control=False)
    freed = photoelectrons_from_image(camera, np.full(SHAPE, 5.0))
    constant, lowered = (
        select_camera_effects(camera, freed, conditions, 0.1)[1].names
        for conditions in (off, replace(off, brightness_control=True))
    )
    assert "read noise" in constant
    assert "read noise" not in lowered and lowered < constant


def test_the_tolerance_of_random_scenes_is_never_broken() -> None:
    broken: list[str] = []
    for number in range(SCENES):
        scene = random_scene(number, SHAPE)
        pair = Pair.of(scene.camera, scene.image_pe, scene.conditions, scene.tolerance)
        assert pair.plan.influence <= scene.tolerance
        moved, spread = pair.moved()
        if max(moved, spread) > BROKEN * scene.tolerance:
            broken.append(
                f"{number} {scene.kind}: mean {moved:.3g}, sd {spread:.3g} of {scene.tolerance:.3g}"
            )
    assert not broken


@pytest.mark.parametrize("number", [10, 15, 42, 56, 109])
def test_each_effect_alone_changes_no_more_than_its_influence(number: int) -> None:
    scene = random_scene(number, SHAPE)
    camera, conditions = scene.camera, scene.conditions
    freed = photoelectrons_from_image(camera, scene.image_pe)
    _, plan = select_camera_effects(camera, freed, conditions, scene.tolerance)
    light = camera.to_mcp_input(freed, conditions)
    tried = 0
    for effect in (*plan.kept, *plan.left_out):
        # Below a thousandth of the noise, single precision tells as much as the effect; beyond the
        # tolerance, shares of the variance are not meant to hold.
        if (
            effect.name == "pulse-height distribution"
            or not 1e-3 < effect.influence < scene.tolerance
        ):
            continue
        without = replace(camera, left_out=frozenset({effect.name}))
        pair = Pair(
            camera, without, plan, conditions, (light, without.to_mcp_input(freed, conditions))
        )
        moved, spread = pair.moved()
        # Extremes of random patterns lie beyond what bounds take with a chance of a tenth.
        assert max(moved, spread) < 1.2 * effect.influence + 1e-3, effect.name
        tried += 1
    assert tried > 0


def test_in_sparse_light_the_noise_tells_more_of_the_halo_than_the_mean(sheet: Camera) -> None:
    camera, conditions = (
        CameraModel(small(sheet)),
        Conditions(mcp_v=950.0, temperature_c=-20.0),
    )
    edge = np.where(np.arange(SHAPE[1]) < SHAPE[1] // 2, 0.02, 0.001) * np.ones((SHAPE[0], 1))
    freed = photoelectrons_from_image(camera, edge)
    without = replace(camera, left_out=frozenset({"halo"}))
    light = camera.to_mcp_input(freed, conditions), without.to_mcp_input(freed, conditions)
    _, plan = select_camera_effects(camera, freed, conditions, 0.1)
    pair = Pair(camera, without, plan, conditions, light)
    moved, spread = pair.moved()
    (halo,) = (effect for effect in (*plan.kept, *plan.left_out) if effect.name == "halo")
    assert moved < spread < halo.influence


@pytest.mark.parametrize("number", DRAWN)
def test_drawn_frames_of_random_scenes_keep_their_spread_and_their_rarest_level(
    number: int,
) -> None:
    scene = random_scene(number, SHAPE)
    pair = Pair.of(scene.camera, scene.image_pe, scene.conditions, scene.tolerance)
    inside = pair.in_scale()
    assert inside.sum() > 1000
    first, second = pair.frames(48, seed=4)

    def change(one: Array, other: Array) -> Array:
        first, second = (
            ((f - mean) / pair.noise)[:, inside]
            for f, mean in zip((one, other), pair.means, strict=True)
        )
        level = np.quantile(first, ONE_IN_A_THOUSAND)
        risen = (np.quantile(second, ONE_IN_A_THOUSAND) - level) / max(level, NORMAL_LEVEL)
        return np.array([second.std() - first.std(), risen])

    found, error = by_blocks(change, first, second)
    assert np.all(np.abs(found) < BROKEN * scene.tolerance + 4.0 * error)
