"""The rendered target covers its cells as its geometry says, and its light is that of the lamps."""

from importlib import resources

import numpy as np
import pytest

from labdata import BadInput, Target
from simulate.radiance import (
    RadianceCube,
    TargetView,
    load_scene,
    outline_cells,
    planck,
    render_bench,
    target_outlines,
)

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


@pytest.mark.parametrize(
    ("kind", "target"),
    [("bars", Target()), ("point", Target()), ("scene", Target())],
    ids=["bars", "point", "scene"],
)
def test_target_without_what_its_kind_needs_is_refused(scene, kind, target):
    with pytest.raises(BadInput):
        render_bench(scene, kind, target, VIEW, NM)


def test_unknown_scene_is_refused(tmp_path):
    with pytest.raises(BadInput):
        load_scene(tmp_path / "none.toml")
    bad = tmp_path / "bad.toml"
    bench = resources.files("simulate") / "scenes" / "bench.toml"
    bad.write_text('colour = "red"\n' + bench.read_text())
    with pytest.raises(BadInput, match="colour"):
        load_scene(bad)


def test_cube_needs_a_plane_for_each_wavelength():
    with pytest.raises(BadInput, match="band, row, col"):
        RadianceCube(wavelength_nm=NM, radiance=np.zeros((2, 4, 4)))
