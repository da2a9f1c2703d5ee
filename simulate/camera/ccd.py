"""CCD as it is read: charge, full well, column blooming, smear, fixed patterns, read noise."""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from labdata import BadInput, Conditions
from simulate.camera import pattern
from simulate.camera.chain import Slot, Stage, values_of
from simulate.camera.grid import CameraFrame
from simulate.camera.stage_image import StageImage

# Dark current is stated at this temperature.
DARK_REFERENCE_C = 25.0


def dark_charge(camera: CameraFrame, conditions: Conditions) -> tuple[float, float]:
    """Return the mean dark charge of a pixel as read, e-, and dark current over that at
    `DARK_REFERENCE_C`.
    """
    ccd = camera.description.ccd
    warmer = (
        0.0 if conditions.temperature_c is None else conditions.temperature_c - DARK_REFERENCE_C
    )
    warmth = float(2.0 ** (warmer / float(ccd.dark_current_doubling_k)))
    # Behind a tube charge gathers whether the gate is open or not.
    gathers_s = camera.frame_s if camera.has_tube else camera.open_s(conditions)
    return float(ccd.dark_current_e_per_s) * warmth * gathers_s, warmth


@dataclass(frozen=True, kw_only=True)
class Ccd(Stage, slot=Slot.CCD, section="ccd", quantity="electrons per pixel"):
    """Interline CCD as it is read, one charge per frame pixel."""

    # electrons per photon on the pixel, fill factor included, dimensionless
    quantum_efficiency: float
    full_well_e: float  # charge that one pixel as read holds, e-
    antibloom_ratio: float = 1.0  # overexposure the drain carries off, in full wells
    # mean dark charge of one pixel as read, e-; the clamp subtracts its mean, its noise stays
    dark_e: float = 0.0
    read_noise_e: float = 0.0  # standard deviation of reading, e-
    prnu: float = 0.0  # relative standard deviation of the pixels' response, dimensionless
    # Charge that a spot one tenth of the image high adds to its whole column, as a fraction of the
    # spot's.
    smear_fraction: float = 0.0
    # Standard deviation over pixels of the level without light, e-. That of the dark charge is its
    # mean at most, as of an exponential law (`pattern.dark_signal_map`); the rest are offsets of
    # amplifiers (`pattern.offset_map`). Of a charge that is multiplied all of it is dark charge:
    # offsets are behind the register.
    dsnu_e: float = 0.0
    # whether the clamp acts here; False where a register follows, behind which it does
    clamped: bool = True
    multiplied: bool = False  # whether a register multiplies the charge
    # whether odd and even rows are separate fields, which overflow each on their own
    interlaced: bool = False
    pattern_seed: int = 0  # seed of the pixels' responses
    # Responses of a camera whose maps are known beyond those of the seed, shape (row, col).
    response_map: NDArray[np.float32] | None = field(default=None, compare=False)
    # What dark charges of pixels have beyond those of the seed, shape (row, col), e-.
    dark_map_e: NDArray[np.float32] | None = field(default=None, compare=False)
    takes: str = "screen photons as read"
    emits: str = "charge"
    effects: ClassVar = {
        "column blooming": {"full_well_e": np.inf},
        "smear": {"smear_fraction": 0.0},
        "DSNU": {"dsnu_e": 0.0},
        "CCD dark current": {"dark_e": 0.0},
        "read noise": {"read_noise_e": 0.0},
        "PRNU": {"prnu": 0.0, "response_map": None},
    }

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        """Return the CCD behind a tube, or that of a camera without one: read and clamped behind
        its register.
        """
        ccd = camera.description.ccd
        dark_e, warmth = dark_charge(camera, conditions)
        values = {
            "dark_e": dark_e,
            "dsnu_e": float(ccd.dsnu_e) * warmth * camera.specimen.drawn_dark,
            "prnu": float(ccd.prnu) * camera.specimen.drawn_light,
            "pattern_seed": camera.pattern_seed,
            "response_map": camera.specimen.charge_factor(camera.description.video),
        }
        if (rate := camera.specimen.dark_rate_dn_per_s) is not None:
            register_gain = conditions.em_gain or float(camera.description.register.em_gain)
            gain = float(camera.description.video.conversion_gain_dn_per_e) * register_gain
            values["dark_map_e"] = rate * np.float32(camera.open_s(conditions) / gain)
        if camera.has_tube:
            return values_of(cls, ccd, interlaced=camera.description.interlaced, **values)
        neighbours = {"takes": "photoelectrons in the wells", "emits": "charge in the wells"}
        return values_of(
            cls,
            ccd,
            quantum_efficiency=1.0,
            read_noise_e=0.0,
            clamped=False,
            multiplied=camera.description.register.multiplies,
            **values,
            **neighbours,
        )

    def __post_init__(self) -> None:
        if not self.full_well_e > 0.0:
            raise BadInput(f"full_well_e must be positive, got {self.full_well_e:g}")

    def mean(self, light: StageImage) -> StageImage:
        """Return the noiseless charge, e-; the full well clips the mean, not single draws."""
        charge = self.mean_charge(light.values)
        if self.dark_map_e is not None or (self.dsnu_e > 0.0 and self.dark_e > 0.0):
            charge = charge + (self.dark(charge.shape[-2:]) - np.float32(self.dark_e))
        charge_e = self.limit_to_full_well(charge) + self.offsets(charge.shape[-2:])
        return light.with_values(charge_e if self.clamped else charge_e + np.float32(self.dark_e))

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return the charge read, e-: Poisson charge of light and dark, then overflow, then read
        noise.
        """
        from simulate.camera.random_numbers import poisson_numbers

        expected = self.mean_charge(light.values)
        expected += self.dark(expected.shape[-2:])
        charge_e = self.limit_to_full_well(
            poisson_numbers(rng.integers(2**64, dtype=np.uint64), expected)
        )
        charge_e = charge_e + self.offsets(expected.shape[-2:])
        if self.read_noise_e > 0.0:
            charge_e = charge_e + np.float32(self.read_noise_e) * rng.standard_normal(
                charge_e.shape, dtype=np.float32
            )
        return light.with_values(charge_e - np.float32(self.dark_e) if self.clamped else charge_e)

    def dark(self, shape: tuple[int, int]) -> NDArray[np.float32] | np.float32:
        """Return the mean dark charge of each pixel, e-; one number where all are alike."""
        charge_e: NDArray[np.float32] | np.float32 = np.float32(self.dark_e)
        if self.dsnu_e > 0.0 and self.dark_e > 0.0:
            charge_e = pattern.dark_signal_map(
                shape, self.dark_e, self.dark_pattern_sd_e, self.pattern_seed
            )
        if self.dark_map_e is not None:
            charge_e = np.maximum(charge_e + self.dark_map_e, np.float32(0.0))
        return charge_e

    @property
    def dark_pattern_sd_e(self) -> float:
        """Standard deviation over pixels of the mean dark charge, e-."""
        return self.dsnu_e if self.multiplied else min(self.dsnu_e, self.dark_e)

    @property
    def offset_sd_e(self) -> float:
        """Standard deviation of the pixels' offsets, e-: the part of DSNU that dark charge does not
        have.
        """
        return (
            float(np.sqrt(self.dsnu_e**2 - self.dark_pattern_sd_e**2)) if self.dark_e > 0.0 else 0.0
        )

    def offsets(self, shape: tuple[int, int]) -> NDArray[np.float32] | np.float32:
        """Return the offset of each pixel, e-; 0 where there are none."""
        return (
            pattern.offset_map(shape, self.offset_sd_e, self.pattern_seed)
            if self.offset_sd_e
            else np.float32(0.0)
        )

    def responses(self, shape: tuple[int, int]) -> NDArray[np.float32] | None:
        """Return the response of each pixel, mean 1; None where all are alike."""
        if self.prnu == 0.0:
            return self.response_map
        drawn = pattern.prnu_map(shape, self.prnu, self.pattern_seed)
        return drawn if self.response_map is None else drawn * self.response_map

    def mean_charge(self, photons: NDArray) -> NDArray[np.float32]:
        """Return the mean charge of the light, e-, with smear; negative values of an image count as
        zero.
        """
        charge = np.maximum(photons, 0.0).astype(np.float32) * np.float32(self.quantum_efficiency)
        if (responses := self.responses(charge.shape[-2:])) is not None:
            charge *= responses
        if self.smear_fraction > 0.0:
            tenth = charge.shape[-2] / 10.0
            charge += np.float32(self.smear_fraction / tenth) * charge.sum(axis=-2, keepdims=True)
        return charge

    def limit_to_full_well(self, charge: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the charge after column blooming, e-, field by field."""
        if not (charge > self.full_well_e).any():
            return charge
        charge_e = np.array(charge, np.float32)
        step = 2 if self.interlaced else 1
        for image in charge_e.reshape(-1, *charge_e.shape[-2:]):
            for parity in range(step):
                field = image[parity::step]
                field[:] = apply_column_blooming(field, self.full_well_e, self.antibloom_ratio)[0]
        return charge_e

    def bounds(self, budget: Any) -> dict[str, float]:
        overflow_e = np.maximum(budget.brightest_e - self.full_well_e, 0.0)
        # The dark pattern changes the mean and the noise; without dark charge there is no pattern
        # of it.
        hottest = budget.hottest_e
        pattern_of_dark = max(
            budget.of_mean(hottest / budget.charge_e),
            budget.of_white(budget.of_chain.white * hottest),
        )
        pixels = 2.0 * float(budget.mean_pe.size)
        mapped = 0.0 if self.response_map is None else float(np.abs(self.response_map - 1.0).max())
        return {
            "column blooming": budget.of_mean(overflow_e / budget.charge_e),
            "smear": budget.of_mean(budget.smear),
            "DSNU": pattern_of_dark,
            "CCD dark current": budget.of_white(budget.of_chain.white * self.dark_e)
            + pattern_of_dark,
            "read noise": budget.of_white(budget.of_chain.white * self.read_noise_e**2),
            "PRNU": (budget.extreme(pixels) * self.prnu + mapped) * budget.of_gain(1.0),
        }


