"""Edges and bars of others: the files of the cases, and siblings drawn here with their truth
in closed form.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import erf

from charact.estimators.mtf import measure, measure_all
from charact.frames.clipping import is_clipped
from charact.method import Context
from labdata import Array, FrameStack, Measurement, read_frames
from tests.truth import BlurOf, EdgeScene, TrueBlur

# Edges that others made: the files of the cases, and siblings drawn here with their truth in
# closed form.


ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT.parent / "shared" / "cases"
BURNS = ROOT.parent / "shared" / "data" / "burns_sfrmat3"
QUICK = Context(quick=True)


def frames_of(path, **options):
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    return read_frames(path, **options)


def mtf50_of(stack, method="auto"):
    return measure("edge", stack, method=method, context=QUICK).find("mtf50")[0]


def diffraction(cut_off):
    """Transfer of a clear pupil in focus, 2/pi (acos v - v sqrt(1 - v^2))."""

    def transfer(f):
        v = np.minimum(f / cut_off, 1.0)
        return 2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v))

    return transfer


def gaussian(sigma_px):
    return TrueBlur(sigma_px=sigma_px).before_pixel


def drawn(transfer, angle_deg, rows=150, cols=140, shift=0.3):
    """Edge from 0 to 1 of a blur and square pixels, and its MTF50 along the normal."""
    pose = {"rows": rows, "cols": cols, "angle_deg": angle_deg, "offset_px": shift}
    levels = {"dark_dn": 0.0, "bright_dn": 1.0, "black_dn": 0.0}
    scene = EdgeScene(blur=BlurOf(of=transfer), **pose, **levels)
    return scene.mean(), scene.truth_mtf50


def recorded(
    edge, seed, *, bits=12, full_well_e=1e4, read_noise_e=4.0, levels=(0.1, 0.7), frames=1
):
    """Frames with photon and read noise in whole codes."""
    rng = np.random.default_rng(seed)
    top = 2.0**bits - 1.0
    electrons = (levels[0] + (levels[1] - levels[0]) * edge) * full_well_e
    noisy = rng.poisson(electrons, (frames, *edge.shape)) + rng.normal(
        0.0, read_noise_e, (frames, *edge.shape)
    )
    return np.clip(np.rint(noisy * top / full_well_e), 0, top).astype(
        np.uint8 if bits == 8 else np.uint16
    )


def holds(found, truth):
    low, high = found.interval95
    return low <= truth <= high


def test_a_diffraction_limited_edge_at_135_degrees():
    found = mtf50_of(frames_of(CASES / "g1-edge-at-135" / "e.tif"))
    assert found.status == "ok"
    assert holds(found, 0.2012)
    assert found.interval95[1] - found.interval95[0] < 0.006


@pytest.mark.parametrize("angle_deg", [5.0, 45.0, 225.0])
def test_diffraction_at_any_angle(angle_deg):
    edge, truth = drawn(diffraction(0.45), angle_deg)
    founds = [mtf50_of(FrameStack(data=recorded(edge, seed, bits=10))) for seed in range(3)]
    assert all(one.status == "ok" for one in founds), [one.flags for one in founds]
    assert sum(holds(one, truth) for one in founds) >= 2
    assert abs(np.mean([one.value for one in founds]) / truth - 1.0) < 0.01


@pytest.mark.parametrize("angle_deg", [135.0])
def test_the_slanted_edge_method_at_45_degrees_where_most_of_its_bins_are_empty(angle_deg):
    edge, truth = drawn(gaussian(0.8), angle_deg, 180, 170)
    found = mtf50_of(FrameStack(data=recorded(edge, 3)), "edge-slanted")
    assert found.status == "ok"
    assert abs(found.value / truth - 1.0) < 0.03


def test_a_clean_12_bit_edge_is_ok():
    found = mtf50_of(frames_of(CASES / "m3-clean-12-bit-edge" / "e.tif"))
    assert found.status == "ok"
    assert found.value == pytest.approx(0.1251, abs=5e-4)
    assert holds(found, 0.1249)


@pytest.mark.parametrize("bits", [8, 16])
def test_clean_edges_of_other_depths_are_ok(bits):
    edge, truth = drawn(gaussian(1.3), 7.0)
    found = mtf50_of(FrameStack(data=recorded(edge, bits, bits=bits, frames=4)))
    assert found.status == "ok", found.flags
    assert abs(found.value / truth - 1.0) < 0.01


def test_clipping_of_a_left_shifted_picture_is_named():
    stack = frames_of(CASES / "l1-clipped-left-shifted-12-bit" / "e.tif")
    shifted, plain = (
        mtf50_of(stack),
        mtf50_of(FrameStack(data=stack.data // 16, full_scale_dn=4095.0)),
    )
    for found in (shifted, plain):
        assert "clipped" in found.flags
        assert any(
            note.startswith("clipped: ") and ("65520" in note or "4095" in note)
            for note in found.notes
        )


@pytest.mark.parametrize("kind", ["left-shifted", "float", "below the top"])
@pytest.mark.parametrize("cut", [0.6, 0.66])
def test_clipping_at_the_data_s_own_ceiling(kind, cut):
    edge, _ = drawn(gaussian(1.2), 5.0)
    data = np.minimum(recorded(edge, 1), np.uint16(cut * 4095))
    data = {"left-shifted": data * np.uint16(16), "float": data / 4095.0, "below the top": data}[
        kind
    ]
    assert is_clipped(data, None)


@pytest.mark.parametrize("kind", ["float", "rounded", "averaged"])
def test_the_flat_plateau_of_a_picture_without_noise_is_no_clipping(kind):
    """Blurred so little that both plateaus are one value each, as simulated and much averaged
    pictures are.
    """
    edge, truth = drawn(gaussian(0.7), 5.0)
    data = 400.0 + 2000.0 * edge
    if kind == "averaged":
        data = recorded(edge, 4, frames=100).mean(axis=0)
    data = np.rint(data) if kind == "rounded" else data
    found = mtf50_of(FrameStack(data=data[None]))
    assert "clipped" not in found.flags
    assert abs(found.value / truth - 1.0) < 0.01


@pytest.mark.parametrize("amount", [0.5])
def test_a_sharpened_edge_is_told(amount):
    from scipy.ndimage import gaussian_filter

    edge, _ = drawn(gaussian(1.1), 8.0)
    plain = recorded(edge, 2).astype(float)
    sharpened = np.rint(plain + amount * (plain - gaussian_filter(plain, (0.0, 1.2, 1.2))))
    assert "processed" not in mtf50_of(FrameStack(data=plain)).flags
    for method in ("auto", "edge-slanted"):
        found = mtf50_of(FrameStack(data=sharpened), method)
        assert "processed" in found.flags
        assert any(note.startswith("processed: ") for note in found.notes)


def test_where_no_form_fits_the_answer_needs_none_and_is_wider():
    """Light smeared evenly over 4 px along the normal, as a target that moves through the exposure
    has it.
    """
    transfer = lambda f: gaussian(0.5)(f) * np.sinc(4.0 * f)  # noqa: E731
    edge, truth = drawn(transfer, 6.0)
    stack = FrameStack(data=recorded(edge, 5, frames=4))
    assert "model-misfit" in mtf50_of(stack, "edge-parametric").flags
    found = mtf50_of(stack)
    assert found.method == "edge-free"
    assert found.status == "ok"
    assert holds(found, truth)


@pytest.mark.parametrize(("plane", "theirs"), [("g", 0.1978), ("b", 0.1946)])
def test_burns_edge_explains_gamma_and_its_number_is_his(plane, theirs):
    stack = frames_of(BURNS / "h_edge.tif", plane=plane)
    assert mtf50_of(stack, "edge-slanted").value == pytest.approx(theirs, rel=0.01)
    found = mtf50_of(stack)
    assert found.value == pytest.approx(theirs, rel=0.01)
    assert found.status == "ok"
    said = [note for note in found.notes if note.startswith("gamma: ")]
    assert said
    assert all("at most" in note and "linear frames" in note for note in said)


def test_stating_less_never_earns_a_better_verdict():
    edge, _ = drawn(gaussian(1.0), 5.0)
    stack = FrameStack(data=recorded(edge, 6))
    stated = replace(stack, black_level_dn=0.0, full_scale_dn=4095.0)
    assert mtf50_of(stated).status == mtf50_of(stack).status == "ok"


# Bars of others: a region alone is enough, bright or dark, any number, any direction, however
# little noise.


SIGMA_PX = 0.9
# Fine samples of a pixel along each side.
FINE = 5


def bars_of(
    number: int,
    frequency: float,
    angle_deg: float,
    length_periods: float,
    *,
    sigma_px: float = SIGMA_PX,
) -> Array:
    """Bars under a Gaussian blur, integrated over square pixels, 1 on a wide bar, with ground all
    around.
    """
    angle, step = np.deg2rad(angle_deg), sigma_px * np.sqrt(2.0)
    margin_px = max(30.0, 1.5 / frequency)
    width, length = number / frequency, length_periods / frequency
    shape = (
        int(width * abs(np.sin(angle)) + length * abs(np.cos(angle)) + 2 * margin_px),
        int(width * abs(np.cos(angle)) + length * abs(np.sin(angle)) + 2 * margin_px),
    )
    row, col = (
        ((np.arange(side * FINE) + 0.5) / FINE - 0.5) - (side - 1) / 2 - 0.3 for side in shape
    )
    across = col[None, :] * np.cos(angle) + row[:, None] * np.sin(angle)
    along = row[:, None] * np.cos(angle) - col[None, :] * np.sin(angle)

    def slab(distance: Array, size: float) -> Array:
        return 0.5 * (erf((distance + size / 2) / step) - erf((distance - size / 2) / step))

    places = (np.arange(number) - (number - 1) / 2) / frequency
    image = sum(slab(across - place, 0.5 / frequency) for place in places) * slab(along, length)
    return image.reshape(shape[0], FINE, shape[1], FINE).mean(axis=(1, 3))


def mtf_of(frequency: float, angle_deg: float) -> float:
    """Gaussian times the mean of a pixel's samples across the bars."""
    angle = np.deg2rad(angle_deg)
    along, across = frequency * np.cos(angle), frequency * np.sin(angle)
    pixel = np.sinc(along) * np.sinc(across) / (np.sinc(along / FINE) * np.sinc(across / FINE))
    return float(np.exp(-2.0 * (np.pi * frequency * SIGMA_PX) ** 2) * pixel)


