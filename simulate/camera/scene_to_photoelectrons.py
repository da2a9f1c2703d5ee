"""From scene radiance, or an image in photoelectrons, to photoelectrons in a camera."""

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput, Camera, Conditions
from simulate.camera import image_placement
from simulate.camera.camera import CameraModel
from simulate.camera.stage_image import StageImage
from simulate.radiance.cube import RadianceCube


def camera_from_description(description: Camera) -> CameraModel:
    """Return the camera with all effects: fibre geometry and local gain depletion included.

    The lab bench builds its own, without geometry: there a target's place on the frame is known. A
    thermal imager is BadInput: it sees no visible light.
    """
    if description.is_thermal:
        raise BadInput(
            f"light at a photocathode or chip needs a camera of visible light, got "
            f"{description.name!r}"
        )
    return CameraModel(description, geometry=True, local_depletion=True)


def mcp_input_from_radiance(
    camera: CameraModel,
    cube: RadianceCube,
    conditions: Conditions,
    *,
    distance_m: float | None = None,
) -> StageImage:
    """Return the expected photoelectrons at the MCP input; arguments as for
    `photoelectrons_from_radiance`.
    """
    photoelectrons = photoelectrons_from_radiance(camera, cube, conditions, distance_m=distance_m)
    return camera.to_mcp_input(photoelectrons, conditions)


def mcp_input_from_photoelectrons(
    camera: CameraModel, image_pe: NDArray[np.floating], conditions: Conditions
) -> StageImage:
    """Return the expected photoelectrons at the MCP input; the image is as for
    `photoelectrons_from_image`.
    """
    return camera.to_mcp_input(photoelectrons_from_image(camera, image_pe), conditions)


def photoelectrons_from_radiance(
    camera: CameraModel,
    cube: RadianceCube,
    conditions: Conditions,
    *,
    distance_m: float | None = None,
) -> StageImage:
    """Return the expected photoelectrons of a scene of known radiance, per cell of `scene_cells`
    and exposure.

    Parameters
    ----------
    camera
        The camera.
    cube
        Spectral radiance of the scene; its pixels, of any number, cover the frame exactly, as a
        lens without distortion would image them. Beyond the frame it goes on as it ends there.
    conditions
        Gate or exposure.
    distance_m
        Distance of the scene from the lens; far away if None. It enters the magnification alone, m
        = f/(d - f).

    Raises
    ------
    BadInput
        If a radiance is not a number, infinite or negative, or the scene lies within twice the
        focal length.
    """
    lens = camera.lens()
    if distance_m is not None:
        focal_m = lens.focal_length_mm * 1e-3
        if not distance_m > 2.0 * focal_m:
            raise BadInput(
                f"a scene must lie beyond twice the focal length, {2.0 * focal_m:g} m, got "
                f"{distance_m:g} m"
            )
        lens = camera.lens(focal_m / (distance_m - focal_m))
    return camera.photoelectrons(lens.mean(cube), conditions)


def photoelectrons_from_image(camera: CameraModel, image_pe: NDArray[np.floating]) -> StageImage:
    """Return an image in photoelectrons as photoelectrons per cell of `scene_cells` and exposure.

    Parameters
    ----------
    camera
        The camera.
    image_pe
        Mean photoelectrons that light frees from the cathode, per pixel as read and exposure, on
        the pixels of the frame: shape (row, col) of `camera.shape`. A flat image of x gives x per
        pixel as read. Rows of an interlaced frame sum two rows of the chip and overlap by one: each
        row of the image is laid between the middles of the two, and half of what its pixel reads is
        its own, a quarter each neighbour's.

    Raises
    ------
    BadInput
        If the image has another shape than the frame, or an amount that is not a number, infinite
        or negative.
    """
    if image_pe.shape != camera.shape:
        raise BadInput(
            f"a picture in photoelectrons must have the frame's shape {camera.shape}, got "
            f"{image_pe.shape}"
        )
    lowest, highest = (
        (float(image_pe.min()), float(image_pe.max())) if image_pe.size else (0.0, 0.0)
    )
    if not (np.isfinite(lowest) and np.isfinite(highest)) or lowest < 0.0:
        raise BadInput(
            f"photoelectrons must be finite and not negative, got {lowest:g} to {highest:g}"
        )
    cells = camera.scene_cells
    per_pixel = cells.per_column * cells.per_row * camera.fields_per_frame
    spread = image_placement.place_on_cells(
        image_pe, cells, row_pairs=camera.description.interlaced
    ) / np.float32(per_pixel)
    return StageImage(values=spread, grid=cells)
