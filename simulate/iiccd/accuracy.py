"""Accuracy parameters of the camera simulation: tolerances, limits of tables and numbers of samples."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Tolerances of the approximations that stages and samplers make; dimensionless unless a unit is given."""

    # Resampling is exact up to this frequency and fades to nothing at 1 cy/px, so that a point does not ring.
    resampling_exact_cy_per_px: float = 0.6
    # Largest error of the transfer of a band where bands are sums of a few transfers.
    band_transfer_error: float = 1e-4
    # Frequencies at which the transfers of bands are compared.
    n_band_frequencies: int = 1500
    # Distance from the axis, in corner radii, to which distortion is inverted.
    max_distortion_radius: float = 2.0
    # Radii of the table that inverts distortion.
    n_distortion_steps: int = 4096
    # Spectral replicas with a smaller transfer are neglected.
    min_replica_transfer: float = 1e-3
    # Fraction of the light, at most, that is emitted after the last lag field.
    max_lag_fraction: float = 1e-3
    # Arrival times over which decay fractions are averaged.
    n_arrival_times: int = 2000
    # Fraction of a single pulse that may lie beyond its compact part.
    max_near_wing_fraction: float = 0.02
    # Light is not sharpened where the squared kernel has a smaller transfer.
    min_sharpened_transfer: float = 0.05
    # Fraction of the squared kernel that its separable parts may neglect.
    separable_residual: float = 2e-6
    # Relative error of the third moment of pulses on the lattice; one cell per column is then enough.
    skewness_tolerance: float = 0.012
    # Below this mean per pixel single pulses are resolved, and drawn one by one.
    sparse_pe_per_px: float = 0.8
    # Skewness of the shot noise of the charge, over all noise, above which electrons are counted.
    counted_skewness: float = 0.01
    # More photoelectrons in a cell have the noise of this number, so that values stay finite.
    max_pe_per_cell: float = 1e9
    # Charge never exceeds its mean by more standard deviations.
    max_charge_sd: float = 8.0
    # Smaller taps of an impulse response are neglected.
    min_filter_tap: float = 1e-6
    # Decay components that store a smaller mean fraction are neglected.
    min_stored_fraction: float = 1e-6
    # Parts of the table that guides the search for the cell of a pulse.
    n_search_guides: int = 2**20
    # Probability that the largest value of a fixed pattern exceeds the bound.
    extreme_probability: float = 0.1
    # A well may overflow if its charge lies within this many standard deviations of the full well.
    overflow_sd: float = 8.0
    # Rings in which the displacement by the taper is bounded by that of their outer edge.
    n_distortion_rings: int = 6


ACCURACY = Accuracy()