def measured_bars(frames: Array, **said) -> Measurement:
    """Measure frames of which hardly more than a region is said."""
    context = Context(seed=1, quick=True)
    region = (0, 0, *frames.shape[1:])
    return measure(
        "bars", FrameStack(data=frames), region=region, context=context, **said
    ).measurements[0]


def holds_within_twice(found: Measurement, truth: float) -> bool:
    """Tell whether a number is ok and its truth within twice the half width of its interval."""
    return found.status == "ok" and abs(found.value - truth) < np.ptp(found.interval95)


def test_a_region_alone_is_enough() -> None:
    stack = frames_of(CASES / "j1-bars-roi-only" / "b.tif")
    for said in ({}, {"bars": 3}):
        found = measure("bars", stack, region=(20, 20, 56, 56), context=QUICK, **said).measurements[
            0
        ]
        assert found.status == "ok"
        assert found.frequency_cy_per_px == pytest.approx(0.1, rel=0.005)
        assert found.value == pytest.approx(0.641, abs=0.004)
    (whole,) = measure_all("bars", stack, context=QUICK).find("mtf")
    assert whole.value == pytest.approx(0.641, abs=0.006) and whole.status == "ok"


@pytest.mark.parametrize(
    ("number", "frequency", "angle_deg", "length_periods", "dark"),
    [
        (3, 0.06, 0.0, 2.5, True),
        (3, 0.11, 17.0, 2.5, True),
        (7, 0.2, 4.0, 7.0, True),
        (11, 0.17, 115.0, 6.0, False),
    ],
)
def test_any_number_of_dark_or_bright_bars_of_any_length(
    number, frequency, angle_deg, length_periods, dark, seed
) -> None:
    """USAF-1951-like, STANAG-like, ISO-12233-like: the number counted, the frequency to a percent,
    the MTF in place.
    """
    light = bars_of(number, frequency, angle_deg, length_periods)
    light = 0.1 + 0.7 * (1.0 - light if dark else light)
    rng, full_scale_dn = np.random.default_rng([seed, number]), 4095 if dark else 255
    frames = np.rint(full_scale_dn * (light + 0.01 * rng.standard_normal((2, *light.shape))))
    found = measured_bars(frames.astype(np.uint16))
    assert holds_within_twice(found, mtf_of(frequency, angle_deg)), (
        found.value,
        found.flags,
        found.reason,
    )
    assert found.frequency_cy_per_px == pytest.approx(frequency, rel=0.01)
    assert found.provenance.settings["bars"] == number


