"""Quantities predicted by the camera model, for many parameter draws at once."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.observables import Values
from charact.transfer.extended import halo
from charact.transfer.stages import fibres, image_tube, lens, slit
from charact.transfer.video_filter import sampled_response, transfer

Array = NDArray[np.float64]
ELEMENTARY_CHARGE_C = 1.602176634e-19


# Central wavelength of light of 2856 K on a photocathode or silicon, nm.
BROADBAND_NM = 700.0
# Weights beyond this many pixels are below 1e-6 for any bandwidth suitable for the pixel clock.
VIDEO_CLOCKS = 14


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
    detector = _per_mm_at_detector(values, fx, fy)
    if not has_tube(values):
        return _lens(values, detector, wavelength_nm) * _readout(values, fx, fy)
    cathode = detector / _column(values, "taper.demagnification")
    halo_fraction = _column(values, "photocathode.halo_fraction")
    u = np.maximum(4.0 * np.pi * _column(values, "photocathode.gap_mm") * cathode, 1e-6)
    halo_transfer = halo(u, _column(values, "photocathode.halo_elastic_share"))
    before = _lens(values, cathode, wavelength_nm) * (
        (1.0 - halo_fraction) + halo_fraction * halo_transfer
    )
    return (
        before
        * _tube(values, cathode, 1.0)
        * _coupling(values, detector)
        * _readout(values, fx, fy)
    )


def blur_factor(values: Values, gain_dn_per_pe: Array) -> Array:
    """Return the blur factor of a field's noise, shape (n,), dimensionless; see `noise_shape`."""
    return noise_shape(values, gain_dn_per_pe)[0]


def noise_shape(values: Values, gain_dn_per_pe: Array) -> tuple[Array, Array]:
    """Return blur factor and horizontal neighbour correlation of a field's noise, shape (n,),
    dimensionless.

    A photoelectron's light spreads with the transfer H of all stages after the gain. Poisson events
    on the photocathode have, x pixels apart, the covariance (rate) integral of |H|^2 cos(2 pi fx x)
    over the frequency plane in cycles per field pixel, and the covariance sum (rate) |H(0)|^2 =
    (rate), since the pixels tile the plane. Electrons counted in the detector are white before the
    video filter, which correlates them by its weights. The two contributions have the ratio k F^2
    to K.
    """
    weights = _video_weights(values)
    across = slit(_ACROSS) * np.abs(transfer(weights, _ACROSS))
    detector = _per_mm_at_detector(
        values, *(plane.ravel() for plane in np.meshgrid(_ACROSS, _ALONG / rows_per_pixel(values)))
    )
    cathode = detector / _column(values, "taper.demagnification")
    after = _tube(values, cathode, _column(values, "tube.post_gain_share")) * _coupling(
        values, detector
    )
    down = slit(_ALONG) ** 2 * _ALONG_WEIGHT
    columns = down @ after.reshape(-1, _ALONG.size, _ACROSS.size) ** 2
    power = 4.0 * columns * across**2 * _ACROSS_WEIGHT
    electron = values["video.conversion_gain_dn_per_e"]
    event = gain_dn_per_pe * excess_noise_factor(values)
    variance, neighbour = (
        (event * pulses + electron * filtered) / (event + electron)
        for pulses, filtered in (
            (power.sum(axis=1), np.sum(weights**2, axis=1)),
            (
                power @ np.cos(2.0 * np.pi * _ACROSS),
                np.sum(weights[:, 1:] * weights[:, :-1], axis=1),
            ),
        )
    )
    return variance, neighbour / variance


def excess_noise_factor(values: Values) -> Array:
    """Return F^2 = (1 + 1/shape)/p of Polya pulse heights and the detection probability p, shape
    (n,).
    """
    shape = values["microchannel_plate.pulse_height_shape"]
    return (1.0 + 1.0 / shape) / values["microchannel_plate.detection_probability"]


