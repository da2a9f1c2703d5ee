"""A simulated camera before its light: frames, images after each stage, and what was neglected."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labdata import Conditions, Kind, Target
from simulate.camera.camera import CameraModel
from simulate.camera.chain import Chain, Slot, Stage
from simulate.camera.phosphor import apply_phosphor_decay
from simulate.camera.stage_image import StageImage
from simulate.motion import Look, Motion
from simulate.radiance.cube import RadianceCube

if TYPE_CHECKING:
    from simulate.effect_selection import EffectSelection
    from simulate.infrared_view import InfraredView
    from simulate.outdoor_rendering import RenderedView

NamedImage = tuple[str, str, NDArray[Any]]  # name, quantity with unit, image (row, col)
Keep = Callable[[int, Any], None]  # called with the number of a frame and its view


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A simulated camera, its light and the metadata of the session.

    Parameters
    ----------
    camera, light
        The camera, and expected photoelectrons at the MCP, or in the sensor of a camera without
        tube.
    kind, conditions, target, notes
        Metadata of the stack.
    seen
        Input of the camera: an image in photoelectrons, a radiance cube, or None.
    plan, exact
        Effect selection (None for a camera without tube, where all are retained); whether every
        pulse is sampled.
    view
        Rendering of an outdoor scene: radiance, effect selection and auxiliary layers.
    delay_s
        Time of the first frame after that of the scene, s.
    motion
        Motion of an outdoor scene with keyframes.
    """

    camera: Any
    light: Any
    kind: Kind
    conditions: Conditions
    seen: Any = None
    target: Target = field(default_factory=Target)
    notes: tuple[str, ...] = ()
    plan: "EffectSelection | None" = None
    exact: bool = False
    view: "RenderedView | InfraredView | None" = None
    delay_s: float = 0.0
    motion: Motion | None = None

    @property
    def frame_distortion(self) -> tuple[float, ...]:
        """Radial distortions of lens and taper, in the order of the light, dimensionless."""

        fibres = (
            (self.camera.stage(Slot.FIBRES).distortion_fraction,) if self.camera.has_tube else ()
        )
        return (self.camera.lens().distortion_fraction, *fibres)

    def time_s(self, frame: float) -> float:
        """Return the time of a frame after that of the scene, s."""
        return self.delay_s + frame * self.camera.frame_s

    def frames(
        self, *, seed: int, count: int, keep: Keep = lambda number, view: None
    ) -> Iterator[NDArray[Any]]:
        """Yield frames, shape (row, col), DN.

        Parameters
        ----------
        seed, count
            Seed, and number of frames.
        keep
            Of a moving scene: called with the number of each frame whose view is another than that
            of the frame before.
        """
        steps = self._exposures_per_frame
        times_s = [self.time_s(number / steps) for number in range(count * steps)]
        if self.motion is None or self.motion.is_still(times_s):
            yield from islice(self._still_frames(seed), count)
            return
        yield from self._moving_frames(seed, self._looks(self.motion, times_s, keep))

    @property
    def _exposures_per_frame(self) -> int:
        return self.camera.fields_per_frame if self.camera.has_tube else 1

    def _looks(self, motion: Motion, times_s: list[float], keep: Keep) -> Iterator[Look]:
        assert self.view is not None
        steps, view = self._exposures_per_frame, self.view
        for number, look in enumerate(
            motion.looks(Look(view=self.view, light=self.light), times_s)
        ):
            if number % steps == 0 and look.view is not view:
                view = look.view
                keep(number // steps, view)
            yield look

    def _still_frames(self, seed: int) -> Iterator[NDArray[Any]]:
        threads = min(2, os.cpu_count() or 1)
        return self.camera.frames(
            self.light, self.conditions, seed=seed, exact=self.exact, threads=threads
        )

    def _moving_frames(self, seed: int, looks: Iterator[Look]) -> Iterator[NDArray[Any]]:
        if self.camera.has_tube:
            lights = (look.light for look in looks)
            yield from self.camera.moving_frames(lights, self.conditions, seed=seed, settled=True)
            return
        for number, look in enumerate(looks):
            settings = {"seed": seed, "first_frame": number, "exact": self.exact}
            yield next(self.camera.frames(look.light, self.conditions, **settings))

    def stages(self, *, seed: int) -> Iterator[NamedImage]:
        """Yield the input, the expected photoelectrons or radiance behind the lens, and the image
        after each stage.
        """
        if isinstance(self.seen, RadianceCube):
            yield from stage_images(self.camera, self.seen, self.conditions, seed)
            return
        if self.seen is not None:
            yield "picture", "photoelectrons per exposure and pixel, expected", self.seen
        location = "at the plate" if self.camera.has_tube else "in the chip"
        pixels = self.light.values[(..., *self.light.grid.frame_slices)]
        yield f"photoelectrons {location}", "photoelectrons per exposure and cell, expected", pixels
        yield from stage_images(self.camera, self.light, self.conditions, seed)

    @property
    def explanation(self) -> str:
        """Text of retained and neglected effects of light and camera with their bounds."""
        light = () if self.view is None else (self.view.text(), "")
        camera = (
            "camera without tube: all effects are retained"
            if self.plan is None
            else self.plan.text()
        )
        return "\n".join((*light, camera))

    @property
    def economy_note(self) -> str:
        """Note on neglected effects."""
        if self.plan is None or self.exact:
            return "nothing left out"
        names = ", ".join(effect.name for effect in self.plan.left_out) or "nothing"
        influence = (
            f"{100.0 * self.plan.influence:.2g} % of the temporal noise, of "
            f"{100.0 * self.plan.tolerance:g} %"
        )
        return f"left out, together at most {influence} allowed: {names}; see economy.json"


@dataclass(frozen=True, kw_only=True)
class InfraredShot(Shot):
    """A thermal imager before an outdoor scene; `seen` is its `InfraredView`."""

    @property
    def frame_distortion(self) -> tuple[float, ...]:
        """Radial distortions: none, as the distortion of the imager is that of its view."""
        return ()

    def _still_frames(self, seed: int) -> Iterator[NDArray[Any]]:
        return self.camera.frames_of_signal(self.light, seed=seed)

    def _moving_frames(self, seed: int, looks: Iterator[Look]) -> Iterator[NDArray[Any]]:
        # The lag of a frame needs those before it.
        signals = np.stack([look.light for look in looks])
        return self.camera.frames_of_signal(signals, seed=seed)

    def stages(self, *, seed: int) -> Iterator[NamedImage]:
        """Yield the apparent temperature and a frame."""
        yield (
            "apparent temperature",
            "temperature of a black body of that radiance, K",
            self.seen.picture.apparent_k(),
        )
        yield "frame", "DN", next(self.frames(seed=seed, count=1))

    @property
    def explanation(self) -> str:
        return self.seen.text()

    @property
    def economy_note(self) -> str:
        return "no effect of the imager left out"


def stage_images(
    camera: CameraModel, light: StageImage | RadianceCube, conditions: Conditions, seed: int
) -> Iterator[NamedImage]:
    """Yield the image of one frame behind each stage.

    Parameters
    ----------
    camera
        The camera.
    light
        Spectral radiance of the scene, seen from the lens on; or expected photoelectrons at the MCP
        input, on `cells`, seen from the MCP on.
    conditions
        Gate, voltage and temperature; automatic controls stand untouched.
    seed
        Seed of the frame.

    Yields
    ------
    tuple
        Name of the stage, quantity with its unit, and image (row, col), float32: of the frame's
        last field as far as fields are apart, of the whole frame from the scan on. Images on cells
        are cut to the image, and blurs that the chain computes only later are computed for them.
    """
    at_mcp: Any = light
    if isinstance(light, RadianceCube):
        at_mcp = yield from _before_the_draw(camera, light, conditions)
    chain, readout_rng = camera.chain(conditions), np.random.default_rng([seed, 1, 0])
    if not camera.has_tube:
        yield from _draw_images(chain.between(Slot.PIXELS, Slot.VIDEO), at_mcp, readout_rng)
        return
    screen, decay = chain.between(Slot.MCP, Slot.PIXELS), chain[Slot.DECAY]
    *earlier_fields, last_field = range(decay.n_lag_fields + camera.fields_per_frame)
    fields = [
        screen.draw(at_mcp, np.random.default_rng([seed, 0, number])).values
        for number in earlier_fields
    ]
    yield from (
        images := list(_draw_images(screen, at_mcp, np.random.default_rng([seed, 0, last_field])))
    )
    images_shown = apply_phosphor_decay([*fields, images[-1][2]], decay.weights)
    yield decay.name, decay.quantity, images_shown[-1]
    yield from _draw_images(
        chain.between(Slot.SCAN, Slot.VIDEO), StageImage(values=images_shown), readout_rng
    )


def _before_the_draw(camera: CameraModel, cube: RadianceCube, conditions: Conditions):
    """Noiseless stages up to the MCP or the chip; returns the image behind them."""
    lens = camera.lens()
    photons_per_s = lens.mean(cube)
    yield _image_of(lens, photons_per_s)
    if not camera.has_tube:
        light = camera.mcp_input(photons_per_s, conditions)
        yield _image_of(camera.stage(Slot.SILICON, conditions), light)
        return light
    cathode = camera.stage(Slot.PHOTOCATHODE, conditions)
    light = cathode.mean(photons_per_s)
    yield _image_of(cathode, light)
    for stage in camera.to_plate(conditions, camera.cathode_lux(light)).stages:
        light = stage.mean(light)
        yield _image_of(stage, light)
    return light


def _draw_images(chain: Chain, light: StageImage, rng: np.random.Generator) -> Iterator[NamedImage]:
    for stage, image in zip(chain.stages, chain.steps(light, rng), strict=True):
        yield _image_of(stage, image)


def _image_of(stage: Stage, light: StageImage) -> NamedImage:
    """The image without the margins of its cells, pending blurs applied."""
    image, grid = light.with_blurs_applied().values, light.grid
    image = image[-1] if image.ndim > 2 else image
    if grid is not None:
        image = image[grid.frame_slices]
    return stage.name, stage.quantity, np.ascontiguousarray(image, np.float32)
