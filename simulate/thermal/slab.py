"""Temperatures of layered slabs over time: implicit steps, the periodic state they start from, and
their kernels.

Heat flows through each slab only along its depth, and slabs do not act on each other. Properties do
not change with temperature, so that the inside of a slab is linear: each step eliminates it from
the back, solves the balance of the face by Newton's method, and substitutes back. All slabs are
computed together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from simulate.arrays import Array
from simulate.radiance.outdoor.materials import Slab
from simulate.radiance.outdoor.scene import ConvectionLaw
from simulate.radiance.spectrum import STEFAN_BOLTZMANN
from simulate.thermal.thresholds import LIMITS

ZERO_C = 273.15
# Psychrometric constant at 1013 hPa, Pa/K; it scales with pressure.
PSYCHROMETRIC_PA_K, STANDARD_HPA = 66.5, 1013.0
# Offset and coefficient of the wind, W m-2 K-1 and W m-2 K-1 / (m/s).
LINEAR_LAWS = {"mcadams": (5.7, 3.8), "watmuff": (2.8, 3.0)}


def vapour_pressure_pa(dew_point_k: ArrayLike) -> Array:
    """Return the pressure of vapour that is saturated at a temperature, Pa (Magnus formula over
    water).
    """
    celsius = np.asarray(dew_point_k, float) - ZERO_C
    return 611.2 * np.exp(17.62 * celsius / (243.12 + celsius))


def dew_point_k(air_k: ArrayLike, relative_humidity: ArrayLike) -> Array:
    """Return the dew point of air with a relative humidity (0 to 1), K: `vapour_pressure_pa`
    inverted.
    """
    ratio = np.log(np.asarray(relative_humidity, float) * vapour_pressure_pa(air_k) / 611.2)
    return ZERO_C + 243.12 * ratio / (17.62 - ratio)


@dataclass(frozen=True, kw_only=True)
class Exchange:
    """How surfaces exchange heat and water with the air.

    Parameters
    ----------
    law, constant_w_m2_k
        "buoyant" (natural convection plus a coefficient times wind), "mcadams" (5.7 + 3.8 v),
        "watmuff" (2.8 + 3 v) or "constant", of which this is the coefficient, W m-2 K-1.
    wind_coefficient
        Of the law "buoyant", shape (surface,), W m-2 K-1 / (m/s).
    upward
        Vertical component of the unit normals, shape (surface,).
    condensation
        Whether vapour condenses on surfaces below the dew point.
    """

    law: ConvectionLaw
    constant_w_m2_k: float
    wind_coefficient: Array
    upward: Array
    condensation: bool = True

    def loss(
        self, surface_k: Array, air_k: Array, wind_m_s: Array, vapour_pa: Array, pressure_hpa: Array
    ) -> tuple[Array, Array]:
        """Return the heat flux from surfaces to air, W m-2, and its derivative with their
        temperature, W m-2 K-1.

        Notes
        -----
        Natural convection by TARP (Walton, NBSSIR 83-2655, 1983): on a surface warmer than the air
        and facing up, or colder and facing down, h = 9.482 dT^(1/3)/(7.238 - |cos|), else 1.810
        dT^(1/3)/(1.382 + |cos|). Condensation: (h/gamma) (e_s(T) - e_a) where the surface is below
        the dew point; its water runs off and does not evaporate.
        """
        excess = surface_k - air_k
        if self.law == "buoyant":
            slope_size = np.abs(self.upward)
            unstable = excess * self.upward > 0.0
            natural = np.where(
                unstable, 9.482 / (7.238 - slope_size), 1.810 / (1.382 + slope_size)
            ) * np.cbrt(np.abs(excess))
            forced = self.wind_coefficient * wind_m_s
            h, slope = natural + forced, 4.0 / 3.0 * natural + forced
        else:
            offset, factor = LINEAR_LAWS.get(self.law, (self.constant_w_m2_k, 0.0))
            h = slope = offset + factor * wind_m_s + np.zeros_like(excess)
        flux, saturated = h * excess, vapour_pressure_pa(surface_k)
        wet = (saturated < vapour_pa) & self.condensation
        exchange = np.where(wet, h / (PSYCHROMETRIC_PA_K * pressure_hpa / STANDARD_HPA), 0.0)
        steepness = saturated * 17.62 * 243.12 / (243.12 + surface_k - ZERO_C) ** 2
        return flux + exchange * (saturated - vapour_pa), slope + exchange * steepness


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Cells of slabs, padded to the same number with cells that touch nothing.

    Parameters
    ----------
    capacity
        Heat capacity of each cell, shape (cell, surface), J m-2 K-1.
    conductance
        From the face to the first cell, from each to the next, 0 behind the last, shape (cell + 1,
        surface), W m-2 K-1.
    back
        From cells to what lies behind, 0 but for the last one and for padding, shape (cell,
        surface), W m-2 K-1.
    back_k, max_k
        Temperature behind, NaN: that of the air; and at which the face melts, or infinite, shape
        (surface,), K.
    """

    capacity: Array
    conductance: Array
    back: Array
    back_k: Array
    max_k: Array

    @classmethod
    def of(cls, slabs: Sequence[Slab], cells: int = LIMITS.cells) -> "Columns":
        """Return the cells of slabs with layers, a fixed number for each layer."""
        cells_of_slabs = [_cells(slab, cells) for slab in slabs]
        count = max(len(capacity) for capacity, _ in cells_of_slabs)
        capacity, conductance = np.ones((count, len(slabs))), np.zeros((count + 1, len(slabs)))
        back_conductance = np.ones((count, len(slabs)))
        for number, (slab, (capacities, interfaces)) in enumerate(
            zip(slabs, cells_of_slabs, strict=True)
        ):
            capacity[: len(capacities), number] = capacities
            conductance[: len(capacities), number] = interfaces[:-1]
            behind_w_m2_k = float(slab.back_w_m2_k)
            back_conductance[: len(capacities), number] = 0.0
            back_conductance[len(capacities) - 1, number] = (
                behind_w_m2_k * interfaces[-1] / (behind_w_m2_k + interfaces[-1])
            )
        back_k = np.array(
            [np.nan if slab.back_c is None else float(slab.back_c) + ZERO_C for slab in slabs]
        )
        max_k = np.array(
            [np.inf if slab.max_c is None else float(slab.max_c) + ZERO_C for slab in slabs]
        )
        return cls(
            capacity=capacity,
            conductance=conductance,
            back=back_conductance,
            back_k=back_k,
            max_k=max_k,
        )

    def diagonal(self, rate: Array | float) -> Array:
        """Return the matrix's diagonal for a rate of change (1/s) of each cell's temperature."""
        return self.capacity * rate + self.conductance[:-1] + self.conductance[1:] + self.back


