"""Fast sampler: pulses from tabulated distributions, spread by kernels that conserve the
covariance.
"""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.camera.fast_sampler.event_samplers import Exposure
    from simulate.camera.fast_sampler.kernel import noise_kernel
    from simulate.camera.fast_sampler.single_pulses import SparseLight, SparseScreen

__all__ = ["Exposure", "SparseLight", "SparseScreen", "noise_kernel"]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.camera.fast_sampler.event_samplers": "Exposure",
        "simulate.camera.fast_sampler.kernel": "noise_kernel",
        "simulate.camera.fast_sampler.single_pulses": "SparseLight SparseScreen",
    },
)
