"""Files of other programs: the number of the plain file, or a sentence that says what the file
holds and what to do.
"""

import json
import shutil
import struct
import subprocess
import sys
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from scipy.special import erf

from labdata import BadInput, import_frames, open_session, read_frames
from tests.charact.cli.runner import charact

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT.parent / "shared" / "cases"

VERB = (
    f'{sys.executable} -P -c "from charact.cli import main; main()" mtf edge --method '
    f"edge-slanted --quick"
)

# An edge blurred by a Gaussian has its MTF at 0.5 where exp(-2 (pi sigma f)^2) is.
MTF50_CY_PER_PX = 0.125
SIGMA_PX = np.sqrt(np.log(2.0) / 2.0) / np.pi / MTF50_CY_PER_PX


def case(name: str) -> Path:
    found = sorted(CASES.glob(f"{name}-*"))
    if not found:
        pytest.skip(f"the case {name} is not among the shared data")
    return next(path for path in found[0].iterdir() if path.name != "README")


def measured(*arguments: object) -> tuple[float, str, list[str], list[int]]:
    """Return value, status, notes and region of the MTF50 of an edge."""
    done = charact("mtf", "edge", *arguments, "--method", "edge-slanted", "--quick", "--json")
    assert done.exit_code == 0, done.stderr
    one = next(m for m in json.loads(done.stdout)["measurements"] if m["quantity"] == "mtf50")
    return one["value"], one["status"], one["notes"], one["region"]


def edge(
    bits: int = 12, frames: int = 1, size: int = 96, sigma_px: float = SIGMA_PX, seed: int = 1
) -> np.ndarray:
    """Frames of an edge at 5 degrees, shape (frame, row, col), with Gaussian noise of 0.3 % of full
    scale.
    """
    row, col = np.mgrid[:size, :size] - size / 2
    across = col * np.cos(np.deg2rad(5.0)) + row * np.sin(np.deg2rad(5.0))
    top = 2**bits - 1
    clean = top * (0.1 + 0.325 * (1.0 + erf(across / sigma_px / np.sqrt(2.0))))
    noise = np.random.default_rng(seed).normal(0.0, 0.003 * top, (frames, size, size))
    return np.rint(clean + noise).astype(np.uint8 if bits == 8 else np.uint16)


@pytest.mark.parametrize("name", ["h01", "h03", "h05", "h07", "h11", "h13"])
def test_a_case_gives_the_number_of_the_plain_file(name):
    assert measured(case(name))[0] == pytest.approx(MTF50_CY_PER_PX, rel=0.01)


def test_a_jpeg_tiff_is_read_and_named_lossy():
    value, _, notes, _ = measured(case("h09"))
    assert value == pytest.approx(MTF50_CY_PER_PX, rel=0.01)
    assert any("JPEG" in note and "lossy" in note for note in notes)


def test_planes_of_a_fits_cube_are_not_frames():
    file = case("a1")
    done = charact("mtf", "edge", file, "--quick")
    assert done.exit_code == 1
    for word in ("0 unnamed of 3", "--axis 0", "--plane 0", "colours", file.name):
        assert word in done.stderr
    for plane, truth in (("0", 0.125), ("1", 0.156), ("b", 0.104)):
        assert measured(file, "--plane", plane)[0] == pytest.approx(truth, rel=0.02)


def test_the_colours_of_an_array_are_planes(tmp_path):
    np.save(tmp_path / "a.npy", np.stack([edge(8, seed=seed)[0] for seed in range(3)], axis=-1))
    assert measured(tmp_path / "a.npy", "--plane", "r")[0] == pytest.approx(
        MTF50_CY_PER_PX, rel=0.02
    )
    assert any(
        "colour picture" in note for note in read_frames(tmp_path / "a.npy", "luminance").notes
    )


