"""Image of one frame behind each stage, for teaching and fault finding."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.chain import Chain
from simulate.iiccd.phosphor import apply_phosphor_decay
from simulate.iiccd.solid_state import SiliconCamera
from simulate.iiccd.stage_image import StageImage as Light
from simulate.radiance.cube import RadianceCube

NamedImage = tuple[str, str, NDArray[np.float32]]

# What is seen after each stage, with its unit; cells are those of the grid at that place.
QUANTITIES = {
    "optics": "photons per s and cell, of the wavelength detected best",
    "photocathode": "photoelectrons per exposure and cell, expected",
    "gap": "photoelectrons at the plate per exposure and cell, expected",
    "fibre geometry": "photoelectrons at the plate per exposure and cell, expected where they will be seen",
    "microchannel plate": "electrons per exposure and cell",
    "phosphor": "photons per exposure and cell",
    "taper": "photons per exposure and cell",
    "pixels": "photons per exposure and pixel",
    "afterglow": "photons per exposure and pixel",
    "scan": "photons per exposure and pixel as read",
    "silicon": "photoelectrons per exposure and cell, expected",
    "ccd": "electrons per pixel",
    "register": "electrons per pixel behind the register",
    "video": "DN",
}

# Without a tube the pixels collect what the chip has already detected.
IN_CHIP = {**QUANTITIES, "pixels": "photoelectrons per exposure and pixel, expected"}


def stage_images(
    camera: IntensifiedCamera | SiliconCamera, light: Light | RadianceCube, conditions: Conditions, seed: int
) -> Iterator[NamedImage]:
    """Yield the image of one frame behind each stage.

    Parameters
    ----------
    camera
        The camera.
    light
        Spectral radiance of the scene, seen from the lens on; or expected photoelectrons at the MCP input, on `cells`,
        seen from the MCP on.
    conditions
        Gate, voltage and temperature; automatic controls stand untouched.
    seed
        Seed of the frame.

    Yields
    ------
    tuple
        Name of the stage, quantity with its unit, and image (row, col), float32: of the frame's last field as far as
        fields are apart, of the whole frame from the scan on. Images on cells are cut to the image, and blurs that
        the chain computes only later are computed for them.
    """
    at_mcp = light
    if isinstance(light, RadianceCube):
        at_mcp = yield from _before_the_draw(camera, light, conditions)
    assert isinstance(at_mcp, Light)
    if isinstance(camera, SiliconCamera):
        behind = camera.chain(conditions).between("pixels", "video")
        yield from _images_after_stages(behind, at_mcp, np.random.default_rng([seed, 1, 0]), IN_CHIP)
        return
    yield from _field_and_frame(camera, at_mcp, conditions, seed)


def _before_the_draw(camera: IntensifiedCamera | SiliconCamera, cube: RadianceCube, conditions: Conditions):
    """Noiseless stages up to the MCP or the chip; returns the image behind them."""
    names = [stage.name for stage in camera.chain(conditions).stages]
    last = names[names.index("silicon" if isinstance(camera, SiliconCamera) else "microchannel plate") - 1]
    photons_per_s = camera.lens().mean(cube)
    yield _image_of("optics", photons_per_s)
    if isinstance(camera, SiliconCamera):
        in_chip = camera.mcp_input(photons_per_s, conditions)
        yield _image_of("silicon", in_chip)
        return in_chip
    light = camera.photocathode(conditions).mean(photons_per_s)
    yield _image_of("photocathode", light)
    lux = camera.cathode_lux(light)
    for stage in camera.chain(conditions, cathode_lux=lux).between("gap", last).stages:
        light = stage.mean(light)
        yield _image_of(stage.name, light)
    return light


def _field_and_frame(
    camera: IntensifiedCamera, at_mcp: Light, conditions: Conditions, seed: int
) -> Iterator[NamedImage]:
    """MCP to pixels for the last field, the decay light of earlier fields, and the frame that is read."""
    chain, glow = camera.chain(conditions), camera.afterglow(conditions)
    screen = chain.between("microchannel plate", "pixels")
    earlier = [
        screen.draw(at_mcp, np.random.default_rng([seed, 0, number])).values
        for number in range(glow.n_lag_fields + camera.fields_per_frame - 1)
    ]
    last = list(_images_after_stages(screen, at_mcp, np.random.default_rng([seed, 0, len(earlier)])))
    yield from last
    shown = apply_phosphor_decay(np.stack([*earlier, last[-1][2]]), glow.weights)
    yield "afterglow", QUANTITIES["afterglow"], shown[-1]
    yield from _images_after_stages(
        chain.between("scan", "video"), Light(values=shown), np.random.default_rng([seed, 1, 0])
    )


def _images_after_stages(
    chain: Chain, light: Light, rng: np.random.Generator, quantities: dict[str, str] = QUANTITIES
) -> Iterator[NamedImage]:
    for stage, after in zip(chain.stages, chain.steps(light, rng), strict=True):
        yield _image_of(stage.name, after, quantities)


def _image_of(name: str, light: Light, quantities: dict[str, str] = QUANTITIES) -> NamedImage:
    """The image without the margins of its cells, pending blurs applied."""
    image, grid = light.with_blurs_applied().values, light.grid
    image = image[-1] if image.ndim > 2 else image
    if grid is not None:
        top, left = grid.margin_rows * grid.per_row, grid.margin_columns * grid.per_column
        image = image[top : top + grid.rows * grid.per_row, left : left + grid.columns * grid.per_column]
    return name, quantities[name], np.ascontiguousarray(image, np.float32)
