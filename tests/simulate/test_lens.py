"""The lens obeys radiometry, and a point lands where its distortion and that of the taper say."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from labdata import BadInput, Conditions, load_camera, load_sensor
from simulate import Shot, conditions_of, render_sensor_of
from simulate.camera import (
    CameraModel,
    Defocus,
    Grid,
    RadiometricLens,
    camera_from_description,
    few_transfers,
    grid_with_margin,
    image_placement,
    mcp_input_from_photoelectrons,
    photoelectrons_from_radiance,
    rfft_image,
    tube_photometry,
)
from simulate.radiance import (
    LUMENS_PER_WATT,
    RadianceCube,
    band_widths,
    luminous_efficiency,
    planck,
)

# The lens obeys radiometry: light per lux, cos^4, T-number, conservation, and each wavelength its
# own blur.


BANDS_NM = np.arange(360.0, 1100.0, 5.0)


def _grid(rows: int = 24, columns: int = 40) -> Grid:
    return grid_with_margin(
        rows, columns, per_pixel=4, margin=10, pitch_x_mm=0.018, pitch_y_mm=0.0213
    )


@pytest.fixture
def lens(sheet) -> RadiometricLens:
    cathode = sheet.photocathode
    return RadiometricLens(
        f_number=1.4,
        transmission=0.85,
        focal_length_mm=26.8,
        detector_nm=cathode.wavelength_nm,
        detector_efficiency=cathode.relative_quantum_efficiency,
        grid=_grid(),
    )


def _lamp(level: float, rows: int = 24, columns: int = 40) -> RadianceCube:
    spectrum = level * planck(BANDS_NM, tube_photometry.LAMP_K)
    return RadianceCube(
        wavelength_nm=BANDS_NM, radiance=np.tile(spectrum[:, None, None], (1, rows, columns))
    )


def _picture(cells: int, first: int, count: int) -> np.ndarray:
    """Indices of the picture's cells among all."""
    return np.arange(cells)[first : first + count]


def _total(lens: RadiometricLens, cube: RadianceCube) -> float:
    return float(lens.mean(cube).values.sum(dtype=float))


