"""Quantities predicted by the camera model, for many parameter draws at once."""

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.fitting.last_values import of_last_values
from charact.fitting.tube_light import field_products
from charact.observables import Values
from charact.observables.silicon import CONVERSION_GAIN as CONVERSION
from charact.observables.silicon import DARK_CURRENT, READ_NOISE
from charact.transfer.extended import halo
from charact.transfer.stages import fibres, image_tube, lens, slit
from charact.transfer.video_filter import sampled_response, transfer

Array = NDArray[np.float64]
Pieces = tuple[tuple[float, ...], tuple[int, ...]]
ELEMENTARY_CHARGE_C = 1.602176634e-19


# Central wavelength of light of 2856 K on a photocathode or silicon, nm.
BROADBAND_NM = 700.0
# Weights beyond this many pixels are below 1e-6 for any bandwidth suitable for the pixel clock.
VIDEO_CLOCKS = 14
LINE_NOISE = "video.line_noise_dn"


def mtf(
    values: Values, across: ArrayLike, along: ArrayLike = 0.0, wavelength_nm: float = BROADBAND_NM
) -> Array:
    """Return the system MTF.

    `across`: horizontal frequencies, shape (m,), cycles per column pitch; `along`: vertical
    frequencies, shape (m,), cycles per row pitch of the sensor; a field row of interlaced video is
    the sum of two sensor rows; `wavelength_nm`: wavelength of the light, nm, on which diffraction
    depends.

    Returns Array, shape (n, m).

    lens x [(1 - q) + q halo] x tube x fibres x pixel x video, each a function of the frequency at
    its own plane; a camera without a tube has lens x pixel only.
    """
    fx, fy = np.broadcast_arrays(np.atleast_1d(np.asarray(across, float)), np.asarray(along, float))
    v, pixel = in_columns(values), slit(fx) * slit(rows_per_pixel(values) * fy)
    readout = pixel * np.abs(transfer(video_weights(values), fx))
    detector = _per_mm_at_detector(v, fx, fy)
    blur_um, f_number = v["optics.aberration_blur_um"], v["optics.f_number"]
    if not has_tube(values):
        return lens(detector, blur_um, f_number, wavelength_nm) * readout
    cathode = detector / v["taper.demagnification"]
    halo_fraction = v["photocathode.halo_fraction"]
    u = np.maximum(4.0 * np.pi * v["photocathode.gap_mm"] * cathode, 1e-6)
    halo_transfer = halo(u, v["photocathode.halo_elastic_share"])
    before = lens(cathode, blur_um, f_number, wavelength_nm) * (
        (1.0 - halo_fraction) + halo_fraction * halo_transfer
    )
    return before * _after_cathode(v, cathode, detector, 1.0) * readout


def blur_factor(values: Values, gain_dn_per_pe: Array) -> Array:
    """Return the blur factor of a field's noise, shape (n,), dimensionless; see `noise_shape`."""
    return noise_shape(values, gain_dn_per_pe)[0]


def noise_shape(values: Values, gain_dn_per_pe: Array) -> tuple[Array, Array]:
    """Return blur factor and horizontal neighbour correlation of a field's noise, shape (n,),
    dimensionless.

    Poisson events on the photocathode, whose pulses overlap, have the covariances of
    `pulse_covariance`; electrons counted in the detector are white before the video filter, which
    correlates them by its weights. The two contributions have the ratio k F^2 to K.
    """
    electron = values[CONVERSION]
    event = gain_dn_per_pe * excess_noise_factor(values)
    pulses, filtered = (
        pulse_covariance(values, ((0, 0), (1, 0)), FINE),
        filter_covariance(values, 2),
    )
    variance, neighbour = (
        (event * pulses[:, lag] + electron * filtered[:, lag]) / (event + electron)
        for lag in (0, 1)
    )
    return variance, neighbour / variance


def pulse_covariance(
    values: Values, separations: tuple[tuple[float, float], ...], nodes: "Nodes | None" = None
) -> Array:
    """Return covariance over covariance sum of pulses at (columns, field rows) apart, shape (n, k),
    dimensionless.

    A photoelectron's light spreads with the transfer H of all stages after the gain. Poisson events
    on the photocathode have, x pixels apart, the covariance (rate) integral of |H|^2 cos(2 pi f x)
    over the plane of frequencies f in cycles per field pixel, and the covariance sum (rate)
    |H(0)|^2 = (rate), since the pixels tile the plane; at no distance it is the blur factor.
    """
    nodes = nodes or COARSE
    power, x, y = _power_after_gain(values, nodes), nodes.across, nodes.along
    video = slit(x) ** 2 * _filter_power(values, nodes) * nodes.across_weight
    covariance = []
    for columns_apart, rows_apart in separations:
        down = np.cos(2.0 * np.pi * y * rows_apart) * slit(y) ** 2 * nodes.along_weight
        cosine = np.cos(2.0 * np.pi * x * columns_apart)
        covariance.append(4.0 * np.sum((down @ power) * video * cosine, axis=1))
    return np.stack(covariance, axis=1)


