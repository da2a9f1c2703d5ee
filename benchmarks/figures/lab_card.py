"""The lab scene of the pictures in these pages: a card with bars, a grey wedge, and a pinhole in a
dark field.
"""

import numpy as np
from numpy.typing import NDArray

from labdata import Camera
from simulate.radiance.cube import RadianceCube
from simulate.radiance.spectrum import LUMENS_PER_WATT, luminous_efficiency, planck

FRAME = (493, 768)
# Rows and columns of the frame that the pictures show; the card is a little larger.
SHOWN = (190, 210)
CARD = (206, 230)
PER_PIXEL = 4
WALL, BLACK, FIELD = 0.2, 0.03, 0.02
PINHOLE = 1000.0
PINHOLE_PX = 3.0
FREQUENCIES_CY_PER_PX = (0.06, 0.09, 0.13, 0.18, 0.25)
WEDGE = (0.5, 0.25, 0.125, 0.06, 0.03)
# Height of a row over the width of a column, of the camera the card was drawn for.
ROW_OVER_COLUMN = 13.0 / 11.0
WAVELENGTH_NM = np.arange(400.0, 1000.0, 50.0)
LAMP_K = 2856.0


def shown() -> tuple[slice, slice]:
    """Return the rows and columns of the frame that the pictures show."""
    (top, left), (rows, cols) = _corner(SHOWN), SHOWN
    return slice(top, top + rows), slice(left, left + cols)


def luminance(per_pixel: int = 1) -> NDArray[np.float32]:
    """Return the scene's luminance relative to the white of its card, shape (row, col), `per_pixel`
    cells a pixel.
    """
    scene = np.full([n * PER_PIXEL for n in FRAME], WALL, np.float32)
    (top, left), (rows, cols) = _corner(CARD), CARD
    scene[
        top * PER_PIXEL : (top + rows) * PER_PIXEL, left * PER_PIXEL : (left + cols) * PER_PIXEL
    ] = _card()
    block = PER_PIXEL // per_pixel
    return scene.reshape(scene.shape[0] // block, block, scene.shape[1] // block, block).mean(
        axis=(1, 3)
    )


def card(per_pixel: int = 1) -> NDArray[np.float32]:
    """Return the card alone, as `luminance` does the scene."""
    (top, left), (rows, cols) = (
        tuple(n * per_pixel for n in pair) for pair in (_corner(CARD), CARD)
    )
    return luminance(per_pixel)[top : top + rows, left : left + cols]


def radiance(sensor: Camera, picture: NDArray[np.floating], cathode_lux: float) -> RadianceCube:
    """Return a picture under light of 2856 K whose white gives an illuminance on the photocathode,
    on the axis.

    Parameters
    ----------
    sensor
        The camera, whose lens decides how bright the picture must be.
    picture
        Luminance relative to white, shape (row, col).
    cathode_lux
        Illuminance of white, lux.

    Notes
    -----
    E = pi tau L / (4 N^2), L = 683 int V L_e dl; veiling glare comes on top.
    """
    optics, fine = sensor.optics, np.arange(360.0, 1100.0)
    cd_per_m2 = (
        cathode_lux * 4.0 * float(optics.f_number) ** 2 / (np.pi * float(optics.transmission))
    )
    lamp_cd_per_m2 = LUMENS_PER_WATT * np.sum(luminous_efficiency(fine) * planck(fine, LAMP_K))
    spectrum = planck(WAVELENGTH_NM, LAMP_K) * (cd_per_m2 / lamp_cd_per_m2)
    return RadianceCube(
        wavelength_nm=WAVELENGTH_NM,
        radiance=spectrum.astype(np.float32)[:, None, None] * picture[None],
    )


def _corner(size: tuple[int, int]) -> tuple[int, int]:
    return (FRAME[0] - size[0]) // 2, (FRAME[1] - size[1]) // 2


def _card() -> NDArray[np.float32]:
    """The card on cells, its own corner a margin outside what is shown; positions below are in
    pixels of SHOWN.
    """
    margin = [(card - shown) // 2 for card, shown in zip(CARD, SHOWN, strict=True)]
    rows, cols = np.mgrid[: CARD[0] * PER_PIXEL, : CARD[1] * PER_PIXEL]
    y, x = (rows + 0.5) / PER_PIXEL - margin[0], (cols + 0.5) / PER_PIXEL - margin[1]
    card = np.ones(y.shape, np.float32)
    left = 8.0
    for frequency in FREQUENCIES_CY_PER_PX:
        size = 3.5 / frequency
        across = (x > left) & (x < left + size)
        card[across & _bars(x - left, frequency) & (y > 8.0) & (y < 34.0)] = BLACK
        card[across & _bars(y - 42.0, frequency)] = BLACK
        left += size + 7.0
    for step, level in enumerate(WEDGE):
        card[(x < 26.0) & (y > 106.0 + 17.0 * step) & (y < 123.0 + 17.0 * step)] = level
    # The dark field's left border is a slanted edge, five degrees off the columns.
    card[(x - 96.0 + np.tan(np.radians(5.0)) * (y - 147.0) > 0.0) & (y > 106.0)] = FIELD
    card[np.hypot(x - 155.0, (y - 150.0) * ROW_OVER_COLUMN) < 0.5 * PINHOLE_PX] = PINHOLE
    return card


def _bars(along: NDArray[np.floating], frequency: float) -> NDArray[np.bool_]:
    """Where four bars lie that begin at zero."""
    half_periods = np.floor(along * 2.0 * frequency)
    return (half_periods >= 0) & (half_periods < 7) & (half_periods % 2 == 0)