def test_lamp_of_known_illuminance_gives_s_over_e_photoelectrons_per_lumen(lens, sheet):
    cube = _lamp(1e-9)
    fine = np.arange(360.0, 1100.0, 1.0)
    luminance = LUMENS_PER_WATT * np.sum(
        luminous_efficiency(fine) * 1e-9 * planck(fine, tube_photometry.LAMP_K)
    )
    lux = lens.gathering_sr * luminance
    peak = tube_photometry.quantum_efficiency(sheet, sheet.photocathode.wavelength_nm).max()
    cells = lens.mean(cube).values * peak / lens.grid.cell_area_cm2
    middle = cells[cells.shape[0] // 2, cells.shape[1] // 2]
    assert middle == pytest.approx(
        tube_photometry.photoelectrons_per_lumen_s(sheet) * lux * 1e-4, rel=5e-4
    )


def test_weights_integrate_what_the_efficiency_does_between_two_bands():
    """Even photon flux between 400 and 900 nm, an efficiency of 1 in the middle 100 nm alone."""
    weight = tube_photometry.detection_weights(
        [400.0, 900.0], [599.5, 600.5, 699.5, 700.5], [0.0, 1.0, 1.0, 0.0]
    )
    expected = 100.0 * 650e-9 / tube_photometry.JOULE_METRE
    assert weight.sum() == pytest.approx(expected, rel=1e-3)
    # The middle of the efficiency lies half way.
    assert weight[0] / weight.sum() == pytest.approx(0.5, abs=0.005)
    even = tube_photometry.detection_weights(BANDS_NM, BANDS_NM, np.ones(BANDS_NM.size))[1:-1]
    assert even == pytest.approx(
        (band_widths(BANDS_NM) * BANDS_NM)[1:-1] * 1e-9 / tube_photometry.JOULE_METRE, rel=1e-4
    )


def test_t_number_is_the_f_number_of_a_lossless_lens_as_bright(lens):
    assert lens.t_number == pytest.approx(1.4 / np.sqrt(0.85))
    lossless = replace(lens, f_number=lens.t_number, transmission=1.0)
    assert lossless.gathering_sr == pytest.approx(lens.gathering_sr, rel=1e-12)
    assert lens.gathering_sr == pytest.approx(np.pi * 0.85 / (4.0 * 1.4**2), rel=1e-12)
    assert replace(lens, magnification=1.0).gathering_sr == pytest.approx(0.25 * lens.gathering_sr)


def test_light_falls_off_with_the_fourth_power_of_the_cosine(lens):
    short = replace(lens, focal_length_mm=1.0)
    flat = short.mean(_lamp(1e-9)).values
    x, y = image_placement.cell_centres(lens.grid)
    cosine = 1.0 / np.sqrt(1.0 + x**2 + y**2)
    inside = np.ix_(
        *(_picture(n, 4 * 10, 4 * size) for n, size in zip(flat.shape, (24, 40), strict=True))
    )
    expected = (cosine**4)[inside]
    assert expected.min() < 0.8
    assert flat[inside] / flat.max() == pytest.approx(expected / (cosine**4).max(), rel=2e-3)


def test_vignetting_takes_its_fraction_at_the_corner_and_nothing_on_the_axis(lens):
    far = replace(lens, focal_length_mm=1e6, vignetting_fraction=0.15)
    corner = np.array([0.0, image_placement.corner_mm(lens.grid)])
    assert far.falloff(corner) == pytest.approx([1.0, 0.85], abs=1e-9)


def test_blur_glare_and_defocus_lose_no_light(lens):
    far = replace(lens, focal_length_mm=1e6)
    blurred = replace(far, aberration_blur_um=6.0, focal_shift_um=60.0, veiling_glare_fraction=0.05)
    assert _total(blurred, _lamp(1e-9)) == pytest.approx(_total(far, _lamp(1e-9)), rel=1e-5)


def test_distortion_moves_light_without_losing_it_and_dims_what_it_stretches(lens):
    grid = _grid(96, 128)
    far = replace(lens, focal_length_mm=1e6, grid=grid)
    x, y = image_placement.cell_centres(grid)
    radiance = np.exp(-((x - 0.5) ** 2 + (y - 0.4) ** 2) / 0.05**2)
    spot = radiance[40 : 40 + 384, 40 : 40 + 512].reshape(96, 4, 128, 4).mean(axis=(1, 3))
    cube = RadianceCube(wavelength_nm=np.array([600.0, 700.0]), radiance=np.tile(spot, (2, 1, 1)))
    plain, bent = far.mean(cube).values, replace(far, distortion_fraction=0.03).mean(cube).values
    assert bent.sum(dtype=float) == pytest.approx(plain.sum(dtype=float), rel=1e-3)
    centre = [
        np.array([(image * x).sum(), (image * y).sum()]) / image.sum() for image in (plain, bent)
    ]
    radius = np.hypot(*centre[0]) / image_placement.corner_mm(grid)
    assert centre[1] / centre[0] == pytest.approx(1.0 + 0.03 * radius**2, rel=1e-3)
    flat = replace(far, distortion_fraction=0.03).mean(_lamp(1e-9, 96, 128)).values
    at = np.unravel_index(np.argmin((x - 0.5) ** 2 + (y - 0.4) ** 2), flat.shape)
    middle = flat[flat.shape[0] // 2, flat.shape[1] // 2]
    stretch = 1.0 / radius_area(0.03, np.hypot(0.5, 0.4) / image_placement.corner_mm(grid))
    assert flat[at] / middle == pytest.approx(stretch, rel=1e-3)


def radius_area(fraction: float, landed: float) -> float:
    """Area magnification where light lands, by finite differences of the forward map."""
    s = np.linspace(0.0, 2.0, 200_001)
    lands = s * (1.0 + fraction * s**2)
    came = np.interp(landed, lands, s)
    return float(landed / came * np.interp(landed, lands, np.gradient(lands, s)))


def test_defocus_is_the_transform_of_an_even_disc():
    """Against a disc drawn on fine points."""
    blur = Defocus(shift_um=28.0, f_number=1.4)
    x = (np.arange(-600, 600) + 0.5) * 2e-5
    inside = np.hypot(x[:, None], x[None, :]) <= 0.010
    profile = inside.sum(axis=0) / inside.sum()
    for frequency in (10.0, 40.0, 70.0):
        exact = np.sum(profile * np.cos(2.0 * np.pi * frequency * x))
        assert blur.transfer(np.array([frequency]), np.zeros(1))[0] == pytest.approx(
            exact, abs=2e-3
        )


def test_each_wavelength_is_blurred_by_its_own_focus(lens):
    """A lamp's point in one band only: its transform is that band's transfer."""
    lens = replace(
        lens, focal_length_mm=1e6, aberration_blur_um=4.0, focal_shift_um=50.0, grid=_grid(32, 32)
    )
    point = np.zeros((3, 32, 32))
    point[:, 16, 16] = 1.0
    for band, nm in enumerate((500.0, 700.0, 900.0)):
        one = point * (np.arange(3) == band)[:, None, None]
        image = lens.mean(
            RadianceCube(wavelength_nm=np.array([500.0, 700.0, 900.0]), radiance=one)
        ).values
        sharp = image_placement.place_on_cells(one.sum(axis=0), lens.grid, row_pairs=False)
        frequency = lens.grid.frequencies()[0][0]
        near = frequency < 25.0
        blurred, unblurred = (np.abs(rfft_image(of)[0, near]) for of in (image, sharp))
        found = blurred / blurred[0] * unblurred[0] / unblurred
        assert found == pytest.approx(np.abs(lens.transfer(nm, frequency[near])), abs=1e-3)


def test_focus_shifts_by_its_length_from_500_to_925_nm(lens):
    shifted = replace(lens, focal_shift_um=60.0, focus_nm=500.0)
    frequency = np.linspace(0.0, 60.0, 30)
    for nm, off_um in ((500.0, 0.0), (925.0, 60.0), (712.5, 30.0)):
        extra = Defocus(shift_um=off_um, f_number=1.4).transfer(frequency, np.zeros_like(frequency))
        assert shifted.transfer(nm, frequency) == pytest.approx(
            lens.transfer(nm, frequency) * extra, abs=1e-9
        )


def test_few_shapes_stand_for_all_bands(lens):
    defocused = replace(lens, focal_shift_um=60.0, aberration_blur_um=4.0)
    frequency = np.linspace(0.0, 300.0, 400)
    transfers = np.stack([defocused.transfer(nm, frequency) for nm in BANDS_NM])
    shares, shapes = few_transfers(transfers, np.ones(len(BANDS_NM)))
    assert np.abs(shares.T @ shapes - transfers).max() < 1.1e-4
    assert len(shapes) < 12
    assert np.abs(shapes[1:, 0]).max() < 1e-12


@pytest.mark.parametrize("row_pairs", [False, True])
@pytest.mark.parametrize("shape", [(24, 40), (48, 80), (12, 10), (31, 53)])
def test_a_picture_of_any_size_covers_the_frame(row_pairs, shape):
    grid = _grid(25 if row_pairs else 24, 40)
    assert image_placement.place_on_cells(
        np.full(shape, 3.0), grid, row_pairs=row_pairs
    ) == pytest.approx(3.0, rel=1e-6)
    image = np.zeros(shape)
    image[shape[0] // 2, shape[1] // 2] = 1.0
    area = image_placement.place_on_cells(image, grid, row_pairs=row_pairs).sum(dtype=float)
    assert area == pytest.approx(24 * 40 * 16 / (shape[0] * shape[1]), rel=1e-5)


def test_a_row_of_the_picture_is_centred_on_the_row_that_reads_it():
    grid = _grid(25, 40)
    image = np.zeros((24, 40))
    image[7] = 1.0
    on_cells = image_placement.place_on_cells(image, grid, row_pairs=True)
    rows = np.arange(grid.shape[0]) + 0.5
    centre = (on_cells[:, 60] * rows).sum() / on_cells[:, 60].sum()
    # The row that reads it sums rows 7 and 8 of the chip, whose middle is their border.
    assert centre == pytest.approx((grid.margin_rows + 8.0) * 4)


def _with_one(value: float) -> RadianceCube:
    radiance = _lamp(1e-9).radiance.copy()
    radiance[3, 5, 7] = value
    return RadianceCube(wavelength_nm=BANDS_NM, radiance=radiance)


ONE_BAND = RadianceCube(wavelength_nm=np.array([600.0]), radiance=np.ones((1, 24, 40)))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda lens: lens.mean(_with_one(np.nan)), "finite"),
        (lambda lens: lens.mean(_with_one(np.inf)), "finite"),
        (lambda lens: lens.mean(_with_one(-1e-9)), "negative"),
        (lambda lens: lens.mean(ONE_BAND), "two bands"),
        (lambda lens: replace(lens, f_number=0.0), "f_number"),
        (lambda lens: replace(lens, transmission=-1.0), "transmission"),
        (lambda lens: replace(lens, vignetting_fraction=1.0), "vignetting_fraction"),
        (lambda lens: replace(lens, magnification=-0.1), "magnification"),
        (lambda _: image_placement.Radial(fraction=-0.2, corner_mm=8.0), "distortion"),
    ],
)
def test_impossible_light_and_lenses_are_refused(lens, call, words):
    with pytest.raises(BadInput, match=words):
        call(lens)