def written(path: Path, data: np.ndarray, axes: str) -> Path:
    """Write a stack whose axes are labelled as a format labels them."""
    if path.name.endswith(".ome.tif"):
        tifffile.imwrite(path, data, metadata={"axes": axes})
    elif path.suffix == ".tif":
        tifffile.imwrite(path, data, imagej=True, metadata={"axes": axes})
    elif path.suffix == ".fits":
        fits = pytest.importorskip("astropy.io.fits")
        header = fits.Header({"CTYPE3": {"T": "TIME", "C": "STOKES", "Z": "FREQ"}[axes[0]]})
        fits.writeto(path, data, header)
    elif path.suffix == ".h5":
        with pytest.importorskip("h5py").File(path, "w") as file:
            file["entry/data"] = data
            for at, letter in enumerate(axes):
                file["entry/data"].dims[at].label = letter
    else:
        import zarr

        zarr.create_array(str(path), data=data, dimension_names=list(axes.lower()))
    return path


@pytest.mark.parametrize("name", ["a.ome.tif", "a.tif", "a.fits", "a.h5", "a.zarr"])
def test_an_axis_counts_frames_only_where_the_file_says_so(tmp_path, name):
    frames = 5
    data = edge(frames=frames)
    assert np.array_equal(read_frames(written(tmp_path / name, data, "TYX")).data, data)
    for letter in "CZ":
        path = written(tmp_path / f"{letter}{name}", data, f"{letter}YX")
        with pytest.raises(
            BadInput,
            match=rf"\(0 \w+ of {frames}, 1 row of 96, 2 col of 96\) .* `axis` 0 .* `plane` 0",
        ):
            read_frames(path)
        assert np.array_equal(read_frames(path, axis="0").data, data)
        assert np.array_equal(read_frames(path, "1").data, data[1:2])
        with pytest.raises(BadInput, match=f"got `plane` {frames}"):
            read_frames(path, str(frames))
        with pytest.raises(BadInput, match="`axis` must be one of the axes"):
            read_frames(path, axis="5")


def test_frames_of_several_channels_and_focus_positions_are_cut_by_plane_numbers(tmp_path):
    data = edge(frames=24, size=16).reshape(2, 3, 4, 16, 16)
    tifffile.imwrite(tmp_path / "a.ome.tif", data, metadata={"axes": "TCZYX"})
    with pytest.raises(
        BadInput,
        match=r"0 frame of 2, 1 channel of 3, 2 focus of 4, .* `plane` 0,0 takes one plane",
    ):
        read_frames(tmp_path / "a.ome.tif")
    assert np.array_equal(read_frames(tmp_path / "a.ome.tif", "2,1").data, data[:, 2, 1])


@pytest.mark.parametrize(
    ("labels", "rule"), [("ttyx", "0 frame of 2, 1 unnamed of 3"), ("tzcx", "rows and columns")]
)
def test_labels_that_name_no_picture_are_refused_by_name(tmp_path, labels, rule):
    import zarr

    data = edge(frames=6, size=16).reshape(2, 3, 16, 16)
    zarr.create_array(str(tmp_path / "a.zarr"), data=data, dimension_names=list(labels))
    with pytest.raises(BadInput, match=rule):
        read_frames(tmp_path / "a.zarr")