def filter_covariance(values: Values, count: int) -> Array:
    """Return the covariances of filtered white noise of variance 1 at 0 ... count - 1 columns,
    shape (n, count).
    """
    weights = video_weights(values)
    length = weights.shape[1]
    return np.stack(
        [np.sum(weights[:, : length - lag] * weights[:, lag:], axis=1) for lag in range(count)],
        axis=1,
    )


def excess_noise_factor(values: Values) -> Array:
    """Return F^2 = (1 + 1/shape)/p of Polya pulse heights and the detection probability p, shape
    (n,).
    """
    shape = values["microchannel_plate.pulse_height_shape"]
    return (1.0 + 1.0 / shape) / values["microchannel_plate.detection_probability"]


def photoelectron_gain(values: Values, mcp_v: ArrayLike) -> Array:
    """Return k, the mean signal per photoelectron, undetected ones included, shape (n,), DN.

    A tube of luminous gain G emits G/(efficacy x photon energy) photons per lumen on the
    photocathode, which releases S/e electrons; the taper transmits T of the photons, the detector
    converts QE of them to electrons of K DN each. The gain depends on the MCP voltage as (V/V0)^m.
    """
    electrons = values["taper.transmission"] * values["ccd.quantum_efficiency"]
    return _photons_per_pe(values, mcp_v) * electrons * values[CONVERSION]


def covariance_gain(values: Values, gain_dn_per_pe: Array) -> Array:
    """Return K + k F^2 at the gain k per photoelectron, shape (n,), DN."""
    event = gain_dn_per_pe * excess_noise_factor(values)
    return values[CONVERSION] + event


def photoelectrons(values: Values, illuminance_lux: ArrayLike, gate_s: ArrayLike) -> Array:
    """Return photoelectrons of an illuminance per field pixel and exposure, without EBI, shape
    (n,).
    """
    return (
        np.asarray(illuminance_lux)
        * _electrons_per_lumen(values)
        * _field_pixel_m2(values)
        * np.asarray(gate_s)
    )


def background_rate(values: Values) -> Array:
    """Return the EBI in photoelectrons per field pixel and second, shape (n,)."""
    return (
        values["photocathode.ebi_lm_per_cm2"]
        * 1e4
        * _electrons_per_lumen(values)
        * _field_pixel_m2(values)
    )


def mcp_load(
    values: Values, illuminance_lux: ArrayLike, gate_s: ArrayLike, mcp_v: ArrayLike
) -> Array:
    """Return the mean MCP output current over the current at half gain, shape (n,).

    G_loaded = G/(1 + load), load = j/(a j_strip), j = E S G gate/field averaged over the MCP.
    """
    per_pe = _photons_per_pe(values, mcp_v) / values["phosphor.photons_per_electron"]
    cathode_a_per_cm2 = (
        np.asarray(illuminance_lux) * 1e-4 * _electrons_per_lumen(values) * ELEMENTARY_CHARGE_C
    )
    limit = values["microchannel_plate.strip_current_ua_per_cm2"] * 1e-6
    limit = limit * values["microchannel_plate.saturation_fraction"]
    return cathode_a_per_cm2 * per_pe * np.asarray(gate_s) * values["video.field_rate_hz"] / limit


def gain_loss(values: Values, signal_dn: ArrayLike) -> Array:
    """Return the fraction of the MCP's gain that is lost at a signal above the dark, shape (n,),
    dimensionless.

    load/(1 + load) of `mcp_load`, from the signal instead of the light: signal/(K QE T y) electrons
    leave the MCP per field pixel and field, y photons per electron of the screen.
    """
    electrons = values["taper.transmission"] * values["ccd.quantum_efficiency"]
    electrons = electrons * values[CONVERSION] * values["phosphor.photons_per_electron"]
    current_a = (
        np.asarray(signal_dn) / electrons * ELEMENTARY_CHARGE_C * values["video.field_rate_hz"]
    )
    limit = values["microchannel_plate.strip_current_ua_per_cm2"] * 1e-6
    limit = limit * values["microchannel_plate.saturation_fraction"]
    return current_a / (_field_pixel_m2(values) * 1e4) / limit


def reading_variance(
    values: Values, more_e2: Array | float = 0.0, warmth: Array | float = 1.0
) -> Array:
    """Return the variance of reading a dark, K^2 (r^2 + d) sum w^2, shape (n,), DN^2.

    Read noise r and dark charge d, by the warmth of the chip over that at 25 C, pass the video
    filter w; so does what else varies before it, `more_e2`, e-^2.
    """
    dark_e = rows_per_pixel(values) * values[DARK_CURRENT] / values["video.field_rate_hz"]
    charge = values[READ_NOISE] ** 2 + dark_e * warmth + more_e2
    return values[CONVERSION] ** 2 * charge * filter_covariance(values, 1)[:, 0]


