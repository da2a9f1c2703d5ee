"""Images of a point through aberrated pupils, in plain NumPy: the pupil's autocorrelation, pixel
by pixel.
"""

from math import factorial

import numpy as np

SAMPLES = 96


def zernike(order, azimuth, radius, angle):
    """Return a Zernike polynomial of unit rms over the disc (Noll 1976, doi
    10.1364/JOSA.66.000207).
    """
    m = abs(azimuth)
    radial = sum(
        (-1) ** k
        * factorial(order - k)
        / (factorial(k) * factorial((order + m) // 2 - k) * factorial((order - m) // 2 - k))
        * radius ** (order - 2 * k)
        for k in range((order - m) // 2 + 1)
    )
    if azimuth == 0:
        return np.sqrt(order + 1.0) * radial
    turn = np.cos(m * angle) if azimuth > 0 else np.sin(m * angle)
    return np.sqrt(2.0 * (order + 1.0)) * radial * turn


def transfer_of_pupil(cut_off, waves=None, *, hole=0.0, square=False):
    """Return the transfer on a grid, shape (2 n, 2 n), and its step, cy/px.

    `waves`: rms of each (order, azimuth), waves; `hole`: diameter of the obscuration over that of
    the pupil.
    """
    fine = 5
    grid = (np.arange(SAMPLES * fine) + 0.5) * 2.0 / (SAMPLES * fine) - 1.0
    radius = np.hypot(grid, grid[:, None])
    inside = np.ones_like(radius) if square else (radius <= 1.0) & (radius >= hole)
    shape = SAMPLES, fine, SAMPLES, fine
    amplitude = inside.astype(float).reshape(shape).mean(axis=(1, 3))
    at = (np.arange(SAMPLES) + 0.5) * 2.0 / SAMPLES - 1.0
    polar = np.hypot(at, at[:, None]), np.arctan2(at[:, None], at)
    path = sum((rms * zernike(*index, *polar) for index, rms in (waves or {}).items()), 0.0)
    pupil = amplitude * np.exp(2j * np.pi * path)
    power = np.abs(np.fft.fft2(pupil, (2 * SAMPLES, 2 * SAMPLES))) ** 2
    transfer = np.fft.fftshift(np.fft.ifft2(power))
    return transfer / transfer[SAMPLES, SAMPLES], cut_off / SAMPLES


def image_of(transfer, step, size, col_px=0.0, row_px=0.0):
    """Return the image of a point through square pixels, unit light, shape (size, size)."""
    f = (np.arange(2 * SAMPLES) - SAMPLES) * step
    at = np.arange(size) - size // 2
    seen = transfer * np.sinc(f) * np.sinc(f)[:, None]
    along = np.exp(2j * np.pi * f[:, None] * (at - col_px))
    down = np.exp(2j * np.pi * (at - row_px)[:, None] * f)
    return (down @ seen @ along).real * step**2


def mtf50_of(transfer, step):
    """Return MTF50 with the pixel along rows and along columns, cy/px."""
    f = np.arange(SAMPLES) * step
    out = []
    for line in (transfer[SAMPLES, SAMPLES:], transfer[SAMPLES:, SAMPLES]):
        modulus = np.abs(line) * np.sinc(f)
        first = int(np.argmax(modulus < 0.5))
        high, low = modulus[first - 1], modulus[first]
        out.append(float(f[first - 1] + (high - 0.5) / (high - low) * step))
    return out


def codes_of(image, peak_e, rng, *, frames=1, read_e=5.0, black_dn=200.0):
    """Return frames of photons and read noise, 1 DN per electron, shape (frame, row, col)."""
    mean = np.maximum(image, 0.0) * (peak_e / image.max())
    shape = frames, *image.shape
    electrons = rng.poisson(np.broadcast_to(mean, shape)) + rng.normal(0.0, read_e, shape)
    return np.clip(np.rint(black_dn + electrons), 0, 65535).astype(np.uint16)