def _cells(slab: Slab, cells: int) -> tuple[Array, Array]:
    """Heat capacities of the cells of a slab, and conductances before, between and behind them."""
    thickness, conductivity, capacity = [], [], []
    for layer in slab.layer:
        growth = LIMITS.ratio ** np.arange(cells)
        thickness.append(float(layer.thickness_mm) * 1e-3 * growth / growth.sum())
        conductivity.append(np.full(cells, float(layer.conductivity_w_m_k)))
        capacity.append(
            thickness[-1] * float(layer.density_kg_m3) * float(layer.specific_heat_j_kg_k)
        )
    half = 0.5 * np.concatenate(thickness) / np.concatenate(conductivity)
    resistance = np.concatenate([half, [0.0]]) + np.concatenate([[0.0], half])
    return np.concatenate(capacity), 1.0 / resistance


@dataclass(frozen=True, kw_only=True)
class Forcing:
    """What acts on surfaces at the end of each step; arrays of shape (step, surface) or (step, 1).

    Parameters
    ----------
    flux_w_m2
        Absorbed sun, sky and neighbours and heat sources, W m-2: all that does not depend on the
        surface's temperature.
    air_k, wind_m_s, vapour_pa, pressure_hpa
        Of the air.
    emissivity
        Shape (surface,).
    exchange
        Convection and condensation.
    """

    flux_w_m2: Array
    air_k: Array
    wind_m_s: Array
    vapour_pa: Array
    pressure_hpa: Array
    emissivity: Array
    exchange: Exchange

    def __len__(self) -> int:
        return len(self.flux_w_m2)

    def part(self, steps: slice) -> "Forcing":
        """Return what acts at some steps."""
        timed = ("flux_w_m2", "air_k", "wind_m_s", "vapour_pa", "pressure_hpa")
        return replace(self, **{name: getattr(self, name)[steps] for name in timed})

    def loss(self, surface_k: Array, steps: int | slice) -> tuple[Array, Array]:
        """Return what the face loses to sky and air at some steps, W m-2, and its derivative, W m-2
        K-1.
        """
        air = (
            self.air_k[steps],
            self.wind_m_s[steps],
            self.vapour_pa[steps],
            self.pressure_hpa[steps],
        )
        flux, slope = self.exchange.loss(surface_k, *air)
        emitted = self.emissivity * STEFAN_BOLTZMANN * surface_k**3
        return flux + emitted * surface_k, slope + 4.0 * emitted

    def convection(self, surface_k: Array, steps: int | slice) -> Array:
        """Return the heat flux of convection, without condensation, from faces at some steps, W
        m-2.
        """
        dry_exchange = replace(self.exchange, condensation=False)
        return dry_exchange.loss(
            surface_k,
            self.air_k[steps],
            self.wind_m_s[steps],
            self.vapour_pa[steps],
            self.pressure_hpa[steps],
        )[0]

    def behind_k(self, columns: Columns, steps: int | slice) -> Array:
        """Return the temperature behind slabs."""
        return np.where(np.isnan(columns.back_k), self.air_k[steps], columns.back_k)