def apply_column_blooming(
    charge_e: NDArray[np.floating], full_well_e: float, antibloom_ratio: float
) -> tuple[NDArray[np.float64], float]:
    """Apply column blooming to the charge of one field, shape (row, col), e-.

    Parameters
    ----------
    charge_e, full_well_e
        Charge of every pixel, and what a pixel holds, e-.
    antibloom_ratio
        Overexposure that the drain of a pixel carries off, in full wells; 1 is no drain.

    Returns
    -------
    charge, drained
        Charge after overflow, shape (row, col), and all charge that left by the drains and the ends
        of the columns, e-. Together they are the charge that came in.

    Notes
    -----
    A pixel takes up to antibloom_ratio full wells: one stays, the rest drains. What is beyond goes
    half to the pixel above and half to the one below until every pixel is satisfied. The order of
    such steps does not matter (Diaconis and Fulton, Rend. Sem. Mat. Torino 49, 95, 1991).
    """
    limit = full_well_e * max(antibloom_ratio, 1.0)
    charge = np.asarray(charge_e, np.float64).copy()
    total = charge.sum()
    for col in np.flatnonzero((charge > limit).any(axis=0)):
        charge[:, col] = spread_excess_charge(charge[:, col], limit)
    charge = np.minimum(charge, full_well_e)
    return charge, float(total - charge.sum())


