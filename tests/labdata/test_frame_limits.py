"""What is no regular file, or unpacks to more than a camera or this machine holds, ends at once in
one sentence.
"""

import gzip
import os
import signal
import socket
import struct
import zlib
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import tifffile
import zarr

from labdata import BadInput, file_io, open_lazy_stack, open_session, read_frames
from labdata.importers import cameras
from labdata.store.array_writer import ArrayWriter
from tests.charact.cli.runner import charact
from tests.fuzz.bounds import most_resident_mb
from tests.labdata import dng

SIDE = 17_000


@pytest.fixture(autouse=True)
def in_time():
    """End what waits for ever."""

    def too_long(*_: object) -> None:
        raise TimeoutError("a file that cannot be read must be refused at once")

    before = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(30)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def one_sentence(done) -> str:
    """The only line of a refusal."""
    assert done.exit_code == 1, done.output
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("charact: ")
    return line


def png(path: Path) -> None:
    """Black, 8 bits a pixel: 289 MB in a file of 1.3 MB."""
    packing = zlib.compressobj(1)
    row = bytes(1 + SIDE)
    data = b"".join(packing.compress(row) for _ in range(SIDE)) + packing.flush()
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", SIDE, SIDE, 8, 0, 0, 0, 0)),
        (b"IDAT", data),
        (b"IEND", b""),
    )
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"".join(
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
            for kind, body in parts
        )
    )


def tiff(path: Path) -> None:
    tifffile.imwrite(path, np.zeros((16, 16), np.uint16), metadata=None)
    with tifffile.TiffFile(path, mode="r+b") as file:
        for tag in ("ImageWidth", "ImageLength"):
            file.pages[0].tags[tag].overwrite(10**6)


def npy(path: Path) -> None:
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<u2", "fortran_order": False, "shape": (10, 10**6, 10**6)}
        )
        file.write(bytes(1000))


def sparse_npy(path: Path) -> None:
    """As many pixels as the header states, in a file that takes no room on the disk."""
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "|u1", "fortran_order": False, "shape": (4, 2 * SIDE, SIDE)}
        )
        file.truncate(file.tell() + 4 * 2 * SIDE * SIDE)


