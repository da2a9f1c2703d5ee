"""The bench gives the same frames for the same seed, and its targets cover their cells."""

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from labdata import BadInput, Conditions, Target, load_camera
from simulate import LabBench
from simulate.radiance import (
    RadianceCube,
    TargetView,
    load_scene,
    outline_cells,
    planck,
    render_bench,
    target_outlines,
)
from simulate.virtual_bench import true_sensor

# The bench gives the same frames for the same seed, in any order, and refuses what it cannot do.


LUX = Conditions(illuminance_lux=1e-4)


@pytest.fixture(scope="module")
def bench(plain) -> LabBench:
    return LabBench(plain(40, 60))


def test_same_seed_gives_same_bytes(bench):
    first, again = (bench.expose("edge", Target(), LUX, frames=2, seed=5).data for _ in range(2))
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != bench.expose("edge", Target(), LUX, frames=2, seed=6).data.tobytes()


def test_a_frame_follows_from_its_own_number(bench):
    run = bench.expose("flat", Target(), LUX, frames=5, seed=5)
    alone = bench.expose("flat", Target(), LUX, frames=1, seed=5, first_frame=3)
    assert run.data[3].tobytes() == alone.data[0].tobytes()
    assert alone.frame_number.tolist() == [3]
    assert alone.time_s[0] == pytest.approx(3 * 2 / 59.94)


@pytest.mark.parametrize(
    ("kind", "target"),
    [("bars", Target(frequency_cy_per_px=0.1)), ("point", Target(pinhole_px=2.0))],
    ids=["bars", "point"],
)
def test_frames_average_to_the_mean_image(bench, kind, target, seed):
    frames = bench.expose(kind, target, LUX, frames=48, seed=seed).data.astype(float)
    mean = bench.mean(kind, target, LUX)
    # Blocks of frames: the screen's glow ties neighbours together.
    blocks = (frames - mean).reshape(6, 8, *mean.shape).mean(axis=1)
    level = blocks.mean(axis=(1, 2))
    assert abs(level.mean()) < 4.5 * level.std(ddof=1) / np.sqrt(6) * 1.4 + 0.02
    spread = frames.std(axis=0, ddof=1)
    worst = np.abs(frames.mean(axis=0) - mean) / (spread / np.sqrt(48) * 1.6 + 0.3)
    assert np.quantile(worst, 0.99) < 4.5


def test_target_stands_where_its_region_says(bench):
    target = Target(pinhole_px=2.0, region=(10, 30, 8, 12))
    image = bench.mean("point", target, Conditions(illuminance_lux=1e-3)) - bench.mean(
        "dark", target, LUX
    )
    row, col = np.indices(image.shape)
    near = image * ((np.abs(row - 13.5) < 5) & (np.abs(col - 35.5) < 6))
    assert (near * (row + 0.5)).sum() / near.sum() == pytest.approx(14.0, abs=0.03)
    # The causal video filter moves it by a fifth of a pixel.
    assert (near * (col + 0.5)).sum() / near.sum() == pytest.approx(36.2, abs=0.15)


def test_light_and_gate_and_voltage_act_as_they_should(bench):
    dark = bench.mean("dark", Target(), Conditions()).mean()
    base = bench.mean("flat", Target(), LUX).mean() - dark
    twice = bench.mean("flat", Target(), Conditions(illuminance_lux=2e-4)).mean() - dark
    assert twice == pytest.approx(2.0 * base, rel=1e-4)
    half_gate = Conditions(illuminance_lux=2e-4, gate_ns=0.5e9 / 59.94)
    closed = bench.mean("dark", Target(), half_gate).mean()
    assert bench.mean("flat", Target(), half_gate).mean() - closed == pytest.approx(base, rel=1e-4)
    lower = Conditions(illuminance_lux=1e-4, mcp_v=720.0)
    assert bench.mean("flat", Target(), lower).mean() - 400.0 == pytest.approx(
        (base + dark - 400.0) * 0.9**10, rel=1e-3
    )


def test_contrast_is_that_of_the_target(plain):
    sensor = plain(80, 160, photocathode__halo_fraction=0.0, photocathode__ebi_lm_per_cm2=0.0)
    image = LabBench(sensor).mean("edge", Target(contrast=0.4, angle_deg=0.0), LUX) - 400.0
    bright, dark = image[:, 150].mean(), image[:, 10].mean()
    assert (bright - dark) / (bright + dark) == pytest.approx(0.4, abs=0.005)


@pytest.mark.parametrize(
    "call",
    [
        {"kind": "flat", "conditions": Conditions()},
        {"kind": "scene", "conditions": LUX},
        {"kind": "bars", "conditions": LUX},
        {"kind": "flat", "conditions": LUX, "frames": 0},
    ],
    ids=["no light", "no such target", "no frequency", "no frames"],
)
def test_impossible_exposures_are_refused(bench, call):
    with pytest.raises(BadInput):
        bench.expose(
            call["kind"], Target(), call["conditions"], frames=call.get("frames", 1), seed=1
        )