@pytest.mark.parametrize(
    ("dark", "kind"), [(False, np.uint16), (True, float)], ids=["bright codes", "dark"]
)
def test_the_plateau_of_bars_without_noise_is_no_clipping(dark: bool, kind: type) -> None:
    light = bars_of(3, 0.05, 5.0, 2.5)
    light = 300.0 + 2000.0 * (1.0 - light if dark else light)
    found = measured_bars((np.rint(light) if kind is np.uint16 else light)[None].astype(kind))
    assert "clipped" not in found.flags
    assert found.value == pytest.approx(mtf_of(0.05, 5.0), rel=0.005)


def test_wings_of_a_second_gaussian_are_no_sharpening(seed: int) -> None:
    """A core and a tenth to a quarter of the light in one three times as wide: 1.7 % low, and
    `processed`, before.
    """
    rng, truth_of = np.random.default_rng(seed), np.array([0.08, 0.13])
    for frequency, share in zip(truth_of, (0.12, 0.25), strict=True):
        core, wing = (bars_of(4, frequency, 0.0, 3.5, sigma_px=sigma_px) for sigma_px in (0.9, 2.7))
        light = (1.0 - share) * core + share * wing
        frames = np.rint(400.0 + 2500.0 * light + 20.0 * rng.standard_normal((4, *light.shape)))
        found = measured_bars(frames.astype(np.uint16))
        weights = np.exp(-2.0 * (np.pi * frequency * np.array([0.9, 2.7])) ** 2)
        pixel = np.sinc(frequency) / np.sinc(frequency / FINE)
        truth = float(pixel * ((1.0 - share) * weights[0] + share * weights[1]))
        assert holds_within_twice(found, truth), (found.value, truth, found.flags)


def test_a_wave_that_fills_its_region_a_spot_and_noise_are_no_bars(seed: int) -> None:
    rng, (row, col) = np.random.default_rng(seed), np.mgrid[:90, :100]
    pictures = (
        0.5 + 0.5 * np.sin(0.6 * col + 0.1 * row),
        np.exp(-((row - 45) ** 2 + (col - 50) ** 2) / 18.0),
        0.5 * (1.0 + np.tanh(col - 50 - 0.1 * row)),
        np.zeros(row.shape),
    )
    for picture in pictures:
        found = measured_bars(
            (400.0 + 1000.0 * picture + 20.0 * rng.standard_normal((3, 90, 100))).astype(np.uint16)
        )
        assert found.status != "ok", (found.value, found.notes)
