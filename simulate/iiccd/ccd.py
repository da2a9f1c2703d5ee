"""CCD and its output register: charge, full well, read noise, electron multiplication."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd import pattern
from simulate.iiccd.stage_image import StageImage


@dataclass(frozen=True, kw_only=True)
class Ccd:
    """Interline CCD as it is read, one charge per frame pixel.

    Parameters
    ----------
    quantum_efficiency
        Electrons per photon on the pixel, fill factor included, dimensionless.
    full_well_e
        Charge that one pixel as read holds, e-.
    antibloom_ratio
        Overexposure the drain carries off, in full wells.
    dark_e
        Mean dark charge of one pixel as read, e-; the clamp subtracts its mean, its noise stays.
    read_noise_e
        Standard deviation of reading, e-.
    prnu
        Relative standard deviation of the pixels' response, dimensionless.
    smear_fraction
        Charge that a spot one tenth of the image high adds to its whole column, as a fraction of the spot's.
    dsnu_e
        Standard deviation over pixels of the mean dark charge, e-; see `pattern.dark_signal`.
    clamped
        Whether the clamp acts here; False where a register follows, behind which it does.
    interlaced
        Whether odd and even rows are separate fields, which overflow each on their own.
    pattern_seed
        Seed of the pixels' responses.
    """

    quantum_efficiency: float
    full_well_e: float
    antibloom_ratio: float = 1.0
    dark_e: float = 0.0
    read_noise_e: float = 0.0
    prnu: float = 0.0
    smear_fraction: float = 0.0
    dsnu_e: float = 0.0
    clamped: bool = True
    interlaced: bool = False
    pattern_seed: int = 0
    name: str = "ccd"
    takes: str = "screen photons as read"
    emits: str = "charge"

    def __post_init__(self) -> None:
        if not self.full_well_e > 0.0:
            raise BadInput(f"full_well_e must be positive, got {self.full_well_e:g}")

    def mean(self, light: StageImage) -> StageImage:
        """Return the noiseless charge, e-; the full well clips the mean, not single draws."""
        charge = self.mean_charge(light.values)
        if self.dsnu_e > 0.0 and self.dark_e > 0.0:
            charge = charge + (self.dark(charge.shape[-2:]) - np.float32(self.dark_e))
        held = self.limit_to_full_well(charge)
        return light.with_values(held if self.clamped else held + np.float32(self.dark_e))

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return the charge read, e-: Poisson charge of light and dark, then overflow, then read noise."""
        from simulate.iiccd import pulse_sampling

        expected = self.mean_charge(light.values)
        expected += self.dark(expected.shape[-2:])
        held = self.limit_to_full_well(pulse_sampling.poisson_charge(rng, expected))
        if self.read_noise_e > 0.0:
            held = held + np.float32(self.read_noise_e) * rng.standard_normal(held.shape, dtype=np.float32)
        return light.with_values(held - np.float32(self.dark_e) if self.clamped else held)

    def dark(self, shape: tuple[int, int]) -> NDArray[np.float32] | np.float32:
        """Return the mean dark charge of each pixel, e-; one number where all are alike."""
        if self.dsnu_e > 0.0 and self.dark_e > 0.0:
            return pattern.dark_signal_map(shape, self.dark_e, self.dsnu_e, self.pattern_seed)
        return np.float32(self.dark_e)

    def mean_charge(self, photons: NDArray) -> NDArray[np.float32]:
        """Return the mean charge of the light, e-, with smear; negative values of an image count as zero."""
        charge = np.maximum(photons, 0.0).astype(np.float32) * np.float32(self.quantum_efficiency)
        if self.prnu > 0.0:
            charge *= pattern.prnu_map(charge.shape[-2:], self.prnu, self.pattern_seed)
        if self.smear_fraction > 0.0:
            tenth = charge.shape[-2] / 10.0
            charge += np.float32(self.smear_fraction / tenth) * charge.sum(axis=-2, keepdims=True)
        return charge

    def limit_to_full_well(self, charge: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the charge after column blooming, e-, field by field."""
        if not (charge > self.full_well_e).any():
            return charge
        from simulate.iiccd.column_blooming import apply_column_blooming

        held = np.array(charge, np.float32)
        step = 2 if self.interlaced else 1
        for image in held.reshape(-1, *held.shape[-2:]):
            for parity in range(step):
                image[parity::step] = apply_column_blooming(
                    image[parity::step], self.full_well_e, self.antibloom_ratio
                )[0]
        return held


@dataclass(frozen=True, kw_only=True)
class Register:
    """Serial register and output amplifier.

    Parameters
    ----------
    gain
        Mean electrons out per electron in; 1 is a plain register, which adds nothing.
    stages
        Stages of the register, in each of which an electron may free another.
    pulse_height_shape
        Shape of the law of what one electron becomes at high gain; 1 is exponential, as impact ionisation is.
    clock_induced_e
        Electrons that clocking sets free, per pixel and frame, before the gain.
    read_noise_e
        Standard deviation of reading, e- behind the gain.
    dark_e
        Mean dark charge in a pixel, e- before the gain, which the clamp subtracts together with that of clocking.

    Notes
    -----
    A register of N stages has the excess noise F^2 = 2 (G - 1) G^(-(N + 1)/N) + 1/G (Robbins and Hadwen, IEEE T-ED 50,
    1227, 2003), 1 without gain and nearly 2 with much. n electrons come out as n plus gamma of mean n (G - 1) and of
    that variance: exact in mean and variance at every gain, and at high gain the gamma law of shape n (Basden, Haniff
    and Mackay, MNRAS 345, 985, 2003).
    """

    gain: float = 1.0
    stages: int = 500
    pulse_height_shape: float = 1.0
    clock_induced_e: float = 0.0
    read_noise_e: float = 0.0
    dark_e: float = 0.0
    name: str = "register"
    takes: str = "charge in the wells"
    emits: str = "charge"

    def __post_init__(self) -> None:
        if not 1.0 <= self.gain < np.inf:
            raise BadInput(f"em_gain must be at least 1 and finite, got {self.gain:g}")
        if self.stages < 1 or not self.pulse_height_shape > 0.0:
            raise BadInput(
                f"a register must have a stage and a positive pulse_height_shape, got {self.stages} and "
                f"{self.pulse_height_shape:g}"
            )
        for name in ("clock_induced_e", "read_noise_e", "dark_e"):
            if not getattr(self, name) >= 0.0:
                raise BadInput(f"{name} must not be negative, got {getattr(self, name):g}")

    @property
    def excess_noise_factor(self) -> float:
        """F^2 of the multiplication, dimensionless."""
        gain = self.gain
        exact = 2.0 * (gain - 1.0) * gain ** (-(self.stages + 1.0) / self.stages) + 1.0 / gain
        return 1.0 + (exact - 1.0) / self.pulse_height_shape

    @property
    def _clamp_level_e(self) -> float:
        return self.gain * (self.dark_e + self.clock_induced_e)

    def mean(self, light: StageImage) -> StageImage:
        """Return electrons at the output above the clamped level."""
        charge = self.gain * (light.values + np.float32(self.clock_induced_e))
        return light.with_values((charge - np.float32(self._clamp_level_e)).astype(np.float32))

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return electrons at the output above the clamped level, of whole electrons in the wells."""
        charge = np.array(light.values, np.float32)
        if self.clock_induced_e > 0.0:
            charge += rng.poisson(self.clock_induced_e, size=charge.shape).astype(np.float32)
        if self.gain > 1.0:
            charge += self._draw_multiplication(charge, rng)
        if self.read_noise_e > 0.0:
            charge += np.float32(self.read_noise_e) * rng.standard_normal(charge.shape, dtype=np.float32)
        return light.with_values(charge - np.float32(self._clamp_level_e))

    def _draw_multiplication(self, charge, rng: np.random.Generator):
        """Electrons that the register adds to those that enter it."""
        from simulate.iiccd import pulse_sampling

        more = self.gain - 1.0
        scale = self.gain**2 * (self.excess_noise_factor - 1.0) / more
        return np.float32(scale) * pulse_sampling.gamma_numbers(rng, charge * np.float32(more / scale))
