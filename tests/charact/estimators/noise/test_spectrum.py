"""The noise spectrum is normalised to the variance, and rows of both parities are laid on one
picture.
"""

import numpy as np
import pytest

from charact.frames.pixels import pixel_sums
from charact.frames.spectrum import along_rows, bins_of, modes_of, products_of
from charact.frames.temporal import order_of, split_fields


def cross_spectra(change, parity, bins):
    """Mean products of the modes of fluctuations in every bin."""
    modes = [
        modes_of(along_rows(image, 0, bins), int(odd), bins)
        for image, odd in zip(change, parity, strict=True)
    ]
    return products_of(np.array(modes), bins)


def test_white_noise_has_its_variance_in_every_bin(seed):
    rng = np.random.default_rng(seed)
    change = 3.0 * rng.standard_normal((60, 96, 128), dtype=np.float32)
    bins = bins_of(96, 128, 1.0)
    power = np.einsum("bii->bi", cross_spectra(change, np.zeros(60, int), bins))
    error = 9.0 / np.sqrt(60 * bins.modes * bins.efficiency)
    assert np.all(np.abs(power.mean(axis=1) - 9.0) < 4.5 * error)
    # No more modes are counted than are independent, and few less: that is what every interval here
    # rests on.
    scatter = power.var(axis=1, ddof=1) * bins.modes * bins.efficiency / 81.0
    assert 0.75 < scatter.mean() < 1.0


def test_both_fields_of_one_picture_agree_at_low_frequency(seed):
    """Odd rows see a smooth picture half a field row further down: turned back, they correlate
    fully.
    """
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((256, 160))
    along, across = np.fft.fftfreq(256)[:, None], np.fft.rfftfreq(160)[None, :]
    smooth = np.fft.irfft2(
        np.fft.rfft2(noise) * np.exp(-2 * np.pi**2 * 9.0 * (along**2 + across**2)), s=noise.shape
    )
    fields = np.stack([smooth[0::2], smooth[1::2]]).astype(np.float32)
    bins = bins_of(128, 160, 2.0)
    spectra = cross_spectra(fields, np.array([0, 1]), bins)
    own = 0.5 * (spectra[:, 0, 0] + spectra[:, 1, 1])
    low = np.hypot(bins.column_cy_per_px, bins.row_cy_per_px) < 0.1
    assert spectra[low, 0, 1] / own[low] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("interlaced", [False, True])
def test_one_pass_over_bands_of_rows_gives_the_spectra_of_the_whole_fluctuations(seed, interlaced):
    """The modes of the last exposure of each parity are found from the others' and are its own."""
    rng = np.random.default_rng(seed)
    data = rng.poisson(300.0, (5, 144, 200)).astype(np.uint16) + rng.poisson(
        50.0, (144, 200)
    ).astype(np.uint16)
    order = order_of(np.arange(5), interlaced=interlaced)
    fields = split_fields(data, order.row_step)
    rows, cols = fields[0].shape[1:]
    bins = bins_of(rows, cols, 1.0 + interlaced)
    change = np.stack(fields, axis=1).reshape(-1, rows, cols).astype(np.float32)
    change -= change.mean(axis=(1, 2), keepdims=True)
    for parity in set(order.parity):
        change[order.parity == parity] -= change[order.parity == parity].mean(axis=0)
    whole = cross_spectra(change * np.sqrt(rows * cols / (rows * cols - 1.0)), order.parity, bins)
    parts = pixel_sums(data, order, bins).spectra
    assert parts == pytest.approx(whole, abs=1e-3 * np.abs(whole).max())
