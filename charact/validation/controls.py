"""Controls of the validation: one camera parameter changed a stage, and further draws."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from charact.estimators.noise.findings import Cause
from charact.frames.image_lag import SLOWEST_DECAY
from charact.observables import Numbers
from charact.validation.frames import Camera
from charact.validation.likely_causes import Alternative
from charact.validation.statistic import Statistic
from charact.validation.thresholds import VALIDATION
from charact.validation.validation_result import DetectableError, ValidationControl
from charact.validation.validation_test import ParameterChange, ValidationTest
from labdata import BadInput

DESCRIBED = Cause(
    stage="the camera as described or fitted", remedy="a fit to frames that show the parameter"
)


@dataclass(frozen=True, kw_only=True)
class ParameterControl:
    """A parameter whose change must be noticed.

    `title` says what, `parameters` are its paths, of which the first counts that exists;
    `power`: that which the numbers follow: 0, the logarithm, of a gain; 2 of the standard deviation
    of a noise; `quick`: whether a quick validation changes it too.
    """

    title: str
    parameters: tuple[str, ...]
    power: int = 1
    quick: bool = False

    @property
    def change(self) -> float:
        """Relative change by which the numbers are differentiated.

        A gain becomes smaller: no frame leaves the range of digitiser and full well, whose end
        would hide the effect or pass for one.
        """
        return VALIDATION.control_change if self.power else -VALIDATION.control_change

    def path_in(self, camera: Camera) -> str | None:
        """Return the path of the parameter of a camera; None where it has none, or it is 0."""
        known = camera.parameters()
        paths = (path for path in self.parameters if path in known and float(known[path]) != 0.0)
        return next(paths, None)

    def least_error(self, camera: Camera) -> float:
        """Return the least relative error that a camera's posterior draws leave to be found.

        The simulated sets differ by as much as the draws do. An error of a fraction of the
        posterior's width shows only where the other parameters, which vary with this one, are
        known.
        """
        path, draws = self.path_in(camera), camera.draws
        if path not in draws.names:
            return 0.0
        values = np.array([row[draws.names.index(path)] for row in draws.values])
        return float(VALIDATION.least_of_posterior * values.std() / np.abs(values.mean()))


PARAMETERS = (
    ParameterControl(
        title="sensitivity",
        parameters=("photocathode.luminous_sensitivity_ua_per_lm", "ccd.quantum_efficiency"),
        power=0,
    ),
    ParameterControl(
        title="gain",
        parameters=("tube.luminous_gain", "video.conversion_gain_dn_per_e"),
        power=0,
        quick=True,
    ),
    ParameterControl(
        title="detection probability, as 1/F²",
        parameters=("microchannel_plate.detection_probability",),
        power=0,
    ),
    ParameterControl(title="blur after the gain", parameters=("tube.post_gain_share",)),
    ParameterControl(
        title="frequency of the tube's MTF, or blur of the lens",
        parameters=("tube.mtf_frequency_lp_per_mm", "optics.aberration_blur_um"),
        quick=True,
    ),
    ParameterControl(title="video bandwidth", parameters=("video.bandwidth_mhz",)),
    ParameterControl(title="slow decay of the phosphor", parameters=SLOWEST_DECAY),
    ParameterControl(title="read noise", parameters=("ccd.read_noise_e",), power=2, quick=True),
    ParameterControl(title="noise of rows", parameters=("video.line_noise_dn",), power=2),
    ParameterControl(
        title="dark events: EBI or dark current",
        parameters=("photocathode.ebi_lm_per_cm2", "ccd.dark_current_e_per_s"),
    ),
    ParameterControl(title="PRNU", parameters=("ccd.prnu",), power=2),
)


def change_parameter(
    camera: Camera, control: ParameterControl, change: float
) -> tuple[Camera, float] | None:
    """Return a camera with one parameter larger by a relative change, and the change; None without
    the parameter.

    A fraction that would exceed 1 is made smaller by as much.
    """
    path = control.path_in(camera)
    if path is None:
        return None
    value = float(camera.parameters()[path])
    if path.endswith(("share", "probability")) and value * (1.0 + change) > 1.0:
        change = -change
    return camera.with_values({path: value * (1.0 + change)}), change


def detectable_error(
    test: ValidationTest, change: ParameterChange, change_by: Callable[[float], ParameterChange]
) -> DetectableError:
    """Return the error of a parameter that is found, by numbers of about that error.

    `change_by` returns the change of the numbers of another set by a relative change of the
    parameter: estimates of parameters follow the random numbers of the set whose change gave them
    their weights, by a third for a dark current behind a tube. A first estimate is linear over
    `control_change`, of which errors of blur may be three times as large; a smaller change would
    show the noise of the frames.
    """
    error = test.detectable(change).relative_error
    if np.isnan(error):
        error = 1.0
    nearer = float(np.clip(error, VALIDATION.control_change, 1.0 - VALIDATION.least_change))
    return test.detectable(change_by(float(np.copysign(nearer, change.change))))


def alternative_of(
    control: ParameterControl,
    change: ParameterChange,
    change_by: Callable[[float], ParameterChange],
) -> Alternative:
    """Return the likely cause that a parameter is in error."""

    def numbers_at(size: float) -> Mapping[str, Numbers]:
        try:
            return change.changed if size == change.change else change_by(size).changed
        except BadInput:
            return {}  # No camera has this value.

    return Alternative(
        name=f"error of {control.title}",
        cause=DESCRIBED,
        flag="model-misfit",
        stacks="all stacks",
        numbers_at=numbers_at,
        size=change.change,
        power=max(1, control.power),
        two_sided=True,
        least_size=VALIDATION.least_change - 1.0,
        scale=100.0,
        unit="%",
    )


def null_control(title: str, of_next_set: Callable[[], tuple[Statistic, ...]]) -> ValidationControl:
    """Return the control that frames of the fitted camera itself pass, with the statistics of the
    last set.

    Notes
    -----
    A right camera fails now and then, and a set of its posterior may be an extreme one. So sets
    are compared until the share that fails is that of sound or of useless statistics, by the
    likelihood ratio of both (sequential test; Wald 1945): mostly one set decides.
    """
    ratio = 1.0
    while True:
        control = ValidationControl(name="null", title=title, statistics=of_next_set())
        shares = VALIDATION.useless_share, VALIDATION.sound_share
        useless, sound = (1.0 - share if control.passed else share for share in shares)
        ratio *= useless / sound
        if not 1.0 <= ratio < VALIDATION.useless_ratio:
            return control
