"""Colours by a table: materials have the colour of daylight, whatever the noise, and the deviation
is stated.
"""

import numpy as np
import pytest

from charact.frames.noise_law import NoiseLaw
from charact.fusion import Band, ColourTable, fuse_by_table, make_colour_table
from labdata import BadInput

SHAPE = (96, 128)
# Number of a material: daylight colour, visible and thermal level.
GRASS, ROAD, WALL = 1, 2, 5
COLOURS = {GRASS: (0.2, 0.5, 0.1), ROAD: (0.4, 0.4, 0.45), WALL: (0.7, 0.5, 0.3)}
LEVELS = {GRASS: (40.0, 280.0), ROAD: (20.0, 290.0), WALL: (60.0, 295.0)}
ALIKE = {GRASS: (40.0, 285.0), ROAD: (36.0, 284.5), WALL: (60.0, 295.0)}


@pytest.fixture
def materials() -> np.ndarray:
    out = np.full(SHAPE, GRASS)
    out[:, 40:80] = ROAD
    out[20:70, 90:120] = WALL
    return out


def bands_of(
    materials: np.ndarray, rng: np.random.Generator, sd: float, levels=LEVELS
) -> list[Band]:
    images = [np.vectorize(lambda number, k=k: levels[number][k])(materials) for k in range(2)]
    laws = [NoiseLaw(gain_dn=0.0, read_dn=max(scale * sd, 1e-3)) for scale in (4.0, 1.0)]
    return [
        Band(name=name, image=image + law.read_dn * rng.normal(size=SHAPE), noise=law)
        for name, image, law in zip(("visible", "thermal"), images, laws, strict=True)
    ]


def test_materials_have_their_daylight_colour(materials, tmp_path) -> None:
    rng = np.random.default_rng(0)
    make_colour_table(bands_of(materials, rng, 0.0), materials, COLOURS).save(
        tmp_path / "table.npz"
    )
    table = ColourTable.load(tmp_path / "table.npz")
    noisy = bands_of(materials, rng, 1.0)
    found = fuse_by_table(noisy, table)
    for number, colour in COLOURS.items():
        assert found.picture[materials == number].mean(axis=0) == pytest.approx(colour, abs=0.05)
    assert found.share.sum(axis=0) == pytest.approx(1.0, abs=1e-5)


def test_the_deviation_is_no_less_than_that_of_repeated_frames(materials) -> None:
    rng = np.random.default_rng(1)
    table = make_colour_table(bands_of(materials, rng, 0.0, ALIKE), materials, COLOURS)
    found = [fuse_by_table(bands_of(materials, rng, 1.0, ALIKE), table) for _ in range(12)]
    spread = np.stack([one.picture for one in found]).std(axis=0, ddof=1)
    ratio = spread.mean() / np.mean([one.sd for one in found])
    # Colours are taken around noisy values instead of true ones: the stated deviation is up to
    # twice too large.
    assert 0.4 < ratio < 1.1 and spread.mean() > 0.01


def test_a_table_that_does_not_fit_is_refused(materials, tmp_path) -> None:
    rng = np.random.default_rng(2)
    bands = bands_of(materials, rng, 0.0)
    with pytest.raises(BadInput, match="got none"):
        make_colour_table(bands, materials, {9: (0.0, 0.0, 0.0)})
    with pytest.raises(BadInput, match="of two bands"):
        fuse_by_table(bands[:1], make_colour_table(bands, materials, COLOURS))
    with pytest.raises(BadInput, match="of colours and spans"):
        ColourTable.load(tmp_path / "absent.npz")
