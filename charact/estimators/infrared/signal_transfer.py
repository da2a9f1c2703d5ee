"""Signal transfer of an infrared camera: mean DN against black-body temperature (SiTF).

The camera's signal is taken as linear in band radiance, mean = a + s x with

    x = (L(T) - L(T0)) / L'(T0),

so that the slope s is in DN/K at T0, and s L'(T)/L'(T0) at another temperature T. Where the band is
unknown, bands and wavelengths of both atmospheric windows and a signal linear in temperature are
candidates, weighted by their evidence: levels far apart select one, levels close together leave the
bend of L(T) in the interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.estimators.infrared.thresholds import INFRARED
from charact.estimators.noise.linear_fit import linear_fit
from labdata import Array
from labdata.errors import BadInput

ZERO_C = 273.15
# Radiation constants, CODATA 2018: 2 h c^2 in W um^4 m-2 sr-1, and h c / k in um K.
C1, C2 = 1.191042972e8, 1.438776877e4
# Candidates of an unknown band, um: common bands, and wavelengths of both windows of the
# atmosphere.
BANDS_UM = ((3.0, 5.0), (3.4, 4.9), (8.0, 12.0), (8.0, 14.0), (7.5, 13.5))
WAVELENGTHS_UM = (3.2, 3.6, 4.0, 4.4, 4.8, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclass(frozen=True, kw_only=True)
class Response:
    """Signal per temperature of a camera: to radiance or photons of a band, or linear in
    temperature.

    Examples
    --------
    >>> eight_to_twelve = Response(low_um=8.0, high_um=12.0)
    >>> radiance, slope = eight_to_twelve.radiance(300.0), eight_to_twelve.derivative(300.0)
    >>> round(float(radiance), 3), round(float(slope), 4)
    (38.5, 0.6297)
    """

    low_um: float  # limits of the band, um; both 0: linear in temperature
    high_um: float
    # whether photons count, not energy; then the unit of radiance is 1/um of that of energy
    photons: bool = False

    @property
    def name(self) -> str:
        """The response in words."""
        if not self.high_um:
            return "linear in temperature"
        if self.low_um == self.high_um:
            return f"{self.low_um:.3g} µm"
        return f"{self.low_um:g}-{self.high_um:g} µm{', photons' if self.photons else ''}"

    def radiance(self, temperature_k: float | Array) -> Array:
        """Return the band radiance, W m-2 sr-1 (of a single wavelength W m-2 sr-1 um-1)."""
        return self._integral(temperature_k, derivative=False)

    def derivative(self, temperature_k: float | Array) -> Array:
        """Return dL/dT, W m-2 sr-1 K-1 (of a single wavelength per um)."""
        return self._integral(temperature_k, derivative=True)

    def _integral(self, temperature_k: float | Array, *, derivative: bool) -> Array:
        """Integrate Planck's law, or its derivative, over the band by Gauss-Legendre quadrature."""
        kelvin = np.asarray(temperature_k, np.float64)[..., None]
        if not self.high_um:
            return np.ones_like(kelvin[..., 0]) if derivative else kelvin[..., 0]
        half = 0.5 * (self.high_um - self.low_um)
        nodes, weights = (NODES, half * WEIGHTS) if half else (np.zeros(1), np.ones(1))
        wavelength = 0.5 * (self.low_um + self.high_um) + half * nodes
        exponent = C2 / (wavelength * kelvin)
        density = C1 / wavelength**5 / np.expm1(exponent)
        if derivative:
            density = density * exponent / (-np.expm1(-exponent)) / kelvin
        return (density * (wavelength if self.photons else 1.0)) @ weights


def responses(band_um: tuple[float, float] | None) -> tuple[Response, ...]:
    """Return the candidate responses of a camera: of its band, else of both windows and linear in
    temperature.
    """
    if band_um is not None:
        return tuple(
            Response(low_um=band_um[0], high_um=band_um[1], photons=photons)
            for photons in (False, True)
        )
    limits = (*BANDS_UM, *((um, um) for um in WAVELENGTHS_UM), (0.0, 0.0))
    return tuple(Response(low_um=low, high_um=high) for low, high in limits)