# A point of the scene lands in the frame where the truth's pixel and the distortions of lens and
# taper say.


HALF_PX = 14


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "emccd-512"])
def test_light_is_displaced_by_each_distortion_in_turn(name):
    description = load_camera(name)
    if description.has_tube:
        # Without the random offsets of multi-fibres, of about a pixel.
        description = replace(description, taper=replace(description.taper, shear_um=0.0))
    camera, conditions = camera_from_description(description), conditions_of(description)
    rows, columns = camera.shape
    radiance = np.zeros((2, rows, columns), np.float32)
    row, col = rows // 12, columns // 10
    radiance[:, row, col] = 1e-6
    freed = photoelectrons_from_radiance(
        camera, RadianceCube(wavelength_nm=np.array([550.0, 560.0]), radiance=radiance), conditions
    )
    light = camera.to_mcp_input(freed, conditions)
    shot = Shot(camera=camera, light=light, kind="scene", conditions=conditions)
    assert len(shot.frame_distortion) == 1 + camera.has_tube and all(shot.frame_distortion)

    # From the truth's pixel to the frame's, in columns and rows from the middle; pixels need not be
    # square.
    lens, cells = camera.lens(), camera.cells
    focal_px = lens.focal_length_mm / cells.pitch_x_mm, lens.focal_length_mm / cells.pitch_y_mm
    place = np.array(
        [(col + 0.5 - 0.5 * columns) / focal_px[0], (row + 0.5 - 0.5 * rows) / focal_px[1]]
    )
    corner = np.hypot(0.5 * columns / focal_px[0], 0.5 * rows / focal_px[1])
    landed = place
    for fraction in shot.frame_distortion:
        landed = landed * (1.0 + fraction * (np.hypot(*landed) / corner) ** 2)
    expected, before = landed * focal_px, place * focal_px

    grid = light.grid
    values = light.values[(..., *grid.frame_slices)].astype(float)
    values = values.reshape(values.shape[0] // grid.per_row, grid.per_row, -1, grid.per_column).sum(
        axis=(1, 3)
    )
    centre = round(expected[1] + 0.5 * values.shape[0]), round(expected[0] + 0.5 * values.shape[1])
    first = [max(0, at - HALF_PX) for at in centre]
    window = values[first[0] : centre[0] + HALF_PX + 1, first[1] : centre[1] + HALF_PX + 1]
    bright = np.maximum(window - 0.1 * window.max(), 0.0)
    at_row, at_col = (
        (bright * (axis + 0.5)).sum() / bright.sum() for axis in np.indices(window.shape)
    )
    found = at_col + first[1] - 0.5 * values.shape[1], at_row + first[0] - 0.5 * values.shape[0]
    assert found == pytest.approx(expected, abs=0.1)
    assert np.hypot(*(expected - before)) > 0.5


# What a renderer is told of a camera's noise is the noise of its frames.


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "gen3-digital-iccd"])
def test_blur_evens_the_noise_of_an_intensified_camera_as_its_eye_says(seed, name):
    described = load_sensor(name)
    camera = CameraModel(replace(described, ccd=replace(described.ccd, rows=32, columns=48)))
    conditions = Conditions(
        gate_ns=1e6, mcp_v=float(described.microchannel_plate.reference_v) - 100.0
    )
    eye, signal = render_sensor_of(camera, conditions), 8.0
    dark, light = (
        mcp_input_from_photoelectrons(camera, np.full(camera.shape, level, np.float32), conditions)
        for level in (0.0, signal)
    )
    dn_per_pe = (
        float(np.mean(camera.mean_frame(light, conditions) - camera.mean_frame(dark, conditions)))
        / signal
    )
    frames = np.stack(list(islice(camera.frames(light, conditions, seed=seed), 60))).astype(float)
    noise_pe = np.sqrt(np.mean(frames.var(axis=0, ddof=1))) / dn_per_pe
    assert eye.noise_averaging_factor < 0.6
    assert noise_pe == pytest.approx(float(eye.noise_floor(signal, smooth=True)), rel=0.1)