def photoelectron_gain(values: Values, mcp_v: ArrayLike, reference_v: float) -> Array:
    """Return k, the mean signal per photoelectron, undetected ones included, shape (n,), DN.

    A tube of luminous gain G emits G/(efficacy x photon energy) photons per lumen on the
    photocathode, which releases S/e electrons; the taper transmits T of the photons, the detector
    converts QE of them to electrons of K DN each. The gain depends on the MCP voltage as (V/V0)^m.
    """
    electrons = values["taper.transmission"] * values["ccd.quantum_efficiency"]
    return (
        _photons_per_pe(values, mcp_v, reference_v)
        * electrons
        * values["video.conversion_gain_dn_per_e"]
    )


def covariance_gain(values: Values, gain_dn_per_pe: Array) -> Array:
    """Return K + k F^2 at the gain k per photoelectron, shape (n,), DN."""
    event = gain_dn_per_pe * excess_noise_factor(values)
    return values["video.conversion_gain_dn_per_e"] + event


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
    values: Values,
    illuminance_lux: ArrayLike,
    gate_s: ArrayLike,
    mcp_v: ArrayLike,
    reference_v: float,
) -> Array:
    """Return the mean MCP output current over the current at half gain, shape (n,).

    G_loaded = G/(1 + load), load = j/(a j_strip), j = E S G gate/field averaged over the MCP.
    """
    per_pe = _photons_per_pe(values, mcp_v, reference_v) / values["phosphor.photons_per_electron"]
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
    electrons = (
        electrons
        * values["video.conversion_gain_dn_per_e"]
        * values["phosphor.photons_per_electron"]
    )
    current_a = (
        np.asarray(signal_dn) / electrons * ELEMENTARY_CHARGE_C * values["video.field_rate_hz"]
    )
    limit = values["microchannel_plate.strip_current_ua_per_cm2"] * 1e-6
    limit = limit * values["microchannel_plate.saturation_fraction"]
    return current_a / (_field_pixel_m2(values) * 1e4) / limit


def dark_variance(values: Values, gain_dn_per_pe: Array, blur: Array, gate_s: float) -> Array:
    """Return the temporal variance of a dark frame, shape (n,), DN^2.

    K^2 (r^2 + d) sum w^2 + k^2 F^2 B n sum l^2 + 1/12: read noise r and dark charge d pass the
    video filter w; the n photoelectrons of the EBI are blurred (B, `blur`), and phosphor decay over
    several fields reduces their noise to the fraction sum l^2.
    """
    filtered = np.sum(_video_weights(values) ** 2, axis=1)
    dark_e = (
        rows_per_pixel(values) * values["ccd.dark_current_e_per_s"] / values["video.field_rate_hz"]
    )
    reading = (
        values["video.conversion_gain_dn_per_e"] ** 2
        * (values["ccd.read_noise_e"] ** 2 + dark_e)
        * filtered
    )
    events = background_rate(values) * gate_s
    pulses = covariance_gain(values, gain_dn_per_pe) * gain_dn_per_pe * events * blur
    return reading + pulses * lag_noise_fraction(values, gate_s) + 1.0 / 12.0


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
    return rate * square * blur * lag_noise_fraction(values, gate_s)


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


def lag_noise_fraction(values: Values, gate_s: float) -> Array:
    """Return the fraction of a field's scintillation variance that remains with phosphor decay,
    shape (n,).

    Mean of sum_j l_j^2 over the arrival of a pulse within the gate at the start of a field; l_j is
    the fraction of its light in the j-th field after it, of two exponential components.
    """
    field_s = 1.0 / values["video.field_rate_hz"][:, None, None]
    fast = values["phosphor.fast_fraction"]
    light = np.stack(
        [fast * values["phosphor.fast_decay_ms"], (1.0 - fast) * values["phosphor.slow_decay_ms"]]
    )
    decay_s = [
        values[f"phosphor.{name}_decay_ms"][:, None, None] * 1e-3 for name in ("fast", "slow")
    ]
    node, weight = _nodes((0.0, 1.0), (12,))
    arrival_s = gate_s * node[None, :, None]
    ends_s = np.maximum((np.arange(13)[None, None, :]) * field_s - arrival_s, 0.0)
    glowing = [
        light_fraction[:, None, None] * np.exp(-ends_s / tau)
        for light_fraction, tau in zip(light / light.sum(axis=0), decay_s, strict=True)
    ]
    shares = -np.diff(glowing[0] + glowing[1], axis=2)
    return np.sum(shares**2, axis=2) @ weight


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
    filtered = np.sum(_video_weights(values) ** 2, axis=1)
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


