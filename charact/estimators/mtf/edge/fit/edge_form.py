"""Form of an edge's transfer: shift, blur model and, if asked, smooth model departures and a free
video bandwidth.

Transfer = known part x core x exp(departure) x extended component, times the phase of the shift and
a free smooth phase: a causal filter or a nonlinear response makes edges asymmetric.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.thresholds import ACCURACY
from charact.estimators.mtf.known_transfer import KnownTransfer, halo_diameters_px
from charact.estimators.mtf.mean_frame import OrientedFrame
from charact.method import Context
from charact.transfer.blur_model import BlurModel
from charact.transfer.extended import ExtendedComponent, HaloComponent, ScatterComponent
from charact.transfer.form import table_of
from charact.transfer.video_filter import VideoFilter, powers
from labdata.camera.description import has_tube

Array = NDArray[np.float64]

# Knots of the departure of ln modulus and of the phase, in units of the half frequency: from a
# third of it to where little contrast is left. Prior standard deviations of the phases, rad.
KNOTS = np.array([0.35, 0.6, 0.9, 1.3, 1.8, 2.5])
PHASE_KNOTS = np.array([1.0, 1.5, 2.1, 2.8])
PHASE_SD = np.array([0.2, 0.3, 0.5, 0.7])


@dataclass(frozen=True, kw_only=True)
class EdgeForm:
    """Possible transfers of an edge and their prior.

    Parameters
    ----------
    family
        The blur model.
    departure_sd
        Prior standard deviation of ln of the departure at each knot; 0: neither departures nor
        phases.
    scale
        Half frequency about which the knots lie, cy/px.
    known
        Known transfer whose video bandwidth is one more parameter where it is uncertain; None: it
        is exact.
    """

    family: BlurModel
    departure_sd: float = 0.0
    scale: float = 1.0
    known: KnownTransfer | None = None

    @cached_property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of each parameter: shift, core, departures, phases, extended component,
        bandwidth.
        """
        core = list(table_of(self.family.parameters).items())
        component = core[self.family.core_parameters :]
        bends = [(f"departure_{k}", ("1", (-6.0, 6.0))) for k in range(self._knots)]
        phases = [
            (f"phase_{k}", ("rad", (-6.0 * sd, 6.0 * sd)))
            for k, sd in enumerate(PHASE_SD[: self._phases])
        ]
        shift = ("edge_shift_px", ("px", (-ACCURACY.max_shift_px, ACCURACY.max_shift_px)))
        video = self.video.parameters if self.video else {}
        return {
            **dict([shift, *core[: self.family.core_parameters], *bends, *phases, *component]),
            **video,
        }

    @cached_property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([bound for _, bound in self.parameters.values()])

    @property
    def video(self) -> VideoFilter | None:
        """The video filter of uncertain bandwidth, or None."""
        video = self.known.video if self.known else None
        return video if video and video.parameters else None

    @property
    def _knots(self) -> int:
        return KNOTS.size if self.departure_sd else 0

    @property
    def _phases(self) -> int:
        return PHASE_KNOTS.size if self.departure_sd else 0

    @property
    def phase_index(self) -> slice:
        """Where the phases are among the parameters."""
        first = 1 + self.family.core_parameters + self._knots
        return slice(first, first + self._phases)

    def family_part(self, theta: Array) -> Array:
        """Return the parameters of the blur model, shape (n, parameter)."""
        if not self.departure_sd:
            return theta[:, 1 : 1 + len(self.family.parameters)]
        core, size = self.family.core_parameters, len(self.family.parameters)
        return np.concatenate(
            [theta[:, 1 : 1 + core], theta[:, self.phase_index.stop :][:, : size - core]], axis=1
        )

    def expand(self, family: Array) -> Array:
        """Return points without shift, departures and change of bandwidth, from those of the blur
        model.
        """
        core = self.family.core_parameters
        none = [
            np.zeros((len(family), size))
            for size in (1, self._knots + self._phases, int(self.video is not None))
        ]
        return np.concatenate(
            [none[0], family[:, :core], none[1], family[:, core:], none[2]], axis=1
        )

    def modulus(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer over its known part, without phase, shape (n, f)."""
        modulus = self.family.modulus(self.family_part(theta), frequency)
        ln = 0.0
        if self.departure_sd:
            first = 1 + self.family.core_parameters
            shapes, _ = _shapes_at(self.scale, frequency.tobytes())
            ln = self.departure_sd * theta[:, first : first + self._knots] @ shapes
        if self.known is not None and self.video:
            ln = ln + powers(theta[:, -1]) @ _bend_at(self.known, frequency.tobytes()).real
        return modulus * np.exp(ln) if np.ndim(ln) else modulus

    def delay(self, theta: Array, grid: Array, centre_px: float) -> Array:
        """Return by how many turns each node is late beyond a shift, shape (n, node)."""
        late = np.multiply.outer(theta[:, 0] - centre_px, grid)
        if self.departure_sd:
            late -= (
                theta[:, self.phase_index]
                @ _shapes_at(self.scale, grid.tobytes())[1]
                / (2.0 * np.pi)
            )
        if self.known is not None and self.video:
            late -= powers(theta[:, -1]) @ _bend_at(self.known, grid.tobytes()).imag / (2.0 * np.pi)
        return late

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds."""
        value = self.family.log_prior(self.family_part(theta))
        within_bounds = np.all((theta >= self.bounds[:, 0]) & (theta <= self.bounds[:, 1]), axis=1)
        if self.departure_sd:
            first = 1 + self.family.core_parameters
            standard = np.concatenate(
                [theta[:, first : first + self._knots], theta[:, self.phase_index] / PHASE_SD],
                axis=1,
            )
            value = value - 0.5 * np.sum(standard**2, axis=1)
        if self.video:
            value = value + self.video.log_prior(theta[:, -1])
        return np.where(within_bounds, value, -np.inf)


def cosine_shapes(ratio: Array, knots: Array) -> Array:
    """Return cosine bumps in the logarithm of a ratio, one at each knot and the last one held,
    shape (knot, ratio).
    """
    ln = np.log(np.maximum(ratio, 1e-300))
    knot_position = np.interp(ln, np.log(knots), np.arange(knots.size))
    entry = (ln - np.log(knots[0])) / np.log(knots[1] / knots[0])
    knot_position = np.where(entry < 0, np.maximum(entry, -1.0), knot_position)
    knots_apart = np.clip(np.abs(knot_position - np.arange(knots.size)[:, None]), 0.0, 1.0)
    return 0.5 * (1.0 + np.cos(np.pi * knots_apart))


@lru_cache(maxsize=8)
def _shapes_at(scale: float, grid: bytes) -> tuple[Array, Array]:
    """Return the shapes of departures and of phases at frequencies."""
    ratio = np.frombuffer(grid) / scale
    return cosine_shapes(ratio, KNOTS), cosine_shapes(ratio, PHASE_KNOTS)


@lru_cache(maxsize=8)
def _bend_at(known: KnownTransfer, grid: bytes) -> NDArray[np.complex128]:
    """Return how ln of the known transfer moves with powers of ln bandwidth at frequencies."""
    bend = known.bend(np.frombuffer(grid))
    assert bend is not None, "an uncertain bandwidth bends the transfer"
    return bend


def halo_of(
    picture: OrientedFrame, half_width_px: float, context: Context
) -> tuple[ExtendedComponent | None, bool]:
    """Return the prior of a halo that the window contains, and whether the description states a
    halo.

    The halo is four proximity gaps wide. For a camera without a description only scattered light
    that ends inside the window can be separated from an illumination gradient.
    """
    if not has_tube(context.camera):
        longest = 0.25 * half_width_px
        return (ScatterComponent(size_px=(2.0, longest)), False) if longest > 4.0 else (None, False)
    low, high = halo_diameters_px(context, transposed=picture.transposed)
    if half_width_px < 0.6 * high:
        return None, False
    return HaloComponent(size_px=(low, high), fraction=(0.0, 0.4)), True