def test_frames_of_the_sheets_camera_are_bytes_with_a_black_border_of_nothing(sheet):

    small = replace(sheet, ccd=replace(sheet.ccd, rows=33, columns=48))
    stack = LabBench(small).expose("flat", Target(), LUX, frames=2, seed=1)
    assert stack.data.dtype == np.uint8 and stack.shape == (2, 33, 48)
    assert stack.full_scale_dn == 255.0


def test_progressive_camera_has_one_exposure_a_frame(plain):

    sensor = plain(40, 60)
    progressive = replace(sensor, video=replace(sensor.video, interlaced=False))
    stack = LabBench(progressive).expose("flat", Target(), LUX, frames=3, seed=1)
    interlaced = LabBench(sensor).mean("flat", Target(), LUX).mean() - 400.0
    assert stack.time_s[1] == pytest.approx(1 / 59.94)
    assert LabBench(progressive).mean("flat", Target(), LUX).mean() - 400.0 == pytest.approx(
        interlaced / 2, rel=1e-4
    )


def test_specimens_lie_within_the_sheets_ranges_and_follow_their_seed(sheet, seed):
    known = sheet.parameters()
    drawn = [true_sensor.draw_true_sensor(sheet, seed + n) for n in range(200)]
    assert true_sensor.draw_true_sensor(sheet, seed) == drawn[0]
    assert any(str(seed) in note for note in drawn[0].notes)
    for path in true_sensor.VARIED:
        values = np.array([float(s.parameters()[path]) for s in drawn])
        low, high = known[path].low, known[path].high
        assert low is not None and high is not None
        assert low <= values.min() and values.max() <= high
        assert values.std() > 0.1 * (high - low)


def test_photons_on_the_chip_of_a_camera_without_a_tube_become_their_signal():
    """Level = QE g K photons and its variance F^2 g K level + read noise, by the description's
    numbers alone.
    """
    camera = load_camera("emccd-512")
    camera = replace(camera, ccd=replace(camera.ccd, rows=96, columns=96)).with_values(
        {"ccd.prnu": 0.0, "ccd.smear_fraction": 0.0, "optics.veiling_glare_fraction": 0.0}
    )
    bench, photons, gain = LabBench(camera), 2000.0, 40.0
    conditions = Conditions(exposure_s=0.02, temperature_c=-70.0, em_gain=gain)
    lit = replace(conditions, photons_per_px=photons, wavelength_nm=550.0)
    dark, flat = (
        bench.expose(kind, Target(), given, frames=12, seed=5).data.astype(float)
        for kind, given in (("dark", conditions), ("flat", lit))
    )
    electrons, per_e = photons * 0.92, 0.0817
    signal, expected = flat.mean() - dark.mean(), electrons * gain * per_e
    assert (
        abs(signal - expected)
        < 4.0 * np.sqrt(2.0 * expected * gain * per_e / flat.size) + 1e-3 * expected
    )
    power = (flat.var(axis=0, ddof=1) - dark.var(axis=0, ddof=1)).mean() / signal
    excess = 2.0 * (gain - 1.0) * gain ** -(537.0 / 536.0) + 1.0 / gain
    assert abs(power / (excess * gain * per_e) - 1.0) < 4.0 * np.sqrt(2.0 / (11 * 96**2)) + 0.005
    with pytest.raises(BadInput, match="photons_per_px and wavelength_nm"):
        bench.expose("flat", Target(), conditions, frames=1, seed=1)


# The rendered target covers its cells as its geometry says, and its light is that of the lamps.


NM = np.array([500.0, 600.0, 800.0])
VIEW = TargetView(
    shape=(96, 160),
    cell_px=(0.25, 0.25 * 13 / 11),
    corner_px=(-20.3, -14.1),
    metre_per_px=7e-4,
    distance_m=1.0,
)


def _clipped_area(
    polygon: np.ndarray, low: tuple[float, float], size: tuple[float, float]
) -> float:
    """Area of a convex polygon inside a rectangle (Sutherland and Hodgman)."""
    points = [tuple(p) for p in polygon]
    for axis in (0, 1):
        for bound, sign in ((low[axis], 1.0), (low[axis] + size[axis], -1.0)):
            kept = []
            for a, b in zip(points, points[1:] + points[:1], strict=True):
                da, db = sign * (a[axis] - bound), sign * (b[axis] - bound)
                if da >= 0:
                    kept.append(a)
                if da * db < 0:
                    t = da / (da - db)
                    kept.append((a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])))
            points = kept
            if not points:
                return 0.0
    x, y = np.array(points).T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def _coverage(kind, target, scene) -> np.ndarray:
    image = render_bench(scene, kind, target, VIEW, NM).radiance[1].astype(float)
    return image / (0.92 * planck(600.0, 2856.0))