def fits_header(**cards: object) -> bytes:
    text = "".join(
        f"{key:<8}= {value:>20}".ljust(80) for key, value in cards.items()
    ) + "END".ljust(80)
    return text.ljust(-(-len(text) // 2880) * 2880).encode()


def fits(path: Path) -> None:
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(fits_header(SIMPLE="T", BITPIX=8, NAXIS=2, NAXIS1=SIDE, NAXIS2=SIDE))
        for _ in range(SIDE):
            file.write(bytes(SIDE))


def fits_without_end(path: Path) -> None:
    """A header that unpacks to 300 MB of empty cards, behind a header without an image."""
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(fits_header(SIMPLE="T", BITPIX=8, NAXIS=0))
        for _ in range(100):
            file.write(b" " * 2880 * 1000)


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset(
            "frames", (4, SIDE, SIDE), "u2", chunks=(1, 1000, 1000), compression="gzip"
        )


def hdf5_of_a_device(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("frames", (20, 20), "u1", external="/dev/zero")


def ppm(path: Path) -> None:
    path.write_bytes(f"P5 {SIDE} {SIDE} 255\n".encode() + bytes(SIDE))


def raw(path: Path) -> None:
    dng.write(path, np.zeros((40, 60), np.uint16))
    with tifffile.TiffFile(path, mode="r+b") as file:
        for tag in ("ImageWidth", "ImageLength"):
            file.pages[0].tags[tag].overwrite(SIDE)


TOO_LARGE = f"at most {file_io.MOST_PICTURE_PX} pixels, got"
BOMBS = {
    "a.png": (
        png,
        f"{TOO_LARGE} 17000 rows x 17000 columns = 289000000 in a.png: cut out the part",
    ),
    "a.tif": (tiff, f"{TOO_LARGE} 1000000 rows x 1000000 columns"),
    "a.npy": (npy, "fewer pixels than its header states, in"),
    "b.npy": (sparse_npy, f"{TOO_LARGE} 34000 rows"),
    "a.fits.gz": (fits, f"{TOO_LARGE} 17000 rows"),
    "b.fits.gz": (fits_without_end, "header must end within 2880000 bytes"),
    "a.h5": (hdf5, "must fit into its file, got 2312000000 bytes"),
    "b.h5": (hdf5_of_a_device, "got a device, /dev/zero"),
    "a.sif": (
        lambda path: path.write_bytes(b"Andor Technology Multi-Channel File\n65538 1\n65559 0 0"),
        "must describe its frames",
    ),
    "a.pgm": (ppm, f"{TOO_LARGE} 17000 rows"),
    "a.dng": (raw, f"{TOO_LARGE} 17000 rows"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_file_that_states_or_unpacks_to_too_much_is_refused_before_it_takes_memory(
    tmp_path, name
):
    write, rule = BOMBS[name]
    write(tmp_path / name)
    before_mb = most_resident_mb()
    signal.alarm(5)
    with pytest.raises(BadInput) as refused:
        read_frames(tmp_path / name)
    assert rule in str(refused.value)
    assert name in str(refused.value)
    assert most_resident_mb() - before_mb < 50.0


@pytest.mark.parametrize(
    ("name", "verb"), [("a.tif", ("mtf", "edge")), ("a.npy", ("import", "frames"))]
)
def test_the_command_line_says_it_in_one_sentence(tmp_path, name, verb):
    write, rule = BOMBS[name]
    write(tmp_path / name)
    out = (tmp_path / "out",) * (verb[0] == "import")
    assert rule in one_sentence(charact(*verb, tmp_path / name, *out))


def avi(path: Path, frames: np.ndarray) -> None:
    video = cv2.VideoWriter(str(path), 0, 25, frames.shape[:0:-1], isColor=False)
    for frame in frames:
        video.write(frame)
    video.release()


WRITERS = {
    "a.tif": lambda path, frames: tifffile.imwrite(path, frames, photometric="minisblack"),
    "a.avi": avi,
    "a.zarr": lambda path, frames: zarr.create_array(path, data=frames),
    "a.png": lambda path, frames: cv2.imwrite(str(path), frames[0]),
    "a.npy": np.save,
}


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_read_whole_must_fit_into_half_of_the_memory_and_what_is_mapped_need_not(
    tmp_path, name, monkeypatch
):
    frames = np.random.default_rng(1).integers(0, 255, (5, 200, 300), dtype=np.uint8)
    WRITERS[name](tmp_path / name, frames)
    assert read_frames(tmp_path / name, axis="frame").shape[1:] == (200, 300)
    monkeypatch.setattr(file_io, "memory_bytes", lambda: 200_000)
    if name == "a.npy":
        assert read_frames(tmp_path / name).shape == (5, 200, 300)
    else:
        with pytest.raises(
            BadInput, match=rf"must take at most 0\.0001 GB, 50% .* in {name}: write fewer frames"
        ):
            read_frames(tmp_path / name)


def pipe(path: Path) -> None:
    os.mkfifo(path)


def bound_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(os.path.relpath(path))


OTHERS = {
    "a named pipe": pipe,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a socket": bound_socket,
    "a folder": Path.mkdir,
}
ENDINGS = (".tif", ".npy", ".fits", ".png", ".dng", ".h5", ".ser", ".spe", ".sif", ".avi")


@pytest.mark.parametrize("kind", OTHERS)
@pytest.mark.parametrize("ending", ENDINGS)
def test_what_is_no_regular_file_is_not_opened(tmp_path, monkeypatch, kind, ending):
    monkeypatch.chdir(tmp_path)
    OTHERS[kind](tmp_path / f"a{ending}")
    with pytest.raises(
        BadInput,
        match="the folder" if kind == "a folder" else f"must be a regular file, got {kind}",
    ):
        read_frames(tmp_path / f"a{ending}")


def test_a_link_to_a_file_is_as_good_as_the_file(tmp_path):
    np.save(tmp_path / "there.npy", np.ones((4, 5), np.uint8))
    (tmp_path / "here.npy").symlink_to("there.npy")
    assert read_frames(tmp_path / "here.npy").shape == (1, 4, 5)


MANIFEST = 'name = "s"\n[[stack]]\nlabel = "flat"\nkind = "flat"\nframes = "{frames}"\n'


@pytest.mark.parametrize(
    ("kind", "verb"), [("a named pipe", "measure"), ("a device", "noise"), ("a socket", "bloom")]
)
def test_a_session_names_none_of_them(tmp_path, monkeypatch, kind, verb):
    monkeypatch.chdir(tmp_path)
    OTHERS[kind](tmp_path / "a.npy")
    (tmp_path / "session.toml").write_text(MANIFEST.format(frames="a.npy"))
    assert f"frames of stack 'flat' must be a regular file, got {kind}" in one_sentence(
        charact(verb, tmp_path)
    )


def test_frames_that_became_a_pipe_after_the_session_was_opened_are_not_waited_for(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((3, 4, 5), np.uint8))
    (tmp_path / "session.toml").write_text(MANIFEST.format(frames="a.npy"))
    (entry,) = open_session(tmp_path).stacks
    (tmp_path / "a.npy").unlink()
    os.mkfifo(tmp_path / "a.npy")
    with pytest.raises(BadInput, match="got a named pipe"):
        open_lazy_stack(entry)


@pytest.mark.parametrize("name", ["zarr.json", "c.1.0.0"])
def test_a_stored_frame_that_is_a_pipe_is_not_waited_for(tmp_path, name):
    writer = ArrayWriter(tmp_path / "a.zarr", (4, 5), np.uint8)
    for number in range(3):
        writer.append(np.full((4, 5), number, np.uint8), 0.1 * number, number)
    writer.close()
    (tmp_path / "a.zarr" / name).unlink()
    os.mkfifo(tmp_path / "a.zarr" / name)
    with pytest.raises(BadInput, match="got a named pipe"):
        read_frames(tmp_path / "a.zarr")


def test_a_reader_that_finds_no_end_is_stopped_in_a_sentence(tmp_path, monkeypatch):
    def look_for_ever(path: Path, *, partial: bool) -> None:
        while path:
            pass

    monkeypatch.setattr(file_io, "READ_CPU_S", 0.2)
    monkeypatch.setattr(cameras, "read_spe", look_for_ever)
    (path := tmp_path / "a.spe").write_bytes(b"0")
    with pytest.raises(BadInput, match=r"within 0\.2 s of processor time, got no end in .*a\.spe"):
        read_frames(path)


def test_a_part_of_an_array_that_is_a_pipe_is_not_waited_for(tmp_path):
    zarr.create_array(tmp_path / "a.zarr", data=np.ones((3, 4, 5), np.uint8), chunks=(1, 4, 5))
    chunk = next(part for part in (tmp_path / "a.zarr" / "c").rglob("*") if part.is_file())
    chunk.unlink()
    os.mkfifo(chunk)
    with pytest.raises(BadInput, match="got a named pipe"):
        read_frames(tmp_path / "a.zarr")
    (tmp_path / "session.toml").write_text(MANIFEST.format(frames="a.zarr"))
    with pytest.raises(BadInput, match="got a named pipe"):
        open_lazy_stack(open_session(tmp_path).stacks[0])


@pytest.mark.parametrize("kind", OTHERS)
@pytest.mark.parametrize(
    "verb", [("plan",), ("simulate", "airfield", "out", "--sensor"), ("import", "emva1288")]
)
def test_a_plan_a_sensor_and_a_descriptor_are_regular_files(tmp_path, monkeypatch, kind, verb):
    monkeypatch.chdir(tmp_path)
    OTHERS[kind](tmp_path / "a.toml")
    out = ("out",) * (verb[0] == "import")
    assert one_sentence(charact(*verb, tmp_path / "a.toml", *out))
