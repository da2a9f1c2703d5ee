"""Descriptions of infrared imagers, what they share as cameras, and verbs that need the other
half.
"""

from pathlib import Path

import numpy as np
import pytest

from labdata import (
    BadInput,
    file_io,
    from_mapping,
    load_camera,
    load_sensor,
    read_toml,
)
from labdata.camera import ThermalImagerFile
from simulate import SimulationRequest, conditions_of, load_described_camera, simulate
from simulate.camera import ThermalImager
from simulate.radiance import band_radiance
from tests.simulate.infrared.measures import imager
from tests.truth.thermal_targets import half_moon

NAMES = ("scanning-lwir", "vox-lwir-640", "insb-mwir-640")


SMALL = {"scanner__lines_per_field": 16}, {"bolometer__rows": 32}, {"cooled_array__rows": 32}


@pytest.fixture(params=range(3), ids=NAMES)
def camera(request) -> ThermalImager:
    """Each imager with few rows."""
    return imager(NAMES[request.param], **SMALL[request.param])


def test_the_shipped_imagers_have_the_geometry_of_their_class():
    shapes = {name: load_camera(name).shape for name in NAMES}
    assert shapes == {
        "scanning-lwir": (480, 256),
        "vox-lwir-640": (480, 640),
        "insb-mwir-640": (512, 640),
    }
    pitches = [load_camera(name).pitch_mrad for name in NAMES]
    # 15 degrees over 240 lines of a field: 1.09 mrad.
    assert 2.0 * pitches[0][0] == pytest.approx(1.09, abs=0.005)
    assert pitches[1:] == [pytest.approx((0.68, 0.68)), pytest.approx((0.30, 0.30))]
    assert all(load_camera(name).is_thermal for name in NAMES)
    assert not load_camera("pulnix-ag5745ef3").is_thermal


SCANNER, VOX, INSB = NAMES
TABLES = {name: read_toml(file_io.path_of_shipped("sensors", name)) for name in NAMES}


def vox_with(**tables):
    """The bolometer's file with other tables, None for none."""
    changed = {key: value for key, value in (TABLES[VOX] | tables).items() if value is not None}
    return from_mapping(changed, ThermalImagerFile)


def shown(source, photoelectrons_per_dn=None):
    vox, asked = load_camera(VOX), {"photoelectrons_per_dn": photoelectrons_per_dn}
    return simulate(SimulationRequest(source=source, **asked), vox, conditions_of(vox))


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (
            lambda: vox_with(scanner=TABLES[SCANNER]["scanner"]),
            "must have one of scanner, bolometer, cooled_array, got scanner, bolometer",
        ),
        (lambda: vox_with(bolometer=None), "got none"),
        (
            lambda: vox_with(bolometer=TABLES[VOX]["bolometer"] | {"netd": 40}),
            "unknown key 'netd' in bolometer; did you mean",
        ),
        (
            lambda: vox_with(video=TABLES[VOX]["video"] | {"interlaced": True}),
            "a scanner must be interlaced and an array progressive",
        ),
        *(
            (
                lambda name=name, path=path, value=value: load_camera(name).with_values(
                    {path: value}
                ),
                sentence,
            )
            for name, path, value, sentence in (
                (
                    SCANNER,
                    "band.short_um",
                    13.0,
                    "short_um must lie below long_um, got 13 and 12",
                ),
                (
                    SCANNER,
                    "scanner.active_fraction",
                    1.0,
                    "active_fraction must lie between 0.05 and 0.98, got 1",
                ),
                (
                    SCANNER,
                    "video.span_k",
                    700.0,
                    r"span_k must lie within -200 to 2000 C, got -328 to 372 C",
                ),
                (
                    SCANNER,
                    "scanner.mirror_hz",
                    7000.0,
                    "all lines_per_field within a field, got 240 of 233.6 lines",
                ),
                (
                    SCANNER,
                    "scanner.clock_error_ns",
                    1e6,
                    "clock_error_ns must lie between -1000 and 1000, got 1e",
                ),
                (VOX, "bolometer.netd_mk", 0.0, "netd_mk must be positive, got 0"),
                (
                    INSB,
                    "cooled_array.correction_low_c",
                    40.0,
                    "correction_low_c must lie below correction_high_c",
                ),
            )
        ),
        (lambda: shown(np.ones((480, 640)), 1.0), "thermal imager needs an outdoor scene"),
        (lambda: shown(Path("bench")), "a thermal imager needs an outdoor scene, got bench"),
        *(
            (
                lambda option=option: conditions_of(load_camera(VOX), **option),
                r"^[a-z_]+ needs a camera of visible light, got 'VOx LWIR 640'$",
            )
            for option in ({"gain": 3.0}, {"mcp_v": 700.0}, {"illuminance_lux": 1e-4})
        ),
        (lambda: load_described_camera(VOX, "p43"), "phosphor needs a camera with a tube"),
        (lambda: load_sensor(VOX), "must be an intensified camera"),
    ],
)
def test_what_no_imager_can_have_or_show_is_refused_in_one_sentence(make, sentence):
    with pytest.raises(BadInput, match=sentence):
        make()


