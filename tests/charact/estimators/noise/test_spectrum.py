"""In the noise spectrum rows of both parities are laid on one picture."""

import numpy as np
import pytest

from charact.frames.spectrum import along_rows, bins_of, modes_of, products_of


def cross_spectra(change, parity, bins):
    """Mean products of the modes of fluctuations in every bin."""
    modes = [
        modes_of(along_rows(image, 0, bins), int(odd), bins)
        for image, odd in zip(change, parity, strict=True)
    ]
    return products_of(np.array(modes), bins)


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
