"""Output register: electron multiplication, clock-induced charge and read noise."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from labdata.conditions import Conditions
from labdata.errors import BadInput, check
from simulate.camera.ccd import dark_charge
from simulate.camera.chain import Slot, Stage, values_of
from simulate.camera.grid import CameraFrame
from simulate.camera.readout_noise import draw_read_noise
from simulate.camera.stage_image import StageImage


@dataclass(frozen=True, kw_only=True)
class Register(
    Stage,
    slot=Slot.REGISTER,
    section="register",
    quantity="electrons per pixel behind the register",
    takes="charge in the wells",
    emits="charge",
):
    """Serial register and output amplifier.

    Notes
    -----
    A register of N stages has the excess noise F^2 = 2 (G - 1) G^(-(N + 1)/N) + 1/G (Robbins and
    Hadwen, IEEE T-ED 50, 1227, 2003), 1 without gain and nearly 2 with much. n electrons come out
    as n plus gamma of mean n (G - 1) and of that variance: exact in mean and variance at every
    gain, and at high gain the gamma law of shape n (Basden, Haniff and Mackay, MNRAS 345, 985,
    2003).
    """

    # mean electrons out per electron in; 1 is a plain register, which adds nothing
    gain: float = 1.0
    stages: int = 500  # stages of the register, in each of which an electron may free another
    # Shape of the law of what one electron becomes at high gain; 1 is exponential, as impact
    # ionisation is.
    pulse_height_shape: float = 1.0
    # electrons that clocking sets free, per pixel and frame, before the gain
    clock_induced_e: float = 0.0
    read_noise_e: float = 0.0  # standard deviation of reading, e- behind the gain
    # Mean dark charge in a pixel, e- before the gain, which the clamp subtracts together with that
    # of clocking.
    dark_e: float = 0.0
    # Density of read noise along a row at 0.5 cy/px over that at 0, see
    # `readout_noise.draw_read_noise`.
    fine_noise_ratio: float = 1.0

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        """Return the register at the gain of the conditions, by default its highest; tube gain is
        refused.
        """
        if conditions.mcp_v is not None or conditions.gain_control is not None:
            raise BadInput(
                f"mcp_v and gain_control must be left out of a camera without a tube, "
                f"got {conditions.mcp_v} and {conditions.gain_control}"
            )
        register = camera.description.register
        highest = float(register.em_gain)
        gain = highest if conditions.em_gain is None else conditions.em_gain
        if not 1.0 <= gain <= highest:
            raise BadInput(f"em_gain must lie between 1 and the camera's {highest:g}, got {gain:g}")
        read_noise_e = float(camera.description.ccd.read_noise_e)
        dark_e, _ = dark_charge(camera, conditions)
        ratio = float(camera.description.readout.fine_noise_ratio)
        return values_of(
            cls,
            register,
            gain=gain,
            read_noise_e=read_noise_e,
            dark_e=dark_e,
            fine_noise_ratio=ratio,
        )

    def __post_init__(self) -> None:
        if not 1.0 <= self.gain < np.inf:
            raise BadInput(f"em_gain must be at least 1 and finite, got {self.gain:g}")
        check(
            self,
            one_or_more="stages",
            positive="pulse_height_shape fine_noise_ratio",
            not_negative="clock_induced_e read_noise_e dark_e",
        )

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
        """Return electrons at the output above the clamped level, of whole electrons in the
        wells.
        """
        charge = np.array(light.values, np.float32)
        if self.clock_induced_e > 0.0:
            charge += rng.poisson(self.clock_induced_e, size=charge.shape).astype(np.float32)
        if self.gain > 1.0:
            # Electrons that the register adds to those that enter it.
            excess_gain = self.gain - 1.0
            scale = self.gain**2 * (self.excess_noise_factor - 1.0) / excess_gain
            charge += np.float32(scale) * rng.standard_gamma(
                charge * np.float32(excess_gain / scale), dtype=np.float32
            )
        if self.read_noise_e > 0.0:
            charge += np.float32(self.read_noise_e) * draw_read_noise(
                rng, charge.shape, self.fine_noise_ratio
            )
        return light.with_values(charge - np.float32(self._clamp_level_e))
