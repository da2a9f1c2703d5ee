"""Radiance written as ENVI and OpenEXR is what readers of the formats' documents find there."""

import re
import struct
from types import SimpleNamespace

import numpy as np
import pytest

from labdata import BadInput
from simulate import InfraredView, radiance_files, save_view_radiance
from simulate.radiance import RadianceCube
from simulate.radiance.geometry import Viewpoint

BANDS_NM = np.array([450.0, 550.5, 1050.0, 1100.25])
EDGES_UM = (7.5, 8.0, 9.0, 10.5)
SHAPE = (5, 7)
LENS = Viewpoint(
    position_m=(1.5, -2.0, 3.25),
    forward=(0.0, 1.0, 0.0),
    shape=SHAPE,
    focal_px=(40.0, 20.0),
    roll_deg=4.0,
)


@pytest.fixture
def visible():
    rng = np.random.default_rng(1)
    cube = RadianceCube(wavelength_nm=BANDS_NM, radiance=rng.random((4, *SHAPE), np.float32) * 1e-9)
    truth = SimpleNamespace(range_m=rng.random(SHAPE, np.float32))
    truth.range_m[0, 0] = np.inf
    return SimpleNamespace(viewpoint=LENS, picture=SimpleNamespace(cube=cube, truth=truth))


@pytest.fixture
def infrared():
    radiance = np.random.default_rng(2).random((*SHAPE, 3), np.float32)
    truth = SimpleNamespace(range_m=np.ones(SHAPE, np.float32))
    picture = SimpleNamespace(radiance=radiance, edges_um=EDGES_UM, truth=truth)
    return InfraredView(picture=picture, camera=None, viewpoint=LENS, temperatures=None, title="")


def read_envi(path):
    """Header fields, and the image as (band, row, col), by the ENVI user guide."""
    lines = path.read_text().splitlines()
    assert lines[0] == "ENVI"
    fields = dict(re.fullmatch(r"(.+?) = (.*)", line).groups() for line in lines[1:])
    assert [fields[key] for key in ("header offset", "data type", "interleave", "byte order")] == [
        "0",
        "4",
        "bsq",
        "0",
    ]
    shape = [int(fields[key]) for key in ("bands", "lines", "samples")]
    return fields, np.fromfile(path.with_suffix(".raw"), "<f4").reshape(shape)


def listed(field):
    return [word.strip() for word in field.removeprefix("{").removesuffix("}").split(",")]


def read_exr(path):
    """Attributes, and channels by name as (row, col), of an uncompressed single-part scan-line
    file.
    """
    data, at, attributes = path.read_bytes(), 8, {}
    assert struct.unpack_from("<2i", data) == (0x01312F76, 2)

    def word():
        nonlocal at
        end = data.index(b"\0", at)
        found, at = data[at:end].decode(), end + 1
        return found

    while name := word():
        kind = word()
        (size,) = struct.unpack_from("<i", data, at)
        attributes[name] = kind, data[at + 4 : at + 4 + size]
        at += 4 + size
    x0, y0, x1, y1 = struct.unpack("<4i", attributes["dataWindow"][1])
    rows, columns, names = y1 - y0 + 1, x1 - x0 + 1, []
    channels = attributes["channels"][1]
    while channels != b"\0":
        name, channels = channels.split(b"\0", 1)
        assert struct.unpack_from("<i", channels) == (2,) and struct.unpack_from(
            "<2i", channels, 8
        ) == (1, 1)
        names, channels = [*names, name.decode()], channels[16:]
    assert names == sorted(names)
    found = {name: np.empty((rows, columns), np.float32) for name in names}
    for row, offset in enumerate(struct.unpack_from(f"<{rows}Q", data, at)):
        assert struct.unpack_from("<2i", data, offset) == (row, 4 * columns * len(names))
        for number, name in enumerate(names):
            found[name][row] = np.frombuffer(
                data, "<f4", columns, offset + 8 + 4 * columns * number
            )
    assert offset + 8 + 4 * columns * len(names) == len(data)
    return attributes, found


def test_envi_has_the_cube_with_wavelengths_names_unit_and_pose(visible, tmp_path):
    save_view_radiance(visible, tmp_path / "light.hdr")
    fields, image = read_envi(tmp_path / "light.hdr")
    np.testing.assert_array_equal(image, visible.picture.cube.radiance)
    assert fields["wavelength units"] == "Nanometers" and "fwhm" not in fields
    assert [float(word) for word in listed(fields["wavelength"])] == list(BANDS_NM)
    assert listed(fields["band names"]) == ["450 nm", "550.5 nm", "1050 nm", "1100.25 nm"]
    assert listed(fields["z plot titles"])[1] == "Radiance (W m-2 sr-1 nm-1)"
    assert [float(word) for word in listed(fields["position m"])] == [1.5, -2.0, 3.25]
    assert [float(word) for word in listed(fields["focal px"])] == [40.0, 20.0] and float(
        fields["roll deg"]
    ) == 4.0


def test_envi_of_infrared_bins_has_their_middles_and_widths(infrared, tmp_path):
    save_view_radiance(infrared, tmp_path / "light.hdr")
    fields, image = read_envi(tmp_path / "light.hdr")
    np.testing.assert_array_equal(image, np.moveaxis(infrared.picture.radiance, 2, 0))
    assert fields["wavelength units"] == "Micrometers" and fields["radiance unit"] == "W m-2 sr-1"
    assert [float(word) for word in listed(fields["wavelength"])] == [7.75, 8.5, 9.75]
    assert [float(word) for word in listed(fields["fwhm"])] == [0.5, 1.0, 1.5]


def test_exr_has_a_channel_for_each_band_and_the_range(visible, tmp_path):
    save_view_radiance(visible, tmp_path / "light.exr")
    attributes, channels = read_exr(tmp_path / "light.exr")
    np.testing.assert_array_equal(channels.pop("range_m"), visible.picture.truth.range_m)
    for plane, nm in zip(
        visible.picture.cube.radiance, ("450,0", "550,5", "1050,0", "1100,25"), strict=True
    ):
        (name,) = (name for name in channels if name.startswith(f"S0.{nm}") and name.endswith("nm"))
        np.testing.assert_array_equal(channels.pop(name), plane)
    assert not channels
    assert attributes["emissiveUnits"] == ("string", b"W.m^-2.sr^-1.nm^-1")
    assert attributes["compression"] == ("compression", b"\0") and attributes["lineOrder"] == (
        "lineOrder",
        b"\0",
    )
    # Pixels are half as wide as high; the screen at a distance of 1 is as wide as the columns over
    # the focal length.
    assert struct.unpack("<f", attributes["pixelAspectRatio"][1]) == (0.5,)
    assert struct.unpack("<f", attributes["screenWindowWidth"][1]) == pytest.approx((7 / 40,))
    assert struct.unpack("<3f", attributes["position_m"][1]) == (1.5, -2.0, 3.25)


def test_exr_of_infrared_bins_names_their_middles(infrared, tmp_path):
    save_view_radiance(infrared, tmp_path / "light.exr")
    attributes, channels = read_exr(tmp_path / "light.exr")
    np.testing.assert_array_equal(channels["S0.9,750000um"], infrared.picture.radiance[..., 2])
    assert attributes["emissiveUnits"][1] == b"W.m^-2.sr^-1"


def test_another_ending_is_refused(visible, tmp_path):
    with pytest.raises(BadInput, match=r"must end in \.npz, \.fits, \.hdr, \.exr, got light\.tif"):
        save_view_radiance(visible, tmp_path / "light.tif")
    assert list(radiance_files.FORMATS) == ["npz", "fits", "envi", "exr"]
