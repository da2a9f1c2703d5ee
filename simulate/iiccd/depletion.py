"""Channels that have fired are poor in charge: the gain of a plate falls where it is bright and recovers in time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd.grid import Grid

Map = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class Depletion:
    """What the light of a place takes from the channels around it.

    Parameters
    ----------
    saturation_e_per_s_cm2
        Steady output, were the gain undiminished, at which it has halved, electrons per s and cm2.
    blur_um
        Width (standard deviation) of the neighbourhood whose output counts, um.
    recovery_ms
        Time constant with which channels recharge, ms.
    field_s
        Time from one exposure to the next, s.

    Notes
    -----
    h(u) = 1/(1 + u): in steady light u is the undiminished output over the saturating one, blurred by a Gaussian; in
    changing light u follows that load with the channels' time constant, du/dt = (load - u)/tau. The state between
    fields is the map u, carried by the caller; None is a plate that has rested.
    """

    saturation_e_per_s_cm2: float
    blur_um: float
    recovery_ms: float
    field_s: float

    def __post_init__(self) -> None:
        for name in ("saturation_e_per_s_cm2", "recovery_ms", "field_s"):
            if not getattr(self, name) > 0.0:
                raise BadInput(f"{name} must be positive, got {getattr(self, name):g}")
        if not self.blur_um >= 0.0:
            raise BadInput(f"blur_um must not be negative, got {self.blur_um:g}")

    def load(self, output_e: Map, grid: Grid) -> Map:
        """Return the load of an undiminished output, electrons per cell and exposure, shape (..., row, col)."""
        from scipy.ndimage import gaussian_filter

        per_cell = self.saturation_e_per_s_cm2 * grid.cell_area_cm2 * self.field_s
        widths = (
            self.blur_um * 1e-3 / grid.pitch_y_mm * grid.per_row,
            self.blur_um * 1e-3 / grid.pitch_x_mm * grid.per_column,
        )
        sigma = (*(0.0 for _ in output_e.shape[:-2]), *widths)
        return gaussian_filter(np.asarray(output_e, np.float64), sigma, mode="nearest") / per_cell

    def gain(self, state: Map) -> Map:
        """Return the gain that is left, dimensionless."""
        return 1.0 / (1.0 + state)

    def during(self, state: Map | None, load: Map) -> Map:
        """Return the mean state over a field that starts from `state` under a load."""
        fade = self.field_s / (self.recovery_ms * 1e-3)
        kept = -np.expm1(-fade) / fade
        return load * (1.0 - kept) + (0.0 if state is None else state * kept)

    def next(self, state: Map | None, load: Map) -> Map:
        """Return the state at the end of that field."""
        kept = np.exp(-self.field_s / (self.recovery_ms * 1e-3))
        return load * (1.0 - kept) + (0.0 if state is None else state * kept)
