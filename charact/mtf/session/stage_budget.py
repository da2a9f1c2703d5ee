"""Stage budget: which stage of the camera costs how much of the MTF, from curves along rows and columns together.

Lens, tube and taper blur alike in all directions in millimetres; the pixel is 11 by 26 um of summed rows and the video
blurs along rows only. Curves in both directions, and the one after the gain, weigh the stages against each other. What
they cannot tell apart is said: a stage known no better than before, and groups of which only the product is known.
"""

from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from charact.mtf.forms import transfer as forms
from charact.posterior import laplace, maximum, sample
from labdata.errors import BadInput
from labdata.measurement import Posterior
from labdata.parameter import Parameter
from labdata.sensor import Sensor

Array = NDArray[np.float64]
Direction = Literal["horizontal", "vertical"]

STAGES = ("lens", "tube before the gain", "tube after the gain", "taper", "pixel", "video")
AFTER_GAIN = STAGES[2:]
# Parameters of the description, their bounds, and the stage that each belongs to.
PARAMETERS: dict[str, tuple[str, tuple[float, float]]] = {
    "optics.aberration_blur_um": ("um", (0.0, 40.0)),
    "tube.mtf_frequency_lp_per_mm": ("lp/mm", (5.0, 120.0)),
    "tube.mtf_exponent": ("1", (0.7, 2.5)),
    "tube.post_gain_share": ("1", (0.0, 1.0)),
    "taper.interface_mtf_lp_per_mm": ("lp/mm", (20.0, 400.0)),
    "video.bandwidth_mhz": ("MHz", (2.0, 20.0)),
}
# A stage is identified where the curves leave less than this part of its prior's standard deviation; only a product is
# where its own is less than this part of what its members' would make.
IDENTIFIED = 0.6
PRODUCT = 0.4
# Share of a parameter's value taken as prior standard deviation where the description states no range.
UNSTATED = 0.3
PRIOR_DRAWS = 2000
# Light of the middle of the cathode's band.
MIDDLE_WAVELENGTH_MM = 0.7e-3