def detector_variance(values: Values, signal_dn: float | Array) -> Array:
    """Return the variance of a pixel that the detector adds to the pulses of a signal, shape (n,),
    DN^2: noise of counted electrons and of reading, line noise and rounding.
    """
    filtered = filter_covariance(values, 1)[:, 0]
    counted = values[CONVERSION] * signal_dn * filtered
    return counted + reading_variance(values) + line_variance(values) + 1.0 / 12.0


def line_variance(values: Values) -> Array:
    """Return the variance of offsets common to a line, DN^2; 0 of a camera without them."""
    return values.get(LINE_NOISE, np.zeros(1)) ** 2


def dark_variance(values: Values, gain_dn_per_pe: Array, blur: Array, gate_s: float) -> Array:
    """Return the temporal variance of a dark frame, shape (n,), DN^2.

    K^2 (r^2 + d) sum w^2 + k^2 F^2 B n sum l^2 + 1/12: the n photoelectrons of the EBI are blurred
    (B, `blur`), and phosphor decay over several fields reduces their noise to the fraction sum l^2.
    """
    events = background_rate(values) * gate_s
    pulses = covariance_gain(values, gain_dn_per_pe) * gain_dn_per_pe * events * blur
    return reading_variance(values) + pulses * field_products(values, gate_s, 1)[:, 0] + 1.0 / 12.0


def ion_variance(values: Values, gain_dn_per_pe: Array, blur: Array, gate_s: float) -> Array:
    """Return the variance that ion pulses add to a dark frame, shape (n,), DN^2.

    A pulse of a Poisson number of detected photoelectrons, mean m, has the mean square (k/p)^2 (m^2
    + m + m/shape).
    """
    plate = "microchannel_plate."
    rate = ion_rate(values) * gate_s
    size, shape = values[plate + "ion_event_size_pe"], values[plate + "pulse_height_shape"]
    square = (gain_dn_per_pe / values[plate + "detection_probability"]) ** 2 * (
        size**2 + size + size / shape
    )
    return rate * square * blur * field_products(values, gate_s, 1)[:, 0]


def ion_rate(values: Values) -> Array:
    """Return the number of ion events per field pixel and second, shape (n,)."""
    return values["microchannel_plate.ion_event_rate_per_s_cm2"] * 1e4 * _field_pixel_m2(values)


def ion_light(values: Values) -> Array:
    """Return the mean light of ion pulses in photoelectrons per field pixel and second, shape (n,).

    A pulse of m detected photoelectrons has the light of m/p released ones, of which the fraction p
    is detected.
    """
    plate = "microchannel_plate."
    return (
        ion_rate(values)
        * values[plate + "ion_event_size_pe"]
        / values[plate + "detection_probability"]
    )


def halo_diameter_px(values: Values) -> Array:
    """Return the halo diameter before blur, four gaps, column pitches, shape (n,)."""
    pitch_mm = values["ccd.pitch_x_um"] * 1e-3 * values["taper.demagnification"]
    return 4.0 * values["photocathode.gap_mm"] / pitch_mm


def spatial_variance(values: Values) -> Array:
    """Return the relative variance of the fixed pattern of a flat behind a tube, shape (n,),
    dimensionless.

    PRNU of the detector, white before the video filter, and granularity of the screen, coarser than
    the blur; borders of multi-fibres are left to the model error.
    """
    filtered = filter_covariance(values, 1)[:, 0]
    return values["ccd.prnu"] ** 2 * filtered + values["phosphor.gain_nonuniformity"] ** 2


def has_tube(values: Values) -> bool:
    """Return whether the values are those of a camera with an intensifier."""
    return "tube.luminous_gain" in values


def rows_per_pixel(values: Values) -> float:
    """Return the sensor rows that a row of a field sums: two of interlaced analog video, else
    one.
    """
    if "video.rows_per_pixel" in values:
        return float(np.ravel(values["video.rows_per_pixel"])[0])
    return 2.0 if "video.bandwidth_mhz" in values else 1.0


def in_columns(values: Values) -> Values:
    """Return values of shape (n, 1), against which conditions or frequencies stand in rows."""
    return {path: value[:, None] for path, value in values.items()}


def _per_mm_at_detector(v: Values, fx: Array, fy: Array) -> Array:
    across, along = fx / (v["ccd.pitch_x_um"] * 1e-3), fy / (v["ccd.pitch_y_um"] * 1e-3)
    return np.hypot(across, along)