def test_a_fits_image_of_axes_of_length_one_is_one_picture(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    fits.writeto(tmp_path / "a.fits", edge()[None])
    assert np.array_equal(read_frames(tmp_path / "a.fits").data, edge())


def test_a_card_that_counts_the_frames_of_a_fits_cube_names_its_axis(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    data = edge(frames=5)
    fits.writeto(tmp_path / "a.fits", data, fits.Header({"NUMKIN": 5}))
    fits.writeto(tmp_path / "b.fits", data, fits.Header({"NUMKIN": 4}))
    assert np.array_equal(read_frames(tmp_path / "a.fits").data, data)
    with pytest.raises(BadInput, match="0 unnamed of 5"):
        read_frames(tmp_path / "b.fits")


@pytest.mark.parametrize("name", ["a.npy", "a.tif"])
def test_a_transposed_stack_is_told_its_axis(tmp_path, name):
    data = edge(frames=16)
    turned = np.ascontiguousarray(np.moveaxis(data, 0, -1))
    np.save(tmp_path / name, turned) if name == "a.npy" else tifffile.imwrite(
        tmp_path / name, turned
    )
    with pytest.raises(
        BadInput,
        match=r"0 row of 96, 1 col of 96, 2 unnamed of 16\) .* `axis` 2 takes axis 2 for frames",
    ):
        read_frames(tmp_path / name)
    assert np.array_equal(read_frames(tmp_path / name, axis="2").data, data)


def test_three_frames_that_their_writer_marked_as_colours_get_a_warning(tmp_path):
    """Tifffile marks three pages of 8 bits as the planes of an RGB picture unless it is told
    otherwise.
    """
    data = edge(8, frames=3)
    with warnings.catch_warnings(action="ignore"):
        tifffile.imwrite(tmp_path / "a.tif", data)
    assert any(
        "its writer marked the three planes" in note
        for note in read_frames(tmp_path / "a.tif").notes
    )
    assert np.array_equal(read_frames(tmp_path / "a.tif", axis="0").data, data)
    assert not read_frames(tmp_path / "a.tif", axis="0").notes


def test_a_session_keeps_the_axis_and_the_plane_of_its_files(tmp_path):
    data = np.moveaxis(edge(frames=16), 0, -1)
    np.save(tmp_path / "a.npy", data)
    with pytest.raises(BadInput, match="`axis` 2"):
        import_frames([tmp_path / "a.npy"], tmp_path / "S")
    import_frames([tmp_path / "a.npy"], tmp_path / "S", axis="2", kind="edge")
    assert np.array_equal(
        open_session(tmp_path / "S").stack("a").read().data, np.moveaxis(data, -1, 0)
    )


def _gz(path: Path, data: np.ndarray) -> None:
    pytest.importorskip("astropy.io.fits").writeto(path, data)


def _fz(path: Path, data: np.ndarray) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(data, compression_type="RICE_1")]).writeto(
        path
    )


def _cv2(path: Path, data: np.ndarray) -> None:
    assert cv2.imwrite(str(path), data)


def _pillow(path: Path, data: np.ndarray) -> None:
    from PIL import Image

    Image.fromarray(data).save(path)


def _tiff(**options):
    return lambda path, data: tifffile.imwrite(path, data, **options)


def _thumbnail_first(path: Path, data: np.ndarray) -> None:
    with tifffile.TiffWriter(path) as file:
        file.write(data[::8, ::8], metadata=None)
        file.write(data, metadata=None)


def _ser(path: Path, data: np.ndarray) -> None:
    rows, cols = data.shape
    header = struct.pack("<14s7I", b"LUCAM-RECORDER", 0, 0, 0, cols, rows, 12, 1) + bytes(136)
    path.write_bytes(header + data.tobytes() + bytes(8))


def _spe(path: Path, data: np.ndarray) -> None:
    """WinView's header: x and y size, type 3 (16 bits unsigned), frames and version at their
    offsets.
    """
    header = bytearray(4100)
    for at, form, value in (
        (42, "<H", data.shape[1]),
        (656, "<H", data.shape[0]),
        (108, "<h", 3),
        (1446, "<i", 1),
    ):
        struct.pack_into(form, header, at, value)
    struct.pack_into("<f", header, 1992, 2.5)
    path.write_bytes(bytes(header) + data.tobytes())


def _avi(code: int):
    def write(path: Path, data: np.ndarray) -> None:
        video = cv2.VideoWriter(str(path), code, 25, data.shape[::-1], isColor=False)
        video.write(data)
        video.release()

    return write


def _h5(path: Path, data: np.ndarray) -> None:
    with pytest.importorskip("h5py").File(path, "w") as file:
        file["exchange/data"] = data
        file["exchange/theta"] = np.zeros(3)