@dataclass(frozen=True, kw_only=True)
class MeasuredCurve:
    """A measured MTF along one direction.

    Parameters
    ----------
    direction
        "horizontal" (along rows) or "vertical".
    after_gain
        Whether it holds what comes after the gain only, as that of the noise of flats.
    frequency_cy_per_px
        Frequencies, cycles per column pitch or, vertically, per row pitch, shape (f,).
    value
        MTF, shape (f,).
    covariance
        Its covariance, shape (f, f).
    """

    direction: Direction
    after_gain: bool = False
    frequency_cy_per_px: Array
    value: Array
    covariance: Array

    def __post_init__(self) -> None:
        size = len(self.frequency_cy_per_px)
        if self.direction not in ("horizontal", "vertical"):
            raise BadInput(f"a direction must be horizontal or vertical, got {self.direction!r}")
        if np.shape(self.value) != (size,) or np.shape(self.covariance) != (size, size):
            raise BadInput(f"a curve of {size} frequencies must have as many values and a covariance of that size")

    @classmethod
    def of_draws(
        cls, direction: Direction, frequency_cy_per_px: Array, draws: Array, *, after_gain: bool = False
    ) -> "MeasuredCurve":
        """Return the curve of posterior draws, shape (draw, frequency)."""
        return cls(
            direction=direction, after_gain=after_gain, frequency_cy_per_px=np.asarray(frequency_cy_per_px, float),
            value=np.mean(draws, axis=0), covariance=np.atleast_2d(np.cov(draws.T)),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class StageBudget:
    """What the curves say of the stages.

    Parameters
    ----------
    posterior
        Draws of the parameters.
    identified
        Stages that the curves tell beyond what the description said.
    products
        Groups of the others of which only the product is told.
    known
        Stages that have nothing to fit: the pixel, and a video that a digital camera has not.
    statement
        The same in sentences.
    chance
        Probability of residuals as large, were the model right.
    """

    posterior: Posterior
    identified: tuple[str, ...]
    products: tuple[tuple[str, ...], ...]
    known: tuple[str, ...]
    statement: tuple[str, ...]
    chance: float
    camera: "_Camera" = field(repr=False)

    def mtf(self, stage: str, frequency_cy_per_px: Array, direction: Direction) -> Array:
        """Return draws of one stage's MTF, shape (draw, frequency), frequencies per pitch of the direction."""
        if stage not in STAGES:
            raise BadInput(f"a stage must be one of {', '.join(STAGES)}, got {stage!r}")
        logs = self.camera.log_stages(self.posterior.draws, np.asarray(frequency_cy_per_px, float), direction)
        return np.exp(logs[STAGES.index(stage)])


@dataclass(frozen=True, kw_only=True)
class _Camera:
    """Geometry of the camera and the parameters that are fitted, with their priors."""

    sensor: Sensor
    rows_summed: float
    names: tuple[str, ...]
    mean: Array
    sd: Array

    def log_stages(self, theta: Array, frequency: Array, direction: Direction) -> Array:
        """Return ln of the MTF of each stage, shape (stage, n, frequency)."""
        ccd, taper = self.sensor.ccd, self.sensor.taper
        get = {name: theta[:, i, None] for i, name in enumerate(self.names)}
        along = direction == "horizontal"
        detector = frequency / float(ccd.pitch_x_um if along else ccd.pitch_y_um) * 1e3
        cathode = detector / float(taper.demagnification)
        blur_um, cut_off = get["optics.aberration_blur_um"], get["tube.mtf_frequency_lp_per_mm"]
        tube = -np.exp(get["tube.mtf_exponent"] * np.log(np.maximum(cathode, 1e-9) / cut_off))
        share = get["tube.post_gain_share"]
        interface = get["taper.interface_mtf_lp_per_mm"]
        fibres = forms.disc(detector, float(taper.fibre_pitch_um) * 1e-3)
        pixel = np.abs(np.sinc(frequency * (1.0 if along else self.rows_summed)))
        none = np.zeros((len(theta), len(frequency)))
        return np.stack(
            [
                np.log(self._diffraction(cathode)) - 2.0 * (np.pi * cathode * blur_um * 1e-3) ** 2,
                (1.0 - share) * tube,
                share * tube,
                np.log(np.maximum(np.abs(fibres), 1e-12)) - (detector / interface) ** 2,
                none + np.log(np.maximum(pixel, 1e-12)),
                self._video(get, frequency) if along else none,
            ]
        )

    def _diffraction(self, cathode: Array) -> Array:
        """MTF of a round pupil at frequencies at the cathode, lp/mm."""
        x = np.minimum(cathode * MIDDLE_WAVELENGTH_MM * float(self.sensor.optics.f_number), 0.999)
        return 2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x**2))

    def _video(self, get: dict[str, Array], frequency: Array) -> Array:
        """ln of a Butterworth low pass in the pixel clock's terms: 1/sqrt(1 + (f/f0)^(2n))."""
        if "video.bandwidth_mhz" not in get:
            return np.zeros((len(get["tube.mtf_exponent"]), len(frequency)))
        video = self.sensor.video
        assert video.pixel_clock_mhz is not None and video.filter_order is not None
        ratio = frequency * float(video.pixel_clock_mhz) / get["video.bandwidth_mhz"]
        return -0.5 * np.log1p(ratio ** (2 * video.filter_order))

    def predicted(self, theta: Array, curve: MeasuredCurve) -> Array:
        """Return the MTF of a curve, shape (n, frequency)."""
        logs = self.log_stages(theta, np.asarray(curve.frequency_cy_per_px, float), curve.direction)
        return np.exp(np.sum(logs[2:] if curve.after_gain else logs, axis=0))


def stage_budget(
    curves: tuple[MeasuredCurve, ...], sensor: Sensor, *, interlaced: bool, seed: int, quick: bool = False
) -> StageBudget:
    """Fit the stages of a camera to its measured curves.

    Parameters
    ----------
    curves
        Curves of the whole camera, best along rows and columns, and those after the gain.
    sensor
        Description: pitches and pixel, and ranges of the stages as priors.
    interlaced
        Whether a row of a frame sums two rows of the chip.
    seed, quick
        Seed of the draws; without a Markov chain.

    Raises
    ------
    BadInput
        If there is no curve.

    Notes
    -----
    At the cathode: lens exp(-2 (pi f s)^2) times diffraction, tube exp(-(f/fc)^n), of whose exponent a share acts after
    the gain. At the detector: fibres 2 J1(pi p f)/(pi p f) and their interfaces exp(-(f/f0)^2), pixel sinc and video
    1/sqrt(1 + (f/f0)^2n). A curve after the gain lacks the lens and the tube's share before it.
    """
    if not curves:
        raise BadInput("a stage budget must have at least one measured curve, got none")
    camera = _camera(sensor, interlaced)
    whitened = [(curve, _whitener(curve.covariance)) for curve in curves]
    bounds = np.array([PARAMETERS[name][1] for name in camera.names])

    def chi2(theta: Array) -> Array:
        off = [(camera.predicted(theta, curve) - curve.value) @ root for curve, root in whitened]
        return np.sum([np.sum(each**2, axis=1) for each in off], axis=0)

    def log_probability(theta: Array) -> Array:
        inside = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], theta, camera.mean)
        prior = np.sum(((safe - camera.mean) / camera.sd) ** 2, axis=1)
        return np.where(inside, -0.5 * (chi2(safe) + prior), -np.inf)

    point, covariance = maximum(log_probability, camera.mean, bounds)
    posterior = (laplace if quick else sample)(
        log_probability, names=camera.names, units=tuple(PARAMETERS[name][0] for name in camera.names),
        start=point, covariance=covariance, seed=seed, bounds=bounds,
    )  # fmt: skip
    from scipy.stats import chi2 as chi_squared

    rank = sum(root.shape[1] for _, root in whitened)
    chance = float(chi_squared.sf(float(chi2(point[None])[0]), rank))
    prior = np.random.default_rng([seed, 1]).normal(camera.mean, camera.sd, (PRIOR_DRAWS, len(camera.mean)))
    prior = np.clip(prior, bounds[:, 0] + 1e-6, bounds[:, 1])
    identified, products, known = _told(camera, posterior.draws, prior, curves)
    return StageBudget(
        posterior=posterior, identified=identified, products=products, known=known, chance=chance, camera=camera,
        statement=_sentences(identified, products, known, chance),
    )  # fmt: skip


