"""A real CCD of known gain: an EMCCD at unit gain, 3 x 3 px (Ryan et al. 2021, 10.1038/s41598-021-97759-6)."""

from dataclasses import replace

import numpy as np
import pytest
import tifffile

from charact import noise
from charact.method import Context
from labdata.importers.sessions import import_frames

# The authors' fit.
PHOTOELECTRONS_PER_COUNT = 3.859
LEVELS = range(1, 7)


@pytest.fixture(scope="module")
def frames(shared_data):
    """All frames of every level, DN."""
    return [tifffile.imread(shared_data / "emccd_ryan2021" / f"1x-gain_level-0{level}.tif") for level in LEVELS]


@pytest.fixture(scope="module")
def gain(frames, tmp_path_factory):
    """The gain that we measure."""
    return gain_of(session_of(frames, tmp_path_factory.mktemp("whole")))


def session_of(frames, folder):
    """A session of flats, in files that open quickly."""
    files = [folder / f"level-{level}.npy" for level in LEVELS]
    for file, data in zip(files, frames, strict=False):
        np.save(file, data)
    return import_frames(files[: len(frames)], folder / "session", kind="flat", name_pattern=None)


def gain_of(session):
    (gain,) = noise.measure(session, method="variance", context=Context(seed=1, quick=True)).find("system_gain")
    return gain


def test_the_gain_of_a_real_ccd_is_what_its_authors_found(gain):
    assert gain.value == pytest.approx(1.0 / PHOTOELECTRONS_PER_COUNT, rel=0.025)
    # There are frames of no dark, and it is said.
    assert "no-darks" in gain.flags


def test_a_map_of_mean_bias_is_no_sample_of_dark_noise(frames, shared_data, tmp_path):
    """A mean of many darks does not change in time: given as a dark it is named, subtracts no noise and moves no slope.

    Gaussian frames made of the authors' bias and read-noise maps do not bring the gain to theirs either: 0.253.
    """
    session = session_of([stack[:500] for stack in frames[:3]], tmp_path)
    bias = import_frames([shared_data / "emccd_ryan2021" / "1x-gain_no-signal_S0.tif"], tmp_path / "bias",
                         kind="dark", name_pattern=None)  # fmt: skip
    without, with_map = (gain_of(one) for one in (session, replace(session, stacks=(*session.stacks, *bias.stacks))))
    assert with_map.value == pytest.approx(without.value, rel=1e-9)
    assert with_map.interval95 == pytest.approx(without.interval95, rel=1e-9)
    assert "no-darks" in with_map.flags
    assert any(bias.stacks[0].label in note for note in with_map.notes)


def test_their_recipe_gives_their_figure_and_without_the_lamp_s_drift_it_gives_ours(frames, gain, shared_data):
    """Each pixel by itself, the likelihood of Poisson electrons and Gaussian read noise about a known offset.

    Every change of the light counts as noise of electrons there. The brightest level, which weighs most, drifts.
    """
    offset, read = maps(shared_data)
    whole = per_count(frames, offset, read)
    assert whole == pytest.approx(PHOTOELECTRONS_PER_COUNT, rel=0.003)
    assert per_count(frames[:-1], offset, read) > 1.008 * whole
    steady = per_count([light_held(stack) for stack in frames], offset, read)
    assert steady > 1.012 * whole
    assert 1.0 / gain.value == pytest.approx(steady, rel=0.01)
    assert gain.interval95[0] < 1.0 / steady < gain.interval95[1]


def test_what_their_figure_counts_besides_is_no_noise_of_electrons(frames, shared_data):
    """Electrons of nine pixels in a hundred frames share nothing: their mean varies by 1/900 of a pixel's variance.

    At the brightest level it varies thirty times as much, by 0.08 % of the light.
    """
    offset, _ = maps(shared_data)
    ratio, rms = [], []
    for stack in frames:
        blocks = block_means(stack)
        shot = stack.var(axis=0, ddof=1).mean() / (BLOCK * stack[0].size)
        ratio.append(blocks.var(ddof=1) / shot)
        rms.append(np.sqrt(max(blocks.var(ddof=1) - shot, 0.0)) / (stack.mean() - offset.mean()))
    chance = np.sqrt(2.0 / (len(blocks) - 1))
    assert ratio[-1] > 1.0 + 100.0 * chance
    assert rms[-1] == pytest.approx(8e-4, rel=0.1)
    assert max(ratio[:4]) < 1.0 + 10.0 * chance


# Frames over which light is taken to be steady.
BLOCK = 100


def maps(shared_data):
    """The authors' offset and read noise of every pixel, DN."""
    folder = shared_data / "emccd_ryan2021"
    return tuple(tifffile.imread(folder / f"1x-gain_no-signal_{name}.tif").astype(float) for name in ("S0", "sigma"))


def block_means(frames):
    """Mean of all pixels of every hundred frames."""
    return frames.mean(axis=(1, 2)).reshape(-1, BLOCK).mean(axis=1)


def light_held(frames):
    """Frames whose light, the mean of every hundred, is that of the whole stack; whole counts as before."""
    blocks = np.repeat(block_means(frames), BLOCK)
    return np.rint(frames - (blocks - blocks.mean())[:, None, None])


def per_count(frames, offset, read):
    """Photoelectrons per count of the likeliest line through all levels, mean over the pixels."""
    from scipy.optimize import minimize_scalar

    def likeliest(values, offset_dn, read_dn):
        found = minimize_scalar(
            lambda per_count: sum(misfit(of_level, per_count, offset_dn, read_dn) for of_level in values),
            bounds=(3.5, 4.3), method="bounded", options={"xatol": 1e-3},
        )  # fmt: skip
        return found.x

    pixels = np.ndindex(*offset.shape)
    return np.mean([likeliest([stack[:, i, j] for stack in frames], offset[i, j], read[i, j]) for i, j in pixels])


def misfit(values, per_count, offset_dn, read_dn):
    """Minus the log likelihood of one pixel at one level, its light the one that gives the mean measured."""
    from scipy.special import gammaln

    electrons = (values.mean() - offset_dn) * per_count
    reach = int(8.0 * read_dn)
    first, last = int(values.min()), int(values.max())
    # Counts above the offset's whole part that read noise can bring to these.
    signal = np.arange(first - reach, last + reach + 1) - np.floor(offset_dn)
    charge = np.maximum(signal, 0.0) * per_count
    poisson = per_count * np.exp(charge * np.log(electrons) - electrons - gammaln(charge + 1.0)) * (signal >= 0)
    away = np.arange(-reach, reach + 1) - offset_dn % 1.0
    gauss = np.exp(-0.5 * (away / read_dn) ** 2) / (np.sqrt(2.0 * np.pi) * read_dn)
    density = np.convolve(poisson, gauss, "valid")
    return -np.log(density[values.astype(int) - first]).sum()