LOSSLESS = {
    "gz.fits.gz": (12, _gz),
    "fz.fits.fz": (12, _fz),
    "a.bmp": (8, _cv2),
    "pillow.bmp": (8, _pillow),
    "a.pgm": (12, _cv2),
    "a.png": (12, _cv2),
    "b.pgm": (8, _pillow),
    "zstd.tif": (12, _tiff(compression="zstd", predictor=True)),
    "lzw.tif": (12, _tiff(compression="lzw")),
    "ten.tif": (10, _tiff(bitspersample=10)),
    "twelve.tif": (12, _tiff(bitspersample=12)),
    "thumbnail.tif": (12, _thumbnail_first),
    "a.ser": (12, _ser),
    "a.spe": (12, _spe),
    "plain.avi": (8, _avi(0)),
    "ffv1.avi": (8, _avi(cv2.VideoWriter.fourcc(*"FFV1"))),
    "a.h5": (12, _h5),
}


@pytest.mark.parametrize("name", LOSSLESS)
def test_the_pixels_of_a_file_are_those_that_were_written(tmp_path, name):
    bits, write = LOSSLESS[name]
    data = edge(bits)[0]
    write(tmp_path / name, data)
    found = read_frames(tmp_path / name)
    assert np.array_equal(found.data[0], data)
    assert not any("lossy" in note for note in found.notes)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.jpg", _cv2),
        ("b.jpeg", _pillow),
        ("a.tif", _tiff(compression="jpeg")),
        ("a.avi", _avi(cv2.VideoWriter.fourcc(*"MJPG"))),
    ],
)
def test_a_lossy_file_is_measured_and_named_so(tmp_path, name, write):
    write(tmp_path / name, edge(8)[0])
    value, _, notes, _ = measured(tmp_path / name)
    assert value == pytest.approx(MTF50_CY_PER_PX, rel=0.04)
    assert any("JP" in note and "lossy" in note for note in notes)


