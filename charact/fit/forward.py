"""What the fit's camera model predicts for each measured quantity, for many parameter draws at once.

`Values` maps a parameter's path ("tube.mtf_exponent") to its draws, shape (n,). Every function returns one number, or
one row of numbers, for each draw. The formulas are the fit's own: see `charact.fit.transfer` and `charact.fit.video`.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.fit import transfer, video

Values = Mapping[str, NDArray[np.float64]]
Array = NDArray[np.float64]

ELEMENTARY_CHARGE_C = 1.602176634e-19


def mtf(values: Values, across: ArrayLike, along: ArrayLike = 0.0) -> Array:
    """Return the MTF of the whole camera, normalised to the light that entered.

    Parameters
    ----------
    across
        Horizontal frequencies, shape (m,), cycles per column pitch.
    along
        Vertical frequencies, shape (m,), cycles per row pitch; a row as read sums two.

    Returns
    -------
    Array, shape (n, m).

    Notes
    -----
    lens x [(1 - q) + q halo] x tube x fibres x pixel x video, each a function of the frequency at its own plane.
    """
    fx, fy = np.broadcast_arrays(np.atleast_1d(np.asarray(across, float)), np.asarray(along, float))
    detector = _per_mm_at_detector(values, fx, fy)
    cathode = detector / _column(values, "taper.demagnification")
    share = _column(values, "photocathode.halo_fraction")
    halo = transfer.halo(
        cathode, _column(values, "photocathode.gap_mm"), _column(values, "photocathode.halo_elastic_share")
    )
    lens = transfer.lens(cathode, _column(values, "optics.aberration_blur_um"), _column(values, "optics.f_number"))
    before = lens * ((1.0 - share) + share * halo)
    return before * _tube(values, cathode, 1.0) * _coupling(values, detector) * _readout(values, fx, fy)


def blur_factor(values: Values, gain_dn_per_pe: Array) -> Array:
    """Return variance over covariance sum of the noise of a field, shape (n,), dimensionless.

    Notes
    -----
    A photoelectron's light spreads with the transfer H of all that follows the gain. Poisson events anywhere on the
    cathode have the variance (rate) integral of |H|^2 over the frequency plane in cycles per field pixel, and the
    covariance sum (rate) |H(0)|^2 = (rate), since the pixels tile the plane. Electrons counted in the detector are
    white before the video filter: the same integral with the filter alone, weighted with K against k F^2.
    """
    weights = _video_weights(values)
    across = transfer.aperture(_ACROSS) * video.transfer(weights, _ACROSS)
    detector = _per_mm_at_detector(values, *(plane.ravel() for plane in np.meshgrid(_ACROSS, _ALONG / 2.0)))
    cathode = detector / _column(values, "taper.demagnification")
    after = _tube(values, cathode, _column(values, "tube.post_gain_share")) * _coupling(values, detector)
    rows = (after.reshape(-1, _ALONG.size, _ACROSS.size) ** 2 @ (across**2 * _ACROSS_WEIGHT)[:, :, None])[:, :, 0]
    scintillation = 4.0 * rows @ (transfer.aperture(_ALONG) ** 2 * _ALONG_WEIGHT)
    filtered = np.sum(weights**2, axis=1)
    electron = values["video.conversion_gain_dn_per_e"]
    event = gain_dn_per_pe * excess_noise_factor(values)
    return (event * scintillation + electron * filtered) / (event + electron)


def excess_noise_factor(values: Values) -> Array:
    """Return F^2 = (1 + 1/shape)/p of Polya pulse heights and the detection probability p, shape (n,)."""
    shape = values["microchannel_plate.pulse_height_shape"]
    return (1.0 + 1.0 / shape) / values["microchannel_plate.detection_probability"]


def photoelectron_gain(values: Values, mcp_v: float, reference_v: float) -> Array:
    """Return k, the mean signal of one photoelectron (the undetected counted), shape (n,), DN.

    Notes
    -----
    A tube of luminous gain G sends G/(efficacy x photon energy) photons for each lumen on the cathode, which releases
    S/e electrons; the taper passes T of the photons, the detector turns QE of them into electrons of K DN each. The
    gain follows the plate's voltage as (V/V0)^m.
    """
    photon_j = values["phosphor.photon_energy_ev"] * ELEMENTARY_CHARGE_C
    photons_per_lumen = values["tube.luminous_gain"] / (values["phosphor.luminous_efficacy_lm_per_w"] * photon_j)
    electrons = values["taper.transmission"] * values["ccd.quantum_efficiency"]
    voltage = (mcp_v / reference_v) ** values["microchannel_plate.gain_exponent"]
    conversion = values["video.conversion_gain_dn_per_e"]
    return photons_per_lumen / _electrons_per_lumen(values) * electrons * conversion * voltage


def covariance_gain(values: Values, gain_dn_per_pe: Array) -> Array:
    """Return K + k F^2 at the gain k per photoelectron, shape (n,), DN."""
    event = gain_dn_per_pe * excess_noise_factor(values)
    return values["video.conversion_gain_dn_per_e"] + event


def photoelectrons(values: Values, illuminance_lux: ArrayLike, gate_s: float) -> Array:
    """Return photoelectrons of an illuminance per field pixel and exposure, without EBI, shape (n,)."""
    return np.asarray(illuminance_lux) * _electrons_per_lumen(values) * _field_pixel_m2(values) * gate_s


def background_rate(values: Values) -> Array:
    """Return the EBI in photoelectrons per field pixel and second, shape (n,)."""
    return values["photocathode.ebi_lm_per_cm2"] * 1e4 * _electrons_per_lumen(values) * _field_pixel_m2(values)


def dark_dn(values: Values, exposure_s: float) -> Array:
    """Return the signal of the detector's own dark current, two rows summed, shape (n,), DN."""
    electrons = 2.0 * values["ccd.dark_current_e_per_s"] * exposure_s
    return electrons * values["video.conversion_gain_dn_per_e"]


