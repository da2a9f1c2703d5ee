"""Image of one frame behind each stage, for teaching and fault finding."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from simulate.camera.camera import CameraModel
from simulate.camera.chain import Chain, Slot, Stage
from simulate.camera.phosphor import apply_phosphor_decay
from simulate.camera.stage_image import StageImage
from simulate.radiance.cube import RadianceCube

NamedImage = tuple[str, str, NDArray[np.float32]]


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
    *earlier, last = range(decay.n_lag_fields + camera.fields_per_frame)
    fields = [
        screen.draw(at_mcp, np.random.default_rng([seed, 0, number])).values for number in earlier
    ]
    yield from (
        images := list(_draw_images(screen, at_mcp, np.random.default_rng([seed, 0, last])))
    )
    shown = apply_phosphor_decay([*fields, images[-1][2]], decay.weights)
    yield decay.name, decay.quantity, shown[-1]
    yield from _draw_images(
        chain.between(Slot.SCAN, Slot.VIDEO), StageImage(values=shown), readout_rng
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
    for stage, after in zip(chain.stages, chain.steps(light, rng), strict=True):
        yield _image_of(stage, after)


def _image_of(stage: Stage, light: StageImage) -> NamedImage:
    """The image without the margins of its cells, pending blurs applied."""
    image, grid = light.with_blurs_applied().values, light.grid
    image = image[-1] if image.ndim > 2 else image
    if grid is not None:
        image = image[grid.inside]
    return stage.name, stage.quantity, np.ascontiguousarray(image, np.float32)