def _column(values: Values, path: str) -> Array:
    return values[path][:, None]


def _per_mm_at_detector(values: Values, fx: Array, fy: Array) -> Array:
    across = fx / (_column(values, "ccd.pitch_x_um") * 1e-3)
    along = fy / (_column(values, "ccd.pitch_y_um") * 1e-3)
    return np.hypot(across, along)


def _lens(values: Values, image_plane: Array, wavelength_nm: float) -> Array:
    blur_um, f_number = (
        _column(values, "optics.aberration_blur_um"),
        _column(values, "optics.f_number"),
    )
    return lens(image_plane, blur_um, f_number, wavelength_nm)


def _tube(values: Values, cathode: Array, fraction: Array | float) -> Array:
    return image_tube(
        cathode,
        _column(values, "tube.mtf_frequency_lp_per_mm"),
        _column(values, "tube.mtf_exponent"),
        fraction,
    )


def _coupling(values: Values, detector: Array) -> Array:
    return fibres(
        detector,
        _column(values, "taper.fibre_pitch_um") * 1e-3,
        _column(values, "taper.interface_mtf_lp_per_mm"),
    )


def _readout(values: Values, fx: Array, fy: Array) -> Array:
    pixel = slit(fx) * slit(rows_per_pixel(values) * fy)
    return pixel * np.abs(transfer(_video_weights(values), fx))


def _video_weights(values: Values) -> Array:
    if "video.bandwidth_mhz" not in values:
        return np.eye(1, VIDEO_CLOCKS)
    clock_mhz, order = (
        float(values["video.pixel_clock_mhz"][0]),
        int(values["video.filter_order"][0]),
    )
    return sampled_response(values["video.bandwidth_mhz"], clock_mhz, order, VIDEO_CLOCKS)


def _photons_per_pe(values: Values, mcp_v: ArrayLike, reference_v: float) -> Array:
    photon_j = values["phosphor.photon_energy_ev"] * ELEMENTARY_CHARGE_C
    photons_per_lumen = values["tube.luminous_gain"] / (
        values["phosphor.luminous_efficacy_lm_per_w"] * photon_j
    )
    voltage = (np.asarray(mcp_v) / reference_v) ** values["microchannel_plate.gain_exponent"]
    return photons_per_lumen / _electrons_per_lumen(values) * voltage


def _electrons_per_lumen(values: Values) -> Array:
    return values["photocathode.luminous_sensitivity_ua_per_lm"] * 1e-6 / ELEMENTARY_CHARGE_C


def _field_pixel_m2(values: Values) -> Array:
    pitch = values["ccd.pitch_x_um"] * rows_per_pixel(values) * values["ccd.pitch_y_um"] * 1e-12
    return pitch * values["taper.demagnification"] ** 2


def _nodes(edges: tuple[float, ...], counts: tuple[int, ...]) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights over pieces of a line."""
    points, weights = [], []
    for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True):
        node, weight = np.polynomial.legendre.leggauss(count)
        points.append(low + (high - low) * (node + 1.0) / 2.0)
        weights.append(weight * (high - low) / 2.0)
    return np.concatenate(points), np.concatenate(weights)


# Nodes of a quadrant of the frequency plane, cycles per field pixel, up to the limit of fibres and
# gaps.
_ACROSS, _ACROSS_WEIGHT = _nodes((0.0, 0.2, 0.8, 2.5), (5, 7, 10))
_ALONG, _ALONG_WEIGHT = _nodes((0.0, 0.2, 1.0, 2.0, 5.0), (5, 6, 6, 8))