def halo_diameter_px(values: Values) -> Array:
    """Return the halo's outer diameter before any blur, four gaps seen through the taper, shape (n,), column pitches."""
    pitch_mm = values["ccd.pitch_x_um"] * 1e-3 * values["taper.demagnification"]
    return 4.0 * values["photocathode.gap_mm"] / pitch_mm


def _column(values: Values, path: str) -> Array:
    return values[path][:, None]


def _per_mm_at_detector(values: Values, fx: Array, fy: Array) -> Array:
    across = fx / (_column(values, "ccd.pitch_x_um") * 1e-3)
    along = fy / (_column(values, "ccd.pitch_y_um") * 1e-3)
    return np.hypot(across, along)


def _tube(values: Values, cathode: Array, share: Array | float) -> Array:
    return transfer.tube(
        cathode, _column(values, "tube.mtf_frequency_lp_per_mm"), _column(values, "tube.mtf_exponent"), share
    )


def _coupling(values: Values, detector: Array) -> Array:
    return transfer.fibres(
        detector, _column(values, "taper.fibre_pitch_um"), _column(values, "taper.interface_mtf_lp_per_mm")
    )


def _readout(values: Values, fx: Array, fy: Array) -> Array:
    pixel = transfer.aperture(fx) * transfer.aperture(2.0 * fy)
    return pixel * video.transfer(_video_weights(values), fx)


def _video_weights(values: Values) -> Array:
    clock_mhz, order = float(values["video.pixel_clock_mhz"][0]), int(values["video.filter_order"][0])
    return video.weights(values["video.bandwidth_mhz"], clock_mhz, order)


def _electrons_per_lumen(values: Values) -> Array:
    return values["photocathode.luminous_sensitivity_ua_per_lm"] * 1e-6 / ELEMENTARY_CHARGE_C


def _field_pixel_m2(values: Values) -> Array:
    pitch = values["ccd.pitch_x_um"] * 2.0 * values["ccd.pitch_y_um"] * 1e-12
    return pitch * values["taper.demagnification"] ** 2


def _nodes(edges: tuple[float, ...], counts: tuple[int, ...]) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights over pieces of a line."""
    points, weights = [], []
    for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True):
        node, weight = np.polynomial.legendre.leggauss(count)
        points.append(low + (high - low) * (node + 1.0) / 2.0)
        weights.append(weight * (high - low) / 2.0)
    return np.concatenate(points), np.concatenate(weights)


# Nodes of a quadrant of the frequency plane, cycles per field pixel, as far as fibres and their gaps let anything pass.
_ACROSS, _ACROSS_WEIGHT = _nodes((0.0, 0.2, 0.8, 2.5), (5, 6, 7))
_ALONG, _ALONG_WEIGHT = _nodes((0.0, 0.2, 1.0, 2.0, 5.0), (5, 6, 6, 8))