def test_the_signal_of_a_black_body_is_its_radiance_in_the_band(camera):
    """8-12 um: 38.5004; 7.5-13.5 um: 55.4916 W m-2 sr-1 at 300 K. Bins of any width see the
    same.
    """
    short, long = camera.band_um
    expected = {"scanning-lwir": 38.5004, "vox-lwir-640": 55.4916}
    for edges in ([short, long], np.linspace(3.0, 14.0, 12), np.linspace(2.9, 14.1, 300)):
        body = band_radiance(np.array(edges[:-1]), np.array(edges[1:]), 300.0)
        signal = camera.signal(np.broadcast_to(body, (2, 3, body.size)), edges)
        assert signal == pytest.approx(np.full((2, 3), float(camera.signal_of(300.0))), rel=1e-9)
    for name, radiance in expected.items():
        assert float(ThermalImager(load_camera(name)).signal_of(300.0)) == pytest.approx(
            radiance, rel=2e-6
        )


def test_codes_are_linear_in_radiance_and_clipped_at_both_ends(camera):
    quiet = ThermalImager(camera.description, frozenset(camera.effects) - {"quantisation"})
    low, high = (float(camera.signal_of(kelvin)) for kelvin in (288.0, 300.0))
    levels = [
        next(quiet.frames_of_signal(np.full(camera.shape, s), seed=0))
        for s in np.linspace(low, high, 5)
    ]
    means = np.array([frame.mean(dtype=float) for frame in levels])
    assert np.abs(means - np.linspace(means[0], means[-1], 5)).max() <= 0.5 + 1e-9
    assert all(np.array_equal(frame, np.rint(frame)) for frame in levels)
    video = camera.description.video
    full = 2**video.bit_depth - 1
    if video.level_c is not None:
        ends = [float(video.level_c) + 273.15 + side * float(video.span_k) for side in (-0.5, 0.5)]
        ends = [float(band_radiance(*camera.band_um, kelvin)) for kelvin in ends]
        share = (np.array([low, high]) - ends[0]) / (ends[1] - ends[0])
        assert means[[0, -1]] == pytest.approx(share * 2**video.bit_depth, rel=0.01)
    dark, hot = (
        next(camera.frames_of_signal(np.full(camera.shape, s), seed=0)) for s in (0.0, 50.0 * high)
    )
    assert hot.min() == hot.max() == full
    assert levels[0].min() > 0 and levels[0].max() < full
    if camera.description.cooled_array is None:
        assert dark.max() == 0


def test_a_frame_follows_from_seed_and_number(camera, seed):
    some = camera.view_target(22.0, seed=seed, count=3)
    assert some.tobytes() == camera.view_target(22.0, seed=seed, count=3).tobytes()
    assert np.array_equal(camera.view_target(22.0, seed=seed, count=1, first_frame=2)[0], some[2])
    assert not np.array_equal(some[0], some[1])
    assert not np.array_equal(camera.view_target(22.0, seed=seed + 1, count=1)[0], some[0])


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda camera, short, long: camera.responses([short + 0.2, long]),
            "spectral bins must hold the band",
        ),
        (
            lambda camera, *band: camera.signal(np.ones((4, 4)), band),
            r"axes \(row, col, bin\) with 1 bins, got shape",
        ),
        (
            lambda camera, *band: camera.signal(-np.ones((4, 4, 1)), band),
            "radiances must be finite and not negative",
        ),
        (
            lambda camera, *_: next(camera.frames_of_signal(np.ones((7, 9)), seed=0)),
            "a picture must have a whole number of cells in each of",
        ),
        (
            lambda camera, *_: camera.without("jitter"),
            "an effect must be one of optics blur, detector footprint",
        ),
    ],
)
def test_radiance_and_effects_that_do_not_fit_are_refused(camera, call, sentence):
    with pytest.raises(BadInput, match=sentence):
        call(camera, *camera.band_um)


def test_plates_show_the_share_that_is_drawn():
    """Half of a half moon."""
    camera = ThermalImager(load_camera("vox-lwir-640"))
    for tilt_deg in (0.0, 5.0, 90.0):
        share = half_moon(camera, tilt_deg=tilt_deg, oversample=2)
        assert share.mean() == pytest.approx(0.5, abs=1e-9)
        mixed = np.mean((share > 1e-3) & (share < 0.999))
        assert (mixed > 0.0) == (tilt_deg == 5.0)


def test_rays_of_a_scanner_are_equal_angles_and_those_of_an_array_equal_slopes(camera):
    view = camera.viewpoint((0.0, 0.0, 2.0), (0.0, 1.0, 0.0), oversample=2)
    rows, columns = view.shape
    assert (rows, columns) == (2 * camera.shape[0], 2 * camera.shape[1])
    col = np.linspace(0.0, columns, 9)
    _, direction = view.rays(np.full(9, 0.5 * rows), col)
    angle = 1e3 * np.arctan2(direction[:, 0], direction[:, 1])
    straight = (col - 0.5 * columns) * camera.pitch_mrad[1] / 2.0
    seen = angle if camera.description.scanner is not None else 1e3 * np.tan(1e-3 * angle)
    assert seen == pytest.approx(straight, abs=0.4 * camera.pitch_mrad[1])