def _camera(sensor: Sensor, interlaced: bool) -> _Camera:
    known = {**{path: parameter for path, parameter in sensor.parameters().items() if path in PARAMETERS}}
    names = tuple(name for name in PARAMETERS if name in known)
    return _Camera(
        sensor=sensor,
        rows_summed=2.0 if interlaced else 1.0,
        names=names,
        mean=np.array([float(known[name]) for name in names]),
        sd=np.array([_spread(known[name]) for name in names]),
    )


def _spread(parameter: Parameter) -> float:
    """Prior standard deviation: a quarter of the 95 % range."""
    if parameter.low is None or parameter.high is None or parameter.high == parameter.low:
        return UNSTATED * max(abs(float(parameter)), 1e-3)
    return (parameter.high - parameter.low) / 3.92


def _whitener(covariance: Array) -> Array:
    """Return the matrix that makes a curve's errors white, along directions that they fill."""
    value, vector = np.linalg.eigh(np.asarray(covariance, float))
    # A curve of a few parameters has errors in as few directions; the others say nothing but the form it was given.
    kept = value > 1e-6 * value.max()
    return vector[:, kept] / np.sqrt(value[kept])


def _told(
    camera: _Camera, draws: Array, prior: Array, curves: tuple[MeasuredCurve, ...]
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...], tuple[str, ...]]:
    """Return the stages identified, the groups told as products, and those with nothing to fit."""
    here, before = (_at_half(camera, theta, curves) for theta in (draws, prior))
    sd, prior_sd = here.std(axis=1), before.std(axis=1)
    known = [i for i in range(len(STAGES)) if prior_sd[i] < 1e-9]
    alone = [i for i in range(len(STAGES)) if i not in known and sd[i] < IDENTIFIED * prior_sd[i]]
    left = [i for i in range(len(STAGES)) if i not in known and i not in alone]
    products = []
    for size in range(2, len(left) + 1):
        for group in combinations(left, size):
            members = list(group)
            if any(set(found) & set(members) for found in products):
                continue
            together = here[members].sum(axis=0).std()
            if together < PRODUCT * np.sqrt(np.sum(sd[members] ** 2)):
                products.append(members)
    return (
        tuple(STAGES[i] for i in alone),
        tuple(tuple(STAGES[i] for i in group) for group in products),
        tuple(STAGES[i] for i in known),
    )


def _at_half(camera: _Camera, theta: Array, curves: tuple[MeasuredCurve, ...]) -> Array:
    """Return ln of the MTF of each stage along rows, where the sharpest measured curve is one half, (stage, draw)."""
    across = [curve for curve in curves if curve.direction == "horizontal"] or list(curves)
    half = max(float(np.interp(0.5, curve.value[::-1], curve.frequency_cy_per_px[::-1])) for curve in across)
    return camera.log_stages(theta, np.array([half]), across[0].direction)[:, :, 0]


def _sentences(
    identified: tuple[str, ...], products: tuple[tuple[str, ...], ...], known: tuple[str, ...], chance: float
) -> tuple[str, ...]:
    grouped = {stage for group in products for stage in group}
    rest = [stage for stage in STAGES if stage not in (*identified, *known, *grouped)]
    out = [f"identified by the curves: {', '.join(identified) or 'none'}"]
    out += [f"only the product of {' and '.join(group)} is identified" for group in products]
    if rest:
        out.append(f"no better known than from the description: {', '.join(rest)}")
    if known:
        out.append(f"taken as known: {', '.join(known)}")
    if chance < 0.01:
        out.append(f"the stages do not describe the curves (chance {chance:.2g})")
    return tuple(out)