@dataclass(frozen=True, kw_only=True)
class SignalTransfer:
    """Posterior draws of the slope of mean DN against black-body temperature.

    Of each draw: its response, the slope at `reference_k`, and the background temperature.
    """

    responses: tuple[Response, ...]
    probability: Array  # of each response, shape (response,)
    choice: NDArray[np.intp]  # response of each draw, shape (draw,)
    slope_dn_per_k: Array  # slope at the reference, shape (draw,), DN/K
    reference_k: float
    background_k: Array  # background temperature, shape (draw,), K
    law: Array  # mean at the reference, DN, and slope there, DN/K, of the most probable law
    residual_dn: Array  # mean less that law, shape (level,), DN
    chi2: float  # of the most probable law, for the stated errors
    parabola_chi2: float  # of that law with a quadratic term; infinite for fewer than four levels
    # change of the slope at the background by that term, fraction of the slope
    parabola_slope: float

    def slope_at(self, temperature_k: float | Array) -> Array:
        """Return the slope at a temperature, or at one of each draw, shape (draw,), DN/K."""
        kelvin = np.broadcast_to(np.asarray(temperature_k, np.float64), self.choice.shape)
        ratio = np.empty(len(kelvin))
        for number, response in enumerate(self.responses):
            is_response = self.choice == number
            ratio[is_response] = response.derivative(kelvin[is_response]) / response.derivative(
                self.reference_k
            )
        return self.slope_dn_per_k * ratio

    def law_dn(self, temperature_k: Array) -> Array:
        """Return the mean by the most probable law, DN."""
        return self.law[0] + self.law[1] * _place(self.likeliest, temperature_k, self.reference_k)

    @cached_property
    def sitf(self) -> Array:
        """Draws of the slope at the background temperature, shape (draw,), DN/K."""
        return self.slope_at(self.background_k)

    @property
    def likeliest(self) -> Response:
        """The most probable response."""
        return self.responses[int(np.argmax(self.probability))]


def fit_signal_transfer(
    temperature_k: Array,
    mean_dn: Array,
    sd_dn: Array,
    *,
    background_k: float | None,
    band_um: tuple[float, float] | None,
    rng: np.random.Generator,
) -> SignalTransfer:
    """Fit mean DN against black-body temperature.

    Parameters
    ----------
    temperature_k, mean_dn, sd_dn
        Levels of at least two temperatures: black body, K, mean of all pixels and frames and its
        standard error by noise and drift, DN, shape (level,) each. The error of the black body is
        added.
    background_k
        Background temperature, K; None: anywhere between the levels, with equal probability.
    band_um
        Band of the camera, um; None: unknown.
    rng
        Generator of the draws.

    Raises
    ------
    BadInput
        If there are fewer than two temperatures.

    Notes
    -----
    Each response gives a weighted line. The scatter of the levels about it, relative to the stated
    errors, has an inverse chi-squared prior of mean about 1 and `scatter_freedom` degrees of
    freedom; slopes are then Student's t, and a response has the evidence (nu + chi2)^(-(nu + n -
    2)/2) sqrt(det covariance) (Gelman et al., Bayesian Data Analysis, 3rd ed., 14.2).

    Examples
    --------
    >>> kelvin = 295.0 + np.arange(5.0)
    >>> done = fit_signal_transfer(
    ...     kelvin,
    ...     100.0 + 20.0 * (kelvin - 297.0),
    ...     np.full(5, 0.01),
    ...     background_k=297.0,
    ...     band_um=None,
    ...     rng=np.random.default_rng(1),
    ... )
    >>> bool(abs(np.median(done.sitf) - 20.0) < 0.2)
    True
    """
    if len(np.unique(temperature_k)) < 2:
        raise BadInput(
            "a signal transfer must have two temperatures or more, got "
            f"{len(np.unique(temperature_k))}"
        )
    reference, levels = float(np.mean(temperature_k)), len(mean_dn)
    crude = float(np.polyfit(temperature_k - reference, mean_dn, 1)[0])
    sd = np.hypot(sd_dn, crude * INFRARED.blackbody_sd_k)
    candidates = responses(band_um)
    axes = [_place(response, temperature_k, reference) for response in candidates]
    fits = [linear_fit([np.ones(levels), radiance], mean_dn, sd) for radiance in axes]
    freedom = INFRARED.scatter_freedom + levels - 2
    sums = np.array([INFRARED.scatter_freedom + fit.chi2 for fit in fits])
    logs = 0.5 * np.log([np.linalg.det(fit.covariance) for fit in fits]) - 0.5 * freedom * np.log(
        sums
    )
    probability = np.exp(logs - logs.max())
    probability /= probability.sum()
    draws = INFRARED.draws
    choice = rng.choice(len(candidates), draws, p=probability)
    scale = np.sqrt(sums[choice] / rng.chisquare(freedom, draws))
    best, error = np.array([(fit.best[1], fit.covariance[1, 1] ** 0.5) for fit in fits]).T
    slope = best[choice] + error[choice] * scale * rng.standard_normal(draws)
    any_background = rng.uniform(temperature_k.min(), temperature_k.max(), draws)
    background = any_background if background_k is None else np.full(draws, background_k)
    top = int(np.argmax(probability))
    bent, change = _parabola(
        axes[top], mean_dn, sd, candidates[top], reference, float(np.mean(background))
    )
    law = fits[top].best
    return SignalTransfer(
        responses=candidates,
        probability=probability,
        choice=choice,
        slope_dn_per_k=slope,
        reference_k=reference,
        background_k=background,
        law=law,
        residual_dn=mean_dn - law[0] - law[1] * axes[top],
        chi2=fits[top].chi2,
        parabola_chi2=bent,
        parabola_slope=change,
    )


