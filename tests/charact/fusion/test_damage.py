"""A hundred damaged cases: each is flagged or refused; sound ones are not."""

from dataclasses import replace

import numpy as np
import pytest

from charact.frames.noise_law import NoiseLaw
from charact.fusion import fuse
from labdata import BadInput
from tests.truth.fusion import Pair, bands_of

SEEDS = range(1, 8)


@pytest.fixture(scope="module")
def sound() -> dict[int, tuple]:
    """Bands with walls that both see, without lamps and so without a map, by seed."""
    found = {}
    for seed in SEEDS:
        pair = Pair(seed=seed, buildings=2.0, lamp_pe=0.0, flood_pe=0.0)
        found[seed] = bands_of(pair, pair.frames(np.random.default_rng(seed)), with_map=False)
    return found


def is_caught(damage, bands) -> bool:
    """Whether damaged bands are refused or their picture is flagged."""
    try:
        return fuse(damage(*bands)).measurements[0].status == "suspect"
    except BadInput:
        return True


def shifted(band, rows: int, cols: int):
    return replace(band, image=np.roll(band.image, (rows, cols), axis=(0, 1)))


def with_pixel(band, value: float):
    image = band.image.copy()
    image[20, 30] = value
    return replace(band, image=image)


DAMAGES = {
    "shift of 2 columns": lambda v, t: (v, shifted(t, 0, 2)),
    "shift of 2 rows": lambda v, t: (v, shifted(t, -2, 0)),
    "shift of 4": lambda v, t: (v, shifted(t, 3, 3)),
    "unknown gain": lambda v, t: (replace(v, noise=None), t),
    "gain of twice": lambda v, t: (
        replace(v, noise=replace(v.noise, gain_dn=2.0 * v.noise.gain_dn)),
        t,
    ),
    "gain of half": lambda v, t: (
        replace(v, noise=replace(v.noise, gain_dn=0.5 * v.noise.gain_dn)),
        t,
    ),
    "wrong NETD": lambda v, t: (v, replace(t, noise=NoiseLaw(gain_dn=0.0, read_dn=0.1))),
    "unequal sizes": lambda v, t: (v, replace(t, image=t.image[:-1])),
    "one name": lambda v, t: (v, replace(t, name=v.name)),
    "gain of 4 times": lambda v, t: (
        replace(v, noise=replace(v.noise, gain_dn=4.0 * v.noise.gain_dn)),
        t,
    ),
    "a missing pixel": lambda v, t: (with_pixel(v, np.nan), t),
    "an infinite pixel": lambda v, t: (v, with_pixel(t, np.inf)),
    "another size": lambda v, t: (replace(v, image=v.image[:, 8:]), t),
    "a dark level of 20 DN too little": lambda v, t: (replace(v, image=v.image - 20.0), t),
    "a tenth clipped": lambda v, t: (
        replace(v, image=np.where(np.arange(320) < 40, v.clip, v.image)),
        t,
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_pair_is_flagged_or_refused(sound, damage: str) -> None:
    missed = [seed for seed, bands in sound.items() if not is_caught(DAMAGES[damage], bands)]
    assert not missed


def test_a_sound_pair_is_not_flagged(sound) -> None:
    flags = {seed: fuse(bands).measurements[0].flags for seed, bands in sound.items()}
    assert not any(flags.values()), flags


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(pair, value: float) -> None:
    image = np.zeros((240, 320))
    image[5, 5] = value
    with pytest.raises(BadInput, match="every pixel must be finite"):
        bands_of(pair, (image, np.zeros_like(image)), with_map=False)


def test_one_band_and_an_empty_span_are_refused(bands) -> None:
    with pytest.raises(BadInput, match="two bands or more"):
        fuse(bands[:1])
    with pytest.raises(BadInput, match="wider than 0"):
        fuse(bands, spans={"visible": (3.0, 3.0)})
    with pytest.raises(BadInput, match="one of the bands"):
        fuse(bands, spans={"red": (0.0, 3.0)})