def march(
    columns: Columns, forcing: Forcing, start_k: Array, step_s: float = LIMITS.step_s
) -> tuple[Array, Array]:
    """Return faces at the end of each step, shape (step, surface), and cells at the last, shape
    (cell, surface), K.

    Parameters
    ----------
    columns, forcing, step_s
        Slabs, what acts on them, and the length of a step, s.
    start_k
        Temperature of each cell before the first step, shape (cell, surface), K.

    Raises
    ------
    ArithmeticError
        If the balance of a face does not converge.

    Notes
    -----
    Backward Euler. Crank-Nicolson rings on thin metal: 0.08 K with steps of an hour.
    """
    eliminated = _Elimination.of(columns.conductance, columns.diagonal(1.0 / step_s))
    cells_k, face = start_k, start_k[0]
    faces = np.empty((len(forcing), columns.capacity.shape[1]))
    for step in range(len(forcing)):
        source = columns.capacity / step_s * cells_k + columns.back * forcing.behind_k(
            columns, step
        )
        reduced = eliminated.reduce(source)
        face = _balance_faces(columns, forcing, step, eliminated, reduced[0], face)
        cells_k = eliminated.substitute(reduced, face)
        faces[step] = face
    return faces, cells_k


def _balance_faces(
    columns: Columns,
    forcing: Forcing,
    step: int,
    eliminated: "_Elimination",
    reduced: Array,
    face: Array,
) -> Array:
    """Solve the balance of faces: what they absorb is what they lose and conduct inwards."""
    front, face_pivot = columns.conductance[0], eliminated.pivot[0]
    inward, offset = front * (1.0 - front / face_pivot), front * reduced / face_pivot
    for attempt in range(LIMITS.max_steps):
        loss, slope = forcing.loss(face, step)
        change = (forcing.flux_w_m2[step] + offset - loss - inward * face) / (slope + inward)
        # Where a law has a kink (dew point, air temperature) full steps may go to and fro across
        # it.
        face = np.minimum(face + (change if attempt < 10 else 0.5 * change), columns.max_k)
        if np.abs(np.where(face < columns.max_k, change, 0.0)).max() < LIMITS.converged_k:
            return face
    raise ArithmeticError(f"the balance of a face must converge within {LIMITS.max_steps} steps")


@dataclass(frozen=True)
class _Elimination:
    """Elimination of the inside of slabs from the back to the face; the arrays may have a first
    axis of harmonics.
    """

    coupling: Array
    pivot: Array

    @classmethod
    def of(cls, conductance: Array, diagonal: Array) -> "_Elimination":
        pivot = np.array(diagonal)
        for cell in range(len(pivot) - 2, -1, -1):
            pivot[cell] -= conductance[cell + 1] ** 2 / pivot[cell + 1]
        return cls(conductance[:-1], pivot)

    def reduce(self, source: Any) -> Any:
        """Return sources with those of the cells behind added."""
        reduced = np.array(source, np.result_type(source, self.pivot))
        for cell in range(len(reduced) - 2, -1, -1):
            reduced[cell] += self.coupling[cell + 1] / self.pivot[cell + 1] * reduced[cell + 1]
        return reduced

    def substitute(self, reduced: Any, face: Any) -> Any:
        """Return the temperature of each cell from that of the face."""
        cells_k, previous_k = np.empty_like(reduced), face
        for cell in range(len(reduced)):
            previous_k = cells_k[cell] = (
                reduced[cell] + self.coupling[cell] * previous_k
            ) / self.pivot[cell]
        return cells_k