def spread_excess_charge(column_e: NDArray[np.float64], limit_e: float) -> NDArray[np.float64]:
    """Spread each excess half up and half down until no pixel exceeds the limit; charge leaves only
    at the ends.

    Notes
    -----
    Half up and half down is a walk: what a run of full pixels sheds arrives at its two ends in
    inverse proportion to the distance (gambler's ruin; Feller, An Introduction to Probability
    Theory, 3rd ed., XIV.2). Which pixels end up full follows from one pass along the column with a
    stack, as for a convex hull: a pixel that would then hold too much joins the run on either side
    of it. The ends of the column are pixels that take everything.
    """
    return _solve_column(np.ascontiguousarray(column_e, np.float64), float(limit_e))


@njit(cache=True)
def _solve_column(column, limit):
    count = column.size
    # Pixels that are not full so far, -1 and count the drains at the ends; of the full run below
    # each of them, the excess and its first moment about pixel 0.
    unfilled = np.empty(count + 2, np.int64)
    excess = np.zeros(count + 2)
    moment = np.zeros(count + 2)
    unfilled[0] = -1
    top = 0
    for row in range(count + 1):
        run_excess, run_moment = 0.0, 0.0
        while top > 0:
            current, previous = unfilled[top], unfilled[top - 1]
            from_below = (moment[top] - excess[top] * previous) / (current - previous)
            from_above = (run_excess * row - run_moment) / (row - current)
            pixel_excess = column[current] - limit
            if pixel_excess + from_below + from_above <= 0.0:
                break
            run_excess += excess[top] + pixel_excess
            run_moment += moment[top] + pixel_excess * current
            top -= 1
        top += 1
        unfilled[top], excess[top], moment[top] = row, run_excess, run_moment
    charge = column.copy()
    for index in range(1, top + 1):
        previous, current = unfilled[index - 1], unfilled[index]
        if current - previous == 1:
            continue
        charge[previous + 1 : current] = limit
        upward = (moment[index] - excess[index] * previous) / (current - previous)
        if current < count:
            charge[current] += upward
        if previous >= 0:
            charge[previous] += excess[index] - upward
    return charge