@pytest.mark.parametrize("suffix", [".jpg", ".bmp", ".pgm", ".ser", ".spe", ".avi"])
def test_half_a_file_is_refused_in_a_sentence(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    {".ser": _ser, ".spe": _spe, ".avi": _avi(0)}.get(suffix, _cv2)(
        path, edge(8 if suffix != ".spe" else 12)[0]
    )
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(BadInput, match=r"must be whole|got something else"):
        read_frames(path)


def test_frames_of_lightfield_stand_apart_by_their_time_stamps(tmp_path):
    """SPE 3.0: the XML at the end states count, size and stride of the frames, 16 bytes of time
    stamps between them.
    """
    data = edge(frames=3)
    _spe(tmp_path / "a.spe", data[0])
    header = bytearray((tmp_path / "a.spe").read_bytes()[:4100])
    body = b"".join(frame.tobytes() + bytes(16) for frame in data)
    struct.pack_into("<f", header, 1992, 3.0)
    struct.pack_into("<Q", header, 678, 4100 + len(body))
    size = data[0].nbytes
    regions = (
        f'<DataBlock type="Region" count="1" width="96" height="96" size="{size}" '
        f'stride="{size}" />'
    )
    for count in (1, 2):
        footer = (
            '<SpeFormat version="3.0" '
            'xmlns="http://www.princetoninstruments.com/spe/2009"><DataFormat>'
            f'<DataBlock type="Frame" count="3" pixelFormat="MonochromeUnsigned16" size="{size}" '
            f'stride="{size + 16}">'
            f"{regions * count}</DataBlock></DataFormat></SpeFormat>"
        )
        (tmp_path / "a.spe").write_bytes(bytes(header) + body + footer.encode())
        if count == 1:
            assert np.array_equal(read_frames(tmp_path / "a.spe").data, data)
    with pytest.raises(BadInput, match="one region a frame, got 2"):
        read_frames(tmp_path / "a.spe")


def test_frames_of_winview_are_those_that_imageio_reads(tmp_path):
    from imageio.v3 import imread

    _spe(tmp_path / "a.spe", edge()[0])
    assert np.array_equal(
        imread(tmp_path / "a.spe", plugin="SPE")[0], read_frames(tmp_path / "a.spe").data[0]
    )


def test_a_missing_library_is_named_with_its_command(tmp_path, monkeypatch):
    missing = (
        ("h5py", "a.h5", "hdf5"),
        ("astropy.io", "a.fits", "fits"),
    )
    for module, name, extra in missing:
        monkeypatch.setitem(sys.modules, module, None)
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(BadInput, match=rf"pip install 'charact\[{extra}\]'"):
            read_frames(tmp_path / name)


def test_a_border_without_pixels_moves_no_region(tmp_path):
    """Rows and columns at the top, bottom, left and right that are NaN; regions stay those of the
    file.
    """
    top, bottom, left, right = 2, 9, 17, 1
    data = edge().astype(np.float32)[0]
    plain = data[top : 96 - bottom, left : 96 - right]
    framed = np.full_like(data, np.nan)
    framed[top : 96 - bottom, left : 96 - right] = plain
    np.save(tmp_path / "framed.npy", framed)
    np.save(tmp_path / "plain.npy", plain)
    assert measured(tmp_path / "framed.npy")[0] == measured(tmp_path / "plain.npy")[0]
    value, _, notes, region = measured(tmp_path / "framed.npy", "--roi", f"{top + 10},20,64,64")
    assert region == [top + 10, 20, 64, 64]
    assert value == measured(tmp_path / "plain.npy", "--roi", f"10,{20 - left},64,64")[0]
    assert any(
        f"rows {top} to {95 - bottom} of 96 and columns {left} to {95 - right} of 96" in note
        for note in notes
    )


def test_few_pixels_without_a_value_are_filled_and_many_refused(tmp_path):
    data = edge().astype(np.float32)
    holes = data.copy()
    holes[0, 10, 10:13] = np.nan
    np.save(tmp_path / "few.npy", holes)
    found = read_frames(tmp_path / "few.npy")
    assert abs(found.data[0, 10, 10:13] - data[0, 10, 10:13]).max() < 60.0
    assert any("3 pixels inside" in note for note in found.notes)
    holes[0, 20:40, 20:40] = np.inf
    np.save(tmp_path / "many.npy", holes)
    with pytest.raises(BadInput, match="every pixel must be finite"):
        read_frames(tmp_path / "many.npy")


@pytest.mark.parametrize("bits", [10, 14])
def test_swapped_bytes_are_reported_and_plain_ones_are_not(tmp_path, bits):
    data = edge(bits, frames=2)
    for name, values in (
        ("plain", data),
        ("big", data.astype(">u2")),
        ("left", data << (16 - bits)),
    ):
        np.save(tmp_path / f"{name}.npy", values)
        assert not any("swapped" in note for note in read_frames(tmp_path / f"{name}.npy").notes)
    np.save(tmp_path / "swapped.npy", data.byteswap())
    assert any(
        f"the {bits - 8} lowest of the low one" in note
        for note in read_frames(tmp_path / "swapped.npy").notes
    )


@pytest.mark.parametrize(("bits", "shift"), [(12, 4), (14, 2), (12, 0)])
def test_full_scale_shows_in_shifted_codes_and_in_reals_from_0_to_1(tmp_path, bits, shift):
    top = 2**bits - 1
    codes = np.minimum(edge(bits).astype(int) * 3 // 2, top)
    np.save(tmp_path / "shifted.npy", (codes << shift).astype(np.uint16))
    np.save(tmp_path / "reals.npy", (codes / top).astype(np.float32))
    assert read_frames(tmp_path / "shifted.npy").full_scale_dn == top << shift
    assert read_frames(tmp_path / "reals.npy").full_scale_dn == 1.0


def mosaic(red: float, blue: float, green: tuple[tuple[int, int], ...]) -> np.ndarray:
    """An edge behind a colour filter of 2x2 pixels: transmissions of red and blue, green 1."""
    data = edge(frames=2).astype(float)
    sites = [site for site in ((0, 0), (0, 1), (1, 0), (1, 1)) if site not in green]
    for (row, col), factor in zip(sites, (red, blue), strict=True):
        data[:, row::2, col::2] *= factor
    return np.rint(data).astype(np.uint16)


@pytest.mark.parametrize(
    ("red", "blue", "green"),
    [(0.6, 0.45, ((0, 0), (1, 1))), (0.95, 0.9, ((0, 1), (1, 0))), (1.4, 0.9, ((0, 1), (1, 0)))],
)
def test_a_mosaic_taken_for_grey_is_reported_with_its_planes(tmp_path, red, blue, green):
    data = mosaic(red, blue, green)
    np.save(tmp_path / "a.npy", data)
    assert any("`plane` r, g1, g2 or b" in note for note in read_frames(tmp_path / "a.npy").notes)
    (row, col), _ = green
    assert np.array_equal(read_frames(tmp_path / "a.npy", "g1").data, data[:, row::2, col::2])


def test_gains_of_rows_and_columns_are_no_mosaic(tmp_path):
    data = edge().astype(float)
    data[:, ::2] *= 1.1
    data[:, :, ::2] *= 0.9
    for name, values in (
        ("taps", data),
        ("plain", edge()),
        ("noise", np.random.default_rng(0).normal(100, 9, (4, 64, 64))),
    ):
        np.save(tmp_path / f"{name}.npy", values)
        assert not any("mosaic" in note for note in read_frames(tmp_path / f"{name}.npy").notes)


def test_an_array_on_the_disk_is_mapped_and_a_lack_of_memory_is_no_damage(tmp_path, monkeypatch):
    np.save(tmp_path / "a.npy", edge(frames=5))
    data = read_frames(tmp_path / "a.npy").data
    while data.base is not None and not isinstance(data, np.memmap):
        data = data.base
    assert isinstance(data, np.memmap)

    def too_large(*_: object, **__: object) -> None:
        raise MemoryError("Unable to allocate 37.3 GiB for an array")

    monkeypatch.setattr(np, "load", too_large)
    done = charact("mtf", "edge", tmp_path / "a.npy")
    assert done.exit_code == 1
    assert "must fit into memory" in done.stderr and "37.3 GiB" in done.stderr


def test_numbers_come_before_the_sentence_of_a_file_that_cannot_be_written(tmp_path):
    np.save(tmp_path / "a.npy", edge())
    asked = ("mtf", "edge", tmp_path / "a.npy", "--method", "edge-slanted", "--quick")
    (tmp_path / "taken.png").mkdir()
    done = charact(*asked, "--annotate", tmp_path / "taken.png", "--json")
    assert done.exit_code == 1
    assert json.loads(done.stdout)["measurements"][0]["value"] is not None
    assert done.stderr.count("\n") == 1 and "taken.png" in done.stderr
    # A folder that does not exist is said before any work.
    done = charact(*asked, "--annotate", tmp_path / "none" / "x.png", "--json")
    assert done.exit_code == 1 and "measurements" not in json.loads(done.stdout)
    assert charact(*asked, "--annotate", tmp_path / "x.png").exit_code == 0
    assert [path.name for path in tmp_path.iterdir() if "partial" in path.name] == []


def test_a_folder_that_takes_no_file_holds_no_half_one(tmp_path):
    np.save(tmp_path / "a.npy", edge())
    (tmp_path / "disk").mkdir()
    mount = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    mounted = f"mount -t tmpfs -o size=8k none {tmp_path}/disk"
    if (
        shutil.which("unshare") is None
        or subprocess.run([*mount, mounted], capture_output=True).returncode
    ):
        pytest.skip("no small disk may be mounted here")
    verb = f"{VERB} {tmp_path}/a.npy"
    script = (
        f"{mounted} && {verb} --annotate {tmp_path}/disk/x.png; echo code $?; ls -A {tmp_path}/disk"
    )
    done = subprocess.run([*mount, script], capture_output=True, text=True, cwd=ROOT)
    lines = done.stdout.splitlines()
    assert "\nmtf50 " in done.stdout and " 0.12" in done.stdout
    assert lines[-1] == "code 1", "no file is left"
    assert done.stderr.startswith("charact: file system error: ") and "x.png" in done.stderr


@pytest.mark.parametrize("where", [">&-", ">/dev/full"])
def test_a_stdout_that_takes_nothing_is_one_sentence(tmp_path, where):
    np.save(tmp_path / "a.npy", edge())
    verb = f"{VERB} {tmp_path}/a.npy --json"
    done = subprocess.run(["sh", "-c", f"{verb} {where}"], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith("charact: ")
