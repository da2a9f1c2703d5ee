"""The simulated camera of a description, with a tube or without."""

from labdata.sensor import Sensor
from labdata.solid_state import SolidStateCamera
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.solid_state import SiliconCamera

Camera = IntensifiedCamera | SiliconCamera


def camera_from_description(description: Sensor | SolidStateCamera) -> Camera:
    """Return the camera as it sees scenes and pictures: whole, with the geometry of its fibres and local depletion.

    The lab bench builds its own, without geometry: there a target's place on the frame is known.
    """
    if isinstance(description, SolidStateCamera):
        return SiliconCamera(description)
    return IntensifiedCamera(description, geometry=True, local_depletion=True)
