"""Edges that users of other tools reported: a comatic lens, hot pixels, uneven light, bent edges;
and siblings drawn here by transfers, a Fourier transform and noise.
"""

from pathlib import Path

import numpy as np
import pytest

from charact.estimators import mtf
from charact.method import Context
from labdata import FrameStack, read_frames

CASES = Path(__file__).resolve().parents[2].parent / "shared" / "cases"
# Fine samples of an edge: their number and spacing, px, and frequencies, cy/px.
SAMPLES, FINE_PX = 2**15, 0.02
F = np.fft.rfftfreq(SAMPLES, FINE_PX)


def gaussian(sigma):
    return np.exp(-2.0 * (np.pi * sigma * F) ** 2) + 0j


def one_sided(length):
    """Transfer of a spread exp(-x / length) on one side, as of trailing charge; px."""
    return 1.0 / (1.0 + 2j * np.pi * length * F)


def pupil(cut_off, defocus, coma, turned_deg):
    """Transfer across the edge of a circular pupil with Zernike errors in waves rms, by the
    transform of its spread.
    """
    size, padded = 256, 1024
    y, x = (np.mgrid[:size, :size] - size / 2 + 0.5) / (size / 2)
    radius2, along = x**2 + y**2, x * np.cos(np.deg2rad(turned_deg))
    along = along + y * np.sin(np.deg2rad(turned_deg))
    waves = defocus * np.sqrt(3.0) * (2.0 * radius2 - 1.0)
    waves = waves + coma * np.sqrt(8.0) * (3.0 * radius2 - 2.0) * along
    field = (radius2 <= 1.0) * np.exp(2j * np.pi * waves)
    transfer = np.fft.fft2(np.abs(np.fft.fft2(field, (padded, padded))) ** 2)[0]
    at = np.arange(padded // 2) * cut_off / size
    real, imaginary = (
        np.interp(F, at, part, right=0.0)
        for part in (transfer.real[: padded // 2], transfer.imag[: padded // 2])
    )
    return (real + 1j * imaginary) / transfer[0].real


def drawn(transfer, rng, *, angle_deg=5.0, shape=(140, 150), bits=12, contrast=0.6, snr=60.0, **to):
    """Frames of an edge with photon and read noise, and its MTF50 along the normal.

    Parameters
    ----------
    transfer
        Of the blur in front of the pixel, at `F`.
    snr
        Bright side over its noise.
    to
        What else is done: `sagitta_px`, `light` (a function of x and y from -1 to 1), `hot`
        (fraction of the pixels), `distortion` (of the picture's half height squared), `finish` (of
        the frame), `flat_noise` (a fraction of the bright side).
    """
    angle = np.deg2rad(angle_deg)
    transfer = transfer * np.sinc(F * np.cos(angle)) * np.sinc(F * np.sin(angle))
    spread = np.fft.fftshift(np.fft.irfft(transfer, SAMPLES))
    edge = np.cumsum(spread) - 0.5 * spread
    rows, cols = shape
    y, x = np.mgrid[:rows, :cols] - 0.5 * (np.array(shape)[:, None, None] - 1.0)
    distance = (x - 0.3) * np.cos(angle) + y * np.sin(angle)
    along = y * np.cos(angle) - x * np.sin(angle)
    bow = to.get("sagitta_px", 0.0) / (rows / 2.0) ** 2
    distance = (distance + bow * along**2) / np.hypot(1.0, 2.0 * bow * along)
    if (barrel := to.get("distortion", 0.0)) != 0.0:
        # The edge stands 300 px beside the middle of a picture of 600 px half height.
        across, strength = distance + 300.0, barrel / 600.0**2
        radius2 = across**2 + along**2
        steep = np.hypot(
            1.0 + strength * (radius2 + 2.0 * across**2), 2.0 * strength * across * along
        )
        straight = across * (1.0 + strength * radius2)
        distance = (straight - 300.0 * (1.0 + strength * 300.0**2)) / steep
    level = np.interp(distance, (np.arange(SAMPLES) - SAMPLES // 2) * FINE_PX, edge / spread.sum())
    full, black = 2.0**bits - 1.0, 0.04 * (2.0**bits - 1.0)
    bright = 0.7 * full
    dark = black + (bright - black) * (1.0 - contrast) / (1.0 + contrast)
    light = (dark + (bright - dark) * level - black) * to.get("light", lambda x, y: 1.0)(
        2.0 * x / cols, 2.0 * y / rows
    )
    per_electron, read = (bright - black) / snr**2, 2.0 * (bright - black) / snr**2
    variance = per_electron * np.maximum(light, 0.0) + read**2
    if "flat_noise" in to:
        variance = (to["flat_noise"] * (bright - black)) ** 2
    frame = rng.normal(black + light, np.sqrt(variance))
    number = rng.binomial(frame.size, to.get("hot", 0.0))
    heights = np.exp(rng.uniform(np.log(0.05), np.log(5.0), number))
    frame.flat[rng.integers(0, frame.size, number)] += (bright - dark) * heights
    frame = to.get("finish", lambda picture, black, full: picture)(frame, black, full)
    codes = np.clip(np.rint(frame), 0.0, full).astype(np.uint8 if bits == 8 else np.uint16)
    modulus = np.abs(transfer[: np.argmax(np.abs(transfer) < 0.5) + 1])
    truth = float(np.interp(-0.5, -modulus[-2:], F[modulus.size - 2 : modulus.size]))
    return FrameStack(data=codes[None]), truth


def mtf50(stack, method="auto", **context):
    return mtf.measure("edge", stack, method=method, context=Context(seed=3, **context)).find(
        "mtf50"
    )[0]


def off_by(found, truth):
    """Error in half-widths of the 95 % interval on its side."""
    low, high = found.interval95
    return (truth - found.value) / ((high if truth > found.value else low) - found.value)


def all_ok(drawings, percent, **context):
    """Measure drawings (stack, truth): all ok, none silent, most held, and not wider than said."""
    founds = [(mtf50(stack, **context), truth) for stack, truth in drawings]
    assert [found.status for found, _ in founds] == ["ok"] * len(founds), [
        (found.flags, found.notes) for found, _ in founds
    ]
    off = np.array([off_by(found, truth) for found, truth in founds])
    assert off.max() < 2.0 and np.count_nonzero(off > 1.0) <= 1, off
    halves = [
        50.0 * (found.interval95[1] - found.interval95[0]) / found.value for found, _ in founds
    ]
    assert max(halves) < percent, halves


@pytest.mark.parametrize("stated", [False, True], ids=["", "black stated"])
def test_a_comatic_edge_is_measured_and_is_no_response(stated):
    path = CASES / "hh1-comatic-edge" / "e.tif"
    if not path.is_file():
        pytest.skip("the case hh1-comatic-edge is not beside this checkout")
    stack = read_frames(path)
    if stated:
        stack = FrameStack(data=stack.data, black_level_dn=150.0)
    found = mtf50(stack)
    assert found.status == "ok"
    assert off_by(found, 0.1059) < 1.0
    assert found.interval95[1] - found.interval95[0] < 0.05 * found.value
    assert not any(note.startswith("gamma: ") for note in found.notes)


def test_one_sided_tails_are_no_response(seed):
    rng = np.random.default_rng([seed, 1])
    all_ok(
        [
            drawn(gaussian(0.8) * one_sided(length), rng, angle_deg=angle, bits=bits)
            for length, angle, bits in [
                (2.0, 5.0, 12),
                (-2.0, 5.0, 12),
                (1.2, 8.0, 10),
                (-1.2, -7.0, 8),
                (0.7, 97.0, 14),
                (-2.8, 176.0, 16),
            ]
        ],
        percent=6.0,
    )


def test_defocus_with_coma_is_no_response(seed):
    rng = np.random.default_rng([seed, 2])
    all_ok(
        [
            drawn(pupil(*lens), rng, angle_deg=angle, snr=snr)
            for lens, angle, snr in [
                ((0.8, 0.1, 0.15, 0.0), 5.0, 60.0),
                ((0.6, -0.1, 0.15, 180.0), 6.0, 40.0),
                ((0.9, 0.2, 0.1, 60.0), -4.0, 80.0),
                ((0.5, 0.0, 0.2, 120.0), 9.0, 60.0),
            ]
        ],
        percent=9.0,
    )


def test_hot_pixels_widen_at_most(seed):
    """One pixel in 2,000 stands .05 to 5 steps above the others, on plateaus and on the slope."""
    rng = np.random.default_rng([seed, 3])
    all_ok(
        [
            drawn(gaussian(sigma), rng, hot=5e-4, bits=bits, shape=shape)
            for sigma, bits, shape in [
                (0.6, 12, (140, 150)),
                (1.4, 12, (100, 110)),
                (1.0, 8, (200, 160)),
                (1.0, 14, (120, 220)),
                (0.8, 10, (160, 160)),
            ]
        ],
        percent=5.0,
    )


LIGHTS = {
    "5 % across": lambda x, y: 1.0 + 0.025 * x,
    "20 % across": lambda x, y: 1.0 - 0.1 * x,
    "10 % along": lambda x, y: 1.0 + 0.05 * y,
    "20 % oblique": lambda x, y: 1.0 + 0.07 * (x - y),
    "vignetted": lambda x, y: 1.0 - 0.1 * ((x - 0.5) ** 2 + y**2),
}


def test_light_that_slopes_widens_at_most(seed):
    rng = np.random.default_rng([seed, 4])
    all_ok([drawn(gaussian(1.0), rng, light=light) for light in LIGHTS.values()], percent=8.0)


def test_bent_edges_keep_their_mtf(seed):
    """A straight line through them lowers MTF50 by 3 to 10 %."""
    rng = np.random.default_rng([seed, 5])
    bends = [{"sagitta_px": sagitta} for sagitta in (1.0, -2.0, 3.0)]
    bends += [{"distortion": distortion} for distortion in (-0.04, 0.03)]
    drawings = [drawn(gaussian(0.8), rng, **bend) for bend in bends]
    all_ok(drawings, percent=4.0)
    # The standard's line stays straight; it says so.
    slanted = mtf50(drawings[2][0], "edge-slanted")
    assert any(note.startswith("curved-edge: ") for note in slanted.notes)
    assert slanted.value < 0.97 * drawings[2][1]


def disc(rng, *, radius, size, sigma=1.2, inside=True, place=(0.3, -0.4), oval=0.0, light=None):
    """A bright or dark disc on even ground by sums over sixths of a pixel, blurred by a transform,
    and its MTF50 along the axes.
    """
    fine = 6
    at = (np.arange(size * fine) + 0.5) / fine - 0.5 * size
    x, y = at - place[0], (at - place[1])[:, None]
    inner = np.hypot(x * (1.0 + oval), y * (1.0 - oval)) < radius
    f = np.fft.fftfreq(size * fine, 1.0 / fine)
    blur = np.exp(-2.0 * (np.pi * sigma) ** 2 * (f**2 + f[:, None] ** 2))
    level = np.fft.ifft2(np.fft.fft2(inner == inside) * blur).real
    level = level.reshape(size, fine, size, fine).mean(axis=(1, 3))
    y, x = np.mgrid[-1.0 : 1.0 : size * 1j, -1.0 : 1.0 : size * 1j]
    electrons = (200.0 + 2000.0 * level) * (1.0 if light is None else light(x, y))
    codes = np.rint(rng.normal(100.0 + electrons, np.sqrt(electrons + 25.0)))
    at = np.linspace(0.001, 0.6, 6000)
    modulus = np.exp(-2.0 * (np.pi * sigma * at) ** 2) * np.sinc(at)
    return FrameStack(data=codes.astype(np.uint16)[None]), float(at[np.argmax(modulus < 0.5)])


def test_the_rim_of_a_disc_is_an_edge():
    path = CASES / "z1-disc-phantom" / "disc.tif"
    if not path.is_file():
        pytest.skip("the case z1-disc-phantom is not beside this checkout")
    found = mtf50(read_frames(path))
    assert found.status == "ok"
    assert off_by(found, 0.152) < 1.0 and found.value == pytest.approx(0.152, rel=0.01)


def test_rims_of_other_discs(seed):
    """Other radii, dark on bright ground, oval, in light that slopes: 1 % and ok."""
    rng = np.random.default_rng([seed, 9])
    all_ok(
        [
            disc(rng, radius=30.0, size=110),
            disc(rng, radius=70.0, size=200, sigma=0.8),
            disc(rng, radius=40.0, size=130, inside=False),
            disc(rng, radius=50.0, size=150, oval=0.02),
            disc(rng, radius=45.0, size=140, light=lambda x, y: 1.0 + 0.05 * x - 0.04 * y),
        ],
        percent=5.0,
    )


def test_a_square_is_no_disc(seed):
    """Its corners are no rim: one of its sides is measured, or nothing."""
    y, x = np.mgrid[-70.0:70.0, -70.0:70.0]
    x, y = x * np.cos(0.1) + y * np.sin(0.1), y * np.cos(0.1) - x * np.sin(0.1)
    reach = 35.0 - np.maximum(np.abs(x), np.abs(y))
    mean = 300.0 + 2000.0 / (1.0 + np.exp(-np.clip(reach / 0.7, -40.0, 40.0)))
    data = np.random.default_rng(seed).normal(mean, 15.0)
    found = mtf50(FrameStack(data=np.rint(data).astype(np.uint16)[None]))
    assert not any("closed curve" in note for note in found.notes)


def sharpened(picture, black, full):
    padded, (rows, cols) = np.pad(picture, 1, mode="edge"), picture.shape
    blurred = sum(padded[i : i + rows, j : j + cols] for i in range(3) for j in range(3)) / 9.0
    return picture + 0.8 * (picture - blurred)


def encoded(picture, black, full):
    return full * np.clip((picture - black) / (full - black), 0.0, 1.0) ** (1.0 / 2.2)


def clipped(picture, black, full):
    return np.minimum(picture, 0.62 * full)


@pytest.mark.parametrize("finish", [sharpened, encoded, clipped])
@pytest.mark.parametrize("transfer", [gaussian(0.9), gaussian(0.6) * one_sided(1.0)])
def test_a_doctored_edge_is_never_ok_and_wrong(finish, transfer, seed):
    for number, bits in enumerate((8, 12)):
        stack, truth = drawn(
            transfer, np.random.default_rng([seed, 6, number]), finish=finish, bits=bits
        )
        found = mtf50(stack)
        assert found.status != "ok" or off_by(found, truth) < 1.5, found
        if finish is not encoded:
            assert found.status == "suspect"


def test_noise_decides_what_asymmetry_means(seed):
    """The same tail under noise of light, and under noise that no light makes grow."""
    notes = []
    for more in ({}, {"flat_noise": 0.015}):
        for length in (-2.0, 2.0):
            transfer = gaussian(0.6) * one_sided(length)
            stack, truth = drawn(transfer, np.random.default_rng([seed, 7]), **more)
            found = mtf50(stack)
            assert found.status == "ok" and off_by(found, truth) < 1.5
            notes.append(any(note.startswith("gamma: ") for note in found.notes))
    assert notes[:2] == [False, False]
    assert sum(notes[2:]) == 1


def test_in_much_noise_the_answer_is_the_one_without_a_form(seed):
    for number in range(4):
        stack, truth = drawn(
            gaussian(0.9), np.random.default_rng([seed, 8, number]), snr=18.0, shape=(90, 90)
        )
        found = mtf50(stack)
        assert found.status == "ok" and off_by(found, truth) < 2.0
        assert found.method == "edge-free"
