"""Automatic gain (AGC) and automatic brightness control (ABC): control laws from one state to the
next.

They act at different places. The tube's brightness control lowers the MCP's gain, before the CCD:
fewer electrons per photoelectron, the same photoelectrons, so the shot noise stays while
electronics weigh more. The camera's automatic gain multiplies charge and noise alike, after the
noise. The state, a factor, is carried by the caller.
"""

from dataclasses import dataclass

import numpy as np

from labdata.conditions import Conditions
from labdata.errors import BadInput, check
from simulate.camera import tube_photometry
from simulate.camera.grid import CameraFrame
from simulate.camera.microchannel import MicrochannelPlate

# Set point of automatic gain as a fraction of the range above black: a typical image is darker than
# half white.
SET_LEVEL = 0.4


@dataclass(frozen=True, kw_only=True)
class AutomaticState:
    """State of both controls: factors of MCP gain and video gain, dimensionless, initially 1."""

    brightness: float = 1.0
    gain: float = 1.0


UNTOUCHED = AutomaticState()


@dataclass(frozen=True, kw_only=True)
class AutomaticGain:
    """Automatic gain of the camera, controlled by the mean level above black.

    Notes
    -----
    g <- clip(g [1 + a (set - S)/set], 1, 10^(range/20)), a = 1 - exp(-step/tau).
    """

    set_level_dn: float  # set point of the mean level above black, DN
    range_db: float  # highest over lowest gain, 20 log10; the lowest is 1
    time_constant_s: float  # time in which an error of the level falls to 1/e
    step_s: float  # time from one reading of the meter to the next, s

    def __post_init__(self) -> None:
        check(self, positive="set_level_dn time_constant_s step_s", not_negative="range_db")

    @property
    def highest(self) -> float:
        """Highest gain, dimensionless."""
        return 10.0 ** (self.range_db / 20.0)

    def next(self, state: float, level_dn: float) -> float:
        """Return the gain after a field whose mean level above black, at gain `state`, was
        `level_dn`.
        """
        step = -np.expm1(-self.step_s / self.time_constant_s)
        return float(
            np.clip(state * (1.0 + step * (1.0 - level_dn / self.set_level_dn)), 1.0, self.highest)
        )


@dataclass(frozen=True, kw_only=True)
class BrightnessControl:
    """Automatic brightness control of the tube, controlled by the mean phosphor current.

    Notes
    -----
    g <- min(1, g (limit/J)^a), a = 1 - exp(-step/tau): ln J approaches ln limit with the time
    constant, from any overload. Below the limit the gain is given back as fast.
    """

    limit_e_per_s_cm2: float  # limit of the mean output of the MCP, electrons per s and cm2
    attack_s: float  # time constant, s
    step_s: float  # time from one reading to the next, s

    def __post_init__(self) -> None:
        check(self, positive="limit_e_per_s_cm2 attack_s step_s")

    def next(self, state: float, output_e_per_s_cm2: float) -> float:
        """Return the MCP's gain factor after a field whose mean output, at factor `state`, was
        this.
        """
        if not output_e_per_s_cm2 > 0.0:
            return 1.0
        step = -np.expm1(-self.step_s / self.attack_s)
        return float(min(1.0, state * (self.limit_e_per_s_cm2 / output_e_per_s_cm2) ** step))


@dataclass(frozen=True, kw_only=True)
class AutomaticControls:
    """The controls that were on; None where one was off."""

    gain: AutomaticGain | None = None
    brightness: BrightnessControl | None = None

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> "AutomaticControls":
        """Return the controls of a camera with a tube; the limit of brightness is what its
        illuminance draws.

        Raises
        ------
        BadInput
            If automatic gain was on and this camera has none.
        """
        sensor, video, gain, brightness = camera.description, camera.description.video, None, None
        if conditions.automatic_gain:
            if (
                not video.automatic_gain
                or video.automatic_gain_range_db is None
                or video.automatic_gain_s is None
            ):
                raise BadInput(f"automatic_gain must be off, as {sensor.name!r} has none; got on")
            gain = AutomaticGain(
                set_level_dn=SET_LEVEL * (2**video.bit_depth - 1 - float(video.black_level_dn)),
                range_db=float(video.automatic_gain_range_db),
                time_constant_s=float(video.automatic_gain_s),
                step_s=camera.frame_s,
            )
        if conditions.brightness_control:
            lux = float(sensor.tube.brightness_control_lux)
            per_s_cm2 = lux * 1e-4 * tube_photometry.photoelectrons_per_lumen_s(sensor)
            brightness = BrightnessControl(
                limit_e_per_s_cm2=MicrochannelPlate.of(camera, Conditions()).gain * per_s_cm2,
                attack_s=float(sensor.tube.brightness_control_s),
                step_s=camera.frame_s,
            )
        return cls(gain=gain, brightness=brightness)

    def next(
        self, state: AutomaticState, output_e_per_s_cm2: float, level_dn: float
    ) -> AutomaticState:
        """Return the state after a frame of a mean MCP output and a mean level above black."""
        return AutomaticState(
            brightness=1.0
            if self.brightness is None
            else self.brightness.next(state.brightness, output_e_per_s_cm2),
            gain=1.0 if self.gain is None else self.gain.next(state.gain, level_dn),
        )