def periodic_start(
    columns: Columns, forcing: Forcing, step_s: float = LIMITS.step_s
) -> tuple[Array, Array]:
    """Return what a day leads to if it is repeated for ever: faces (step, surface), and cells as
    `march` has them, K.

    Raises
    ------
    ArithmeticError
        If the passes do not converge.

    Notes
    -----
    For each harmonic of the day the slab is a linear admittance, that of the cells and steps of
    `march`. What the face loses is split into a part linear in its temperature, which the harmonics
    solve exactly, and the remainder at each time, which is repeated until it stays. The start is
    thus that of the non-linear slab, without days of spin-up.
    """
    steps, surfaces = len(forcing), columns.capacity.shape[1]
    phase = np.exp(-2j * np.pi * np.arange(steps // 2 + 1) / steps)
    rate = (1.0 - phase)[:, None] / step_s
    # Harmonics stand in the middle: (cell, harmonic, surface).
    diagonal = columns.capacity[:, None] * rate + columns.diagonal(0.0)[:, None]
    eliminated = _Elimination.of(columns.conductance[:, None], diagonal)
    behind_k = np.broadcast_to(forcing.behind_k(columns, slice(None)), (steps, surfaces))
    reduced = eliminated.reduce(columns.back[:, None] * np.fft.rfft(behind_k, axis=0))
    front, face_pivot = columns.conductance[0], eliminated.pivot[0]
    admittance, offset = front * (1.0 - front / face_pivot), front * reduced[0] / face_pivot
    face, melting = np.minimum(forcing.air_k, columns.max_k), np.zeros((steps, surfaces))
    for _ in range(LIMITS.max_passes):
        loss, slope = forcing.loss(face, slice(None))
        linear = 0.5 * (slope.max(axis=0) + slope.min(axis=0))
        remainder = np.fft.rfft(forcing.flux_w_m2 - melting - loss + linear * face, axis=0)
        next_face = np.fft.irfft((remainder + offset) / (linear + admittance), steps, axis=0)
        # Melting takes what would warm the face beyond its limit; the limit is met when it no
        # longer changes.
        melting_flux = np.where(
            columns.max_k < np.inf,
            np.maximum(melting + linear * (next_face - columns.max_k), 0.0),
            0.0,
        )
        next_face = np.minimum(next_face, columns.max_k)
        change = max(
            np.abs(next_face - face).max(), np.abs((melting_flux - melting) / linear).max()
        )
        face, melting = next_face, melting_flux
        if change < LIMITS.periodic_k:
            cells = eliminated.substitute(reduced, np.fft.rfft(face, axis=0))
            weight = np.where(
                (np.arange(len(phase)) == 0) | (2 * np.arange(len(phase)) == steps), 1.0, 2.0
            )
            # The last time of the day comes one step before its first: harmonics turned back by one
            # step.
            at_end = np.einsum("h,chs->cs", weight * phase, cells).real / steps
            return face, at_end
    raise ArithmeticError(f"the periodic state must converge within {LIMITS.max_passes} passes")


def kernels(
    columns: Columns, forcing: Forcing, faces_k: Array, step_s: float = LIMITS.step_s
) -> Array:
    """Return how the last temperature of each face depends on the flux at each time of day, K per W
    m-2.

    Parameters
    ----------
    columns, forcing, faces_k
        Slabs, what acts on them in the last day, and the temperatures of their faces in it, shape
        (step, surface), K.

    Returns
    -------
    Array
        Effect of 1 W m-2 more during a step of this day and of all days before it, shape (step,
        surface).

    Notes
    -----
    The transpose of the linearised `march`, once backwards in time: exact, and as fast as one
    solution. Days before the last one are followed in steps of an hour.
    """
    slope = np.array([forcing.loss(faces_k[step], step)[1] for step in range(len(forcing))])
    slope = np.where(faces_k < columns.max_k, slope, np.inf)
    front = columns.conductance[0]
    effects = np.zeros_like(slope)

    def backwards(source: Array, steps: Sequence[int], length_s: float, last: bool) -> Array:
        """Follow the sources of the transposed problem back through steps, and return those of the
        step before.
        """
        for step in steps:
            face_fraction = front / (slope[step] + front)
            diagonal = columns.diagonal(1.0 / length_s)
            diagonal[0] -= front * face_fraction
            eliminated = _Elimination.of(columns.conductance, diagonal)
            if last:
                source[0] += face_fraction
            # Nothing comes through the face: what it passes on stands in the diagonal.
            sensitivities = eliminated.substitute(
                eliminated.reduce(source), np.zeros(slope.shape[1])
            )
            effect = sensitivities[0] * face_fraction + (
                1.0 / (slope[step] + front) if last else 0.0
            )
            steps_per_length = round(length_s / step_s)
            effects[step - steps_per_length + 1 : step + 1] += effect / steps_per_length
            source, last = columns.capacity / length_s * sensitivities, False
        return source

    source = backwards(np.zeros_like(columns.capacity), range(len(slope) - 1, -1, -1), step_s, True)
    hours = range(len(slope) - 1, -1, -LIMITS.steps_of_hour)
    for _ in range(LIMITS.max_days):
        total = effects.sum(axis=0)
        source = backwards(source, hours, LIMITS.steps_of_hour * step_s, False)
        if (effects.sum(axis=0) - total <= LIMITS.kernel_fraction * total).all():
            break
    return effects
