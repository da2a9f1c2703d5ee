"""Description of a camera: the sections that it may have, and their parameters."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from labdata.camera.chip import (
        Ccd,
        Readout,
        Register,
        Silicon,
        excess_noise_factor,
        gain_at_no_signal,
    )
    from labdata.camera.description import Camera, ThermalImagerFile, camera_from_mapping
    from labdata.camera.maps import PixelMap, SpecimenMaps
    from labdata.camera.optics import Band, InfraredOptics, Optics
    from labdata.camera.parameters import Draws, Parameter
    from labdata.camera.thermal import SCAN_DIRECTIONS, Bolometer, CooledArray, PixelArray, Scanner
    from labdata.camera.tube import (
        MicrochannelPlate,
        Phosphor,
        Photocathode,
        Taper,
        Tube,
        TubeLimits,
    )
    from labdata.camera.video import InfraredVideo, Video

__all__ = [
    "SCAN_DIRECTIONS",
    "Band",
    "Bolometer",
    "Camera",
    "Ccd",
    "CooledArray",
    "Draws",
    "InfraredOptics",
    "InfraredVideo",
    "MicrochannelPlate",
    "Optics",
    "Parameter",
    "Phosphor",
    "Photocathode",
    "PixelArray",
    "PixelMap",
    "Readout",
    "Register",
    "Scanner",
    "Silicon",
    "SpecimenMaps",
    "Taper",
    "ThermalImagerFile",
    "Tube",
    "TubeLimits",
    "Video",
    "camera_from_mapping",
    "excess_noise_factor",
    "gain_at_no_signal",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "labdata.camera.chip": "Ccd Readout Register Silicon excess_noise_factor gain_at_no_signal",
        "labdata.camera.description": "Camera ThermalImagerFile camera_from_mapping",
        "labdata.camera.maps": "PixelMap SpecimenMaps",
        "labdata.camera.optics": "Band InfraredOptics Optics",
        "labdata.camera.parameters": "Draws Parameter",
        "labdata.camera.thermal": "Bolometer CooledArray PixelArray SCAN_DIRECTIONS Scanner",
        "labdata.camera.tube": "MicrochannelPlate Phosphor Photocathode Taper Tube TubeLimits",
        "labdata.camera.video": "InfraredVideo Video",
    },
)