def _rectangle(
    left: float, right: float, top: float, bottom: float, angle_deg: float
) -> np.ndarray:
    turn = np.deg2rad(angle_deg)
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    return corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])


@pytest.fixture(scope="module")
def scene():
    return load_scene()


def test_bars_cover_their_cells_to_1_256_of_a_cell(scene):
    frequency, angle = 0.13, 4.0
    width = 0.5 / frequency
    bars = [
        _rectangle(width * (2 * n - 3.5), width * (2 * n - 2.5), -3.5 * width, 3.5 * width, angle)
        for n in range(4)
    ]
    target = Target(bars=4, frequency_cy_per_px=frequency, angle_deg=angle)
    found = _coverage("bars", target, scene)
    checked = np.argwhere(outline_cells(target_outlines("bars", target, scene.holder), VIEW))[::7]
    exact = np.array(
        [
            sum(
                _clipped_area(bar, tuple(VIEW.places_px(np.array([[row, col]]))[0]), VIEW.cell_px)
                for bar in bars
            )
            / (VIEW.cell_px[0] * VIEW.cell_px[1])
            for row, col in checked
        ]
    )
    error = found[tuple(checked.T)] - exact
    assert np.sqrt(np.mean(error**2)) < 1.0 / 256.0
    assert abs(error.mean()) < 5e-4


def test_light_of_bars_edge_and_pinhole_is_that_of_their_areas(scene):
    cell = VIEW.cell_px[0] * VIEW.cell_px[1]
    bars = _coverage("bars", Target(bars=4, frequency_cy_per_px=0.15, angle_deg=4.0), scene)
    width = 0.5 / 0.15
    assert bars.sum() * cell == pytest.approx(4 * 7 * width**2, rel=1e-3)
    pinhole = _coverage("point", Target(pinhole_px=0.7), scene)
    dark = np.median(pinhole)
    assert (pinhole - dark).sum() * cell == pytest.approx(np.pi * 0.35**2, rel=0.01)
    edge = _coverage("edge", Target(angle_deg=5.0), scene)
    half = VIEW.shape[1] * VIEW.cell_px[0] - 20.3
    assert edge.mean() == pytest.approx(
        (half + np.tan(np.deg2rad(5.0)) * (VIEW.corner_px[1] + VIEW.shape[0] * VIEW.cell_px[1] / 2))
        / 40.0,
        rel=2e-3,
    )


def test_tiles_are_the_whole_picture(scene):
    whole = render_bench(scene, "edge", Target(), VIEW, NM).radiance
    tiles = [render_bench(scene, "edge", Target(), tile, NM).radiance for _, tile in VIEW.tiles(32)]
    tiled = np.concatenate(tiles, axis=1)
    # Only places of rays move, by rounding.
    assert np.abs(tiled - whole).max() < 0.02 * whole.max()
    assert np.abs(tiled - whole).mean() < 1e-5 * whole.max()


def test_ring_of_a_pinhole_reflects_the_room_faintly(scene):
    view = TargetView(
        shape=(400, 400),
        cell_px=(0.6, 0.6),
        corner_px=(-120.0, -120.0),
        metre_per_px=7e-4,
        distance_m=1.0,
    )
    image = render_bench(scene, "point", Target(pinhole_px=8.0), view, NM).radiance[1]
    row, col = np.indices(image.shape)
    distance = np.hypot(row + 0.5 - 200, col + 0.5 - 200) * 0.6
    ring = image[np.abs(distance - 100.0) < 8.0].mean() / image.max()
    assert 1e-6 < ring < 1e-4
    plate = image[np.abs(distance - 50.0) < 20.0].mean() / image.max()
    assert plate < 0.5 * ring
    # What stands above the plate shades it on the side away from the lamp, and nothing is lit from
    # behind.
    assert image.min() >= 0.0


def test_unknown_scene_is_refused(tmp_path):
    with pytest.raises(BadInput):
        load_scene(tmp_path / "none.toml")
    bad = tmp_path / "bad.toml"
    bench = resources.files("simulate") / "scenes" / "bench.toml"
    bad.write_text('colour = "red"\n' + bench.read_text())
    with pytest.raises(BadInput, match="colour"):
        load_scene(bad)


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        *(
            (lambda scene, kind=kind: render_bench(scene, kind, Target(), VIEW, NM), rule)
            for kind, rule in (
                ("bars", "frequency_cy_per_px, got none"),
                ("point", "positive pinhole_px, got None"),
                ("scene", "must be dark, flat, edge, bars or point, got 'scene'"),
            )
        ),
        (
            lambda _: RadianceCube(wavelength_nm=NM, radiance=np.zeros((2, 4, 4))),
            "band, row, col",
        ),
    ],
)
def test_a_target_without_what_its_kind_needs_and_a_cube_of_other_bands_are_refused(
    scene, make, rule
):
    with pytest.raises(BadInput, match=rule):
        make(scene)