def _place(response: Response, temperature_k: float | Array, reference_k: float) -> Array:
    """Return the radiance of a temperature, less that of the reference, in K at the reference."""
    return (
        response.radiance(temperature_k) - response.radiance(reference_k)
    ) / response.derivative(reference_k)


def _parabola(
    radiance: Array,
    mean_dn: Array,
    sd: Array,
    response: Response,
    reference: float,
    background: float,
) -> tuple[float, float]:
    """Return chi squared of the law with a quadratic term, and the relative change of the slope at
    the background.
    """
    if len(radiance) < 4:
        return np.inf, 0.0
    fit = linear_fit([np.ones(len(radiance)), radiance, radiance**2], mean_dn, sd)
    plain = linear_fit([np.ones(len(radiance)), radiance], mean_dn, sd)
    at = float(_place(response, background, reference))
    return fit.chi2, float((fit.best[1] + 2.0 * fit.best[2] * at) / plain.best[1] - 1.0)


def band_note(band_um: Sequence[float] | None, transfer: SignalTransfer) -> str:
    """Return the note on the law of the fit: the band's radiance, or how much an unknown band bends
    it.
    """
    middle = float(np.median(transfer.background_k))
    if band_um is not None:
        energy = next(response for response in transfer.responses if not response.photons)
        per = float(np.median(transfer.sitf)) / float(energy.derivative(middle))
        return (
            f"Fitted against band radiance of {energy.name}: {per:.4g} DN per W m-2 sr-1, dL/dT "
            f"{float(energy.derivative(middle)):.4g} W m-2 sr-1 K-1 at {middle:.1f} K."
        )
    bands = [Response(low_um=low, high_um=high) for low, high in ((8.0, 12.0), (3.0, 5.0))]
    growth = [
        100.0 * (float(response.derivative(middle + 5.0) / response.derivative(middle)) - 1.0)
        for response in bands
    ]
    return (
        "The band is unknown, so both windows and a signal linear in temperature were fitted "
        f"(most probable {transfer.likeliest.name}): dL/dT grows {growth[0]:.1f} % in 8-12 µm and "
        f"{growth[1]:.1f} % in 3-5 µm from {middle:.0f} K to {middle + 5.0:.0f} K, which the "
        "interval holds; a sensor with its band in session.toml narrows it."
    )
