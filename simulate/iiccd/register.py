"""The output of a CCD: a register that may multiply electrons, clock-induced charge, and the amplifier's noise."""

from dataclasses import dataclass

import numpy as np

from labdata.errors import BadInput
from simulate.iiccd.stage_image import StageImage


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
        """Electrons freed on the way through the register, of as many as entered it."""
        from simulate.iiccd import pulse_sampling

        more = self.gain - 1.0
        scale = self.gain**2 * (self.excess_noise_factor - 1.0) / more
        return np.float32(scale) * pulse_sampling.gamma_numbers(rng, charge * np.float32(more / scale))