def _after_cathode(
    v: Values, cathode: Array, detector: Array, tube_fraction: Array | float
) -> Array:
    """Return the transfer of a share of the tube's blur, and of the fibres behind it."""
    fibre_mm, interface = v["taper.fibre_pitch_um"] * 1e-3, v["taper.interface_mtf_lp_per_mm"]
    cut_off, exponent = v["tube.mtf_frequency_lp_per_mm"], v["tube.mtf_exponent"]
    return image_tube(cathode, cut_off, exponent, tube_fraction) * fibres(
        detector, fibre_mm, interface
    )


@of_last_values()
def video_weights(values: Values) -> Array:
    """Return the weights by which the video filter adds a pixel to later ones, shape (n, pixel)."""
    if "video.bandwidth_mhz" not in values:
        return np.eye(1, VIDEO_CLOCKS)
    clock_mhz, order = (
        float(values["video.pixel_clock_mhz"][0]),
        int(values["video.filter_order"][0]),
    )
    return sampled_response(values["video.bandwidth_mhz"], clock_mhz, order, VIDEO_CLOCKS)


@of_last_values()
def _filter_power(values: Values, nodes: "Nodes") -> Array:
    """Return |W(f)|^2 of the video filter at nodes along a row, shape (n, across).

    c_0 + 2 sum_j c_j cos(2 pi f j), c_j the covariances of filtered white noise.
    """
    lags = np.arange(VIDEO_CLOCKS)
    cosines = np.cos(2.0 * np.pi * np.outer(lags, nodes.across))
    return filter_covariance(values, VIDEO_CLOCKS) * np.minimum(lags + 1, 2) @ cosines


@of_last_values(
    "ccd.pitch_x_um",
    "ccd.pitch_y_um",
    "taper.demagnification",
    "taper.fibre_pitch_um",
    "taper.interface_mtf_lp_per_mm",
    "tube.mtf_exponent",
    "tube.mtf_frequency_lp_per_mm",
    "tube.post_gain_share",
    "video.rows_per_pixel",
    "video.bandwidth_mhz",
)
def _power_after_gain(values: Values, nodes: "Nodes") -> Array:
    """Return |H|^2 of the optical stages after the gain at nodes, shape (n, along, across)."""
    v = in_columns(values)
    fx, fy = np.meshgrid(nodes.across, nodes.along / rows_per_pixel(values))
    detector = _per_mm_at_detector(v, fx.ravel(), fy.ravel())
    cathode = detector / v["taper.demagnification"]
    power = _after_cathode(v, cathode, detector, v["tube.post_gain_share"]) ** 2
    return power.reshape(-1, *fx.shape)


def _photons_per_pe(values: Values, mcp_v: ArrayLike) -> Array:
    photon_j = values["phosphor.photon_energy_ev"] * ELEMENTARY_CHARGE_C
    photons_per_lumen = values["tube.luminous_gain"] / (
        values["phosphor.luminous_efficacy_lm_per_w"] * photon_j
    )
    relative_v = np.asarray(mcp_v) / values["microchannel_plate.reference_v"]
    voltage = relative_v ** values["microchannel_plate.gain_exponent"]
    return photons_per_lumen / _electrons_per_lumen(values) * voltage


def _electrons_per_lumen(values: Values) -> Array:
    return values["photocathode.luminous_sensitivity_ua_per_lm"] * 1e-6 / ELEMENTARY_CHARGE_C


def _field_pixel_m2(values: Values) -> Array:
    pitch = values["ccd.pitch_x_um"] * rows_per_pixel(values) * values["ccd.pitch_y_um"] * 1e-12
    return pitch * values["taper.demagnification"] ** 2


def gauss_nodes(edges: tuple[float, ...], counts: tuple[int, ...]) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights over pieces of a line."""
    points, weights = [], []
    for (low, high), count in zip(pairwise(edges), counts, strict=True):
        node, weight = np.polynomial.legendre.leggauss(count)
        points.append(low + (high - low) * (node + 1.0) / 2.0)
        weights.append(weight * (high - low) / 2.0)
    return np.concatenate(points), np.concatenate(weights)


class Nodes:
    """Nodes and weights of a quadrant of the frequency plane, cycles per field pixel, from edges
    and counts of pieces of each axis.
    """

    def __init__(self, *, across: Pieces, along: Pieces) -> None:
        self.across, self.across_weight = gauss_nodes(*across)
        self.along, self.along_weight = gauss_nodes(*along)


# Up to the limit of fibres and gaps; and fewer, for the shape of pulses alone.
FINE = Nodes(
    across=((0.0, 0.2, 0.8, 2.5), (5, 7, 10)), along=((0.0, 0.2, 1.0, 2.0, 5.0), (5, 6, 6, 8))
)
COARSE = Nodes(across=((0.0, 0.2, 0.8, 2.0), (3, 4, 5)), along=((0.0, 0.2, 1.0, 3.0), (3, 5, 7)))
