"""Noise of a digital read-out that is not white: rows, neighbours along a row, interference."""

import numpy as np
from numpy.typing import NDArray

from charact.observables.dark_spectrum import ReadoutSpectrum
from charact.observables.observable import (
    Estimates,
    GivenOthers,
    Observable,
    Stacks,
    Values,
    columns,
    observable,
)
from charact.observables.silicon import (
    ACROSS,
    CONVERSION_GAIN,
    DOWN,
    FINE_RATIO,
    INTERFERENCE,
    READ_NOISE,
    ROW_EXPONENT,
    ROW_NOISE,
    dn_per_electron,
    neighbour_covariance,
    row_density,
)
from charact.observables.stack_level import StackLevel
from charact.observables.thresholds import READOUT, SILICON

Array = NDArray[np.float64]


def spectrum_of(dark: StackLevel) -> ReadoutSpectrum:
    """Return the spectrum of a dark that has one."""
    assert dark.readout is not None
    return dark.readout


class OfReadout(Observable[Stacks[StackLevel]]):
    """A statistic of the dark with most frames, of these of the shortest exposure."""

    tube = False

    def usable(self, stacks: Stacks[StackLevel]) -> Stacks[StackLevel] | None:
        """Return that dark, if its noise is wide enough and its frames many enough."""
        darks = [
            dark
            for dark in stacks.darks
            if dark.variance_dn2 > (SILICON.least_noise_dn * dark.step_dn) ** 2
        ]
        chosen = sorted(darks, key=lambda dark: (-dark.shape[0], dark.exposure_s))[:1]
        known = chosen and chosen[0].readout is not None
        return stacks.only(darks=chosen) if known else None


@observable
class RowOffsets(OfReadout):
    """Spectrum of the offsets of rows, in bands.

    The logarithm of a mean of n exponential numbers has the variance 1/n and lies 1/(2n) low.
    """

    name = "offsets of rows"
    order = 31
    model_sd = READOUT.row_model_sd
    depends = (ROW_NOISE, ROW_EXPONENT)

    def measure(self, stacks: Stacks[StackLevel]) -> Estimates:
        """Return logarithms of the power of each band, DN^2."""
        spectrum = spectrum_of(stacks.dark)
        frames, _, columns = spectrum.shape
        bands = _bands(spectrum)
        power = np.array([spectrum.row_power[band].mean() for band in bands]) / columns
        number = np.array([band.size for band in bands]) * (frames - 1.0)
        return Estimates(value=np.log(power) + 0.5 / number, covariance=np.diag(1.0 / number))

    def predict(self, values: Values, stacks: Stacks[StackLevel]) -> Array:
        spectrum = spectrum_of(stacks.dark)
        ground = spectrum.near_rows / spectrum.shape[2]
        density = row_density(values, spectrum.row_frequency) + ground
        bands = _bands(spectrum)
        return np.log(np.stack([density[:, band].mean(axis=1) for band in bands], axis=1))


def _bands(spectrum: ReadoutSpectrum) -> list[NDArray[np.int64]]:
    """Return the members of bands equal in the logarithm of the frequency."""
    frequency = spectrum.row_frequency
    edges = np.geomspace(frequency[0], 0.5, READOUT.row_bands + 1)
    band = np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, READOUT.row_bands - 1)
    # The lowest frequencies have few numbers: bands of fewer than four are joined to the next.
    members = [np.flatnonzero(band == index) for index in np.unique(band)]
    while len(members) > 1 and members[0].size < 4:
        members = [np.concatenate(members[:2]), *members[2:]]
    return members


@observable
class NeighbourCovariance(OfReadout):
    """Covariance of neighbours along a row by read noise."""

    name = "covariance of neighbours in a row"
    order = 32
    depends = (FINE_RATIO, CONVERSION_GAIN, READ_NOISE)
    given_others = GivenOthers(
        path=FINE_RATIO,
        function=lambda ratio: (1.0 - ratio) / (1.0 + ratio),
        inverse=lambda value, sd: 2.0 / (1.0 + np.clip(value, -0.99, 0.99)) - 1.0,
    )

    def measure(self, stacks: Stacks[StackLevel]) -> Estimates:
        """Return the covariance, DN^2."""
        return Estimates.of_number(*spectrum_of(stacks.dark).neighbour_covariance)

    def number(self, values: Values, shown: Stacks[StackLevel]) -> Array:
        read_noise_dn = dn_per_electron(values, shown.dark.conditions) * values[READ_NOISE]
        return neighbour_covariance(values, read_noise_dn)


@observable
class Interference(OfReadout):
    """Mean square and frequencies of a sinusoid over the frame; none without a peak."""

    name = "interference"
    order = 33
    depends = (INTERFERENCE, ACROSS, DOWN)

    def usable(self, stacks: Stacks[StackLevel]) -> Stacks[StackLevel] | None:
        """Return the dark if its spectrum has a peak."""
        shown = super().usable(stacks)
        peak = None if shown is None else spectrum_of(shown.dark).interference
        return None if peak is None else shown

    def measure(self, stacks: Stacks[StackLevel]) -> Estimates:
        """Return mean square, DN^2, and both frequencies, cy/px."""
        spectrum = spectrum_of(stacks.dark)
        (_, rows, columns), peak = spectrum.shape, spectrum.interference
        assert peak is not None
        sd = np.array([peak.sd_dn2, *(READOUT.frequency_cycles_sd / n for n in (columns, rows))])
        return Estimates(
            value=np.array([peak.mean_square_dn2, peak.x_cy_per_px, peak.y_cy_per_px]),
            covariance=np.diag(sd**2),
        )

    def model_covariance(self, estimates: Estimates, stacks: Stacks[StackLevel]) -> Array:
        return np.diag([(SILICON.noise_model_sd * estimates.value[0]) ** 2, 0.0, 0.0])

    def predict(self, values: Values, stacks: Stacks[StackLevel]) -> Array:
        return columns(*(values[path] for path in self.depends))
