"""Camera simulation: a chain of physical stages from light on the photocathode to digital
numbers.
"""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.camera.automatic_controls import (
        AutomaticControls,
        AutomaticGain,
        AutomaticState,
        BrightnessControl,
    )
    from simulate.camera.camera import CameraModel
    from simulate.camera.ccd import Ccd, apply_column_blooming, spread_excess_charge
    from simulate.camera.chain import Chain, Slot, Stage
    from simulate.camera.effect_bounds import (
        NoiseBudget,
        bound_effects,
        select_camera_effects,
    )
    from simulate.camera.grid import Grid, grid_with_margin, rfft_image
    from simulate.camera.lens import RadiometricLens, few_transfers
    from simulate.camera.microchannel import MicrochannelPlate
    from simulate.camera.moments import PulseMoments
    from simulate.camera.phosphor import (
        Phosphor,
        PhosphorDecay,
        apply_phosphor_decay,
        decay_components,
    )
    from simulate.camera.photocathode import BrightSourceProtection, Photocathode
    from simulate.camera.pixels import Collection
    from simulate.camera.random_numbers import key_of, poisson_numbers
    from simulate.camera.register import Register
    from simulate.camera.scanner import noise_equivalent_radiance
    from simulate.camera.scene_to_photoelectrons import (
        camera_from_description,
        mcp_input_from_photoelectrons,
        mcp_input_from_radiance,
        photoelectrons_from_image,
        photoelectrons_from_radiance,
    )
    from simulate.camera.silicon import Silicon
    from simulate.camera.stage_image import StageImage
    from simulate.camera.taper import FibreGeometry, Taper
    from simulate.camera.thermal_imager import ThermalImager
    from simulate.camera.transfer import (
        Defocus,
        GapSpread,
        HaloBlur,
        PixelAperture,
        TubeShare,
        fold_transfer,
        product,
    )
    from simulate.camera.tube_photometry import (
        ELEMENTARY_CHARGE_C,
        JOULE_METRE,
        detection_weights,
        quantum_efficiency,
    )
    from simulate.camera.video import NoFilter, Video, VideoFilter, filter_lines, shift_lines

__all__ = [
    "ELEMENTARY_CHARGE_C",
    "JOULE_METRE",
    "AutomaticControls",
    "AutomaticGain",
    "AutomaticState",
    "BrightSourceProtection",
    "BrightnessControl",
    "CameraModel",
    "Ccd",
    "Chain",
    "Collection",
    "Defocus",
    "FibreGeometry",
    "GapSpread",
    "Grid",
    "HaloBlur",
    "MicrochannelPlate",
    "NoFilter",
    "NoiseBudget",
    "Phosphor",
    "PhosphorDecay",
    "Photocathode",
    "PixelAperture",
    "PulseMoments",
    "RadiometricLens",
    "Register",
    "Silicon",
    "Slot",
    "Stage",
    "StageImage",
    "Taper",
    "ThermalImager",
    "TubeShare",
    "Video",
    "VideoFilter",
    "apply_column_blooming",
    "apply_phosphor_decay",
    "bound_effects",
    "camera_from_description",
    "decay_components",
    "detection_weights",
    "few_transfers",
    "filter_lines",
    "fold_transfer",
    "grid_with_margin",
    "key_of",
    "mcp_input_from_photoelectrons",
    "mcp_input_from_radiance",
    "noise_equivalent_radiance",
    "photoelectrons_from_image",
    "photoelectrons_from_radiance",
    "poisson_numbers",
    "product",
    "quantum_efficiency",
    "rfft_image",
    "select_camera_effects",
    "shift_lines",
    "spread_excess_charge",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.camera.automatic_controls": (
            "AutomaticControls AutomaticGain AutomaticState BrightnessControl"
        ),
        "simulate.camera.camera": "CameraModel",
        "simulate.camera.ccd": "Ccd apply_column_blooming spread_excess_charge",
        "simulate.camera.chain": "Chain Slot Stage",
        "simulate.camera.effect_bounds": ("NoiseBudget bound_effects select_camera_effects"),
        "simulate.camera.grid": "Grid grid_with_margin rfft_image",
        "simulate.camera.lens": "RadiometricLens few_transfers",
        "simulate.camera.microchannel": "MicrochannelPlate",
        "simulate.camera.moments": "PulseMoments",
        "simulate.camera.phosphor": "Phosphor PhosphorDecay apply_phosphor_decay decay_components",
        "simulate.camera.photocathode": "BrightSourceProtection Photocathode",
        "simulate.camera.pixels": "Collection",
        "simulate.camera.random_numbers": "key_of poisson_numbers",
        "simulate.camera.register": "Register",
        "simulate.camera.scanner": "noise_equivalent_radiance",
        "simulate.camera.scene_to_photoelectrons": (
            "camera_from_description mcp_input_from_photoelectrons mcp_input_from_radiance "
            "photoelectrons_from_image photoelectrons_from_radiance"
        ),
        "simulate.camera.silicon": "Silicon",
        "simulate.camera.stage_image": "StageImage",
        "simulate.camera.taper": "FibreGeometry Taper",
        "simulate.camera.thermal_imager": "ThermalImager",
        "simulate.camera.transfer": (
            "Defocus GapSpread HaloBlur PixelAperture TubeShare fold_transfer product"
        ),
        "simulate.camera.tube_photometry": (
            "ELEMENTARY_CHARGE_C JOULE_METRE detection_weights quantum_efficiency"
        ),
        "simulate.camera.video": "NoFilter Video VideoFilter filter_lines shift_lines",
    },
)
