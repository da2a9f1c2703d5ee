"""Files of frames that nobody meant: pictures, arrays, raw files and meshes, mangled and read.

Decoders that are not ours do most of this reading, some of them in C; whoever calls this in a loop
does so in a process of its own. Only BadInput may come of it, and no picture of other pixels than
its header states.
"""

import json
import random
import re
import shutil
import struct
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import h5py
import numpy as np
import tifffile

from labdata import BadInput, read_frames
from labdata.importers import read_conditions
from labdata.store import array_writer, journal
from simulate.radiance import load_scene
from simulate.radiance.outdoor import Object, OutdoorScene, build, build_surfaces
from tests.fuzz.documents import mangled
from tests.labdata import dng
from tests.truth import camera_files

ROWS, COLUMNS = 12, 16
SIF_VERSIONS = (65541, 65550, 65559, 65567)  # 1998 to today: fields were added, none was moved
PLANES = (None, "r", "g1", "luminance", "mono", "")
EXTENSIONS = (None, None, None, "0", "2", "AMP1", "x")


def _frames(kind: type = np.uint16, *shape: int) -> np.ndarray:
    values = np.random.default_rng(1).integers(0, 200, shape or (3, ROWS, COLUMNS))
    return values.astype(kind)


def _tiff(**options) -> Callable[[Path], object]:
    return lambda path: tifffile.imwrite(
        path, _frames(), **{"photometric": "minisblack", **options}
    )


def _picture(kind: type, *shape: int) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(
        cv2.imencode(path.suffix, _frames(kind, *shape))[1].tobytes()
    )


# Astropy and trimesh take seconds to import: they are imported where they write.
def _fits(kind: type) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        from astropy.io import fits

        fits.writeto(path, _frames(kind))

    return write


def _mesh(path: Path) -> None:
    import trimesh

    trimesh.creation.box().export(path)


def _fpack(path: Path) -> None:
    from astropy.io import fits

    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(_frames(np.int16, ROWS, COLUMNS))]).writeto(
        path
    )


def _ser(path: Path) -> None:
    header = struct.pack("<14s7I", b"LUCAM-RECORDER", 0, 0, 0, COLUMNS, ROWS, 12, 3) + bytes(136)
    path.write_bytes(header + _frames().tobytes())


def _spe(path: Path) -> None:
    camera_files.write_spe(path, _frames(), exp_sec=0.1, DetTemperature=-20.0)


def _lightfield(path: Path) -> None:
    settings = "<ShutterTiming><ExposureTime>20</ExposureTime></ShutterTiming>"
    camera_files.write_spe(path, _frames(), settings)


def _img(path: Path) -> None:
    comment = '[Acquisition],NrExposure=4,ExposureTime=5 s,AcqMode=4[Streak camera],MCP Gain="20"'
    camera_files.write_img(path, _frames()[0], comment)


def _png_with_text(path: Path) -> None:
    from PIL import Image, PngImagePlugin

    texts = PngImagePlugin.PngInfo()
    texts.add_text("Exposure", "10 ms")
    texts.add_text("Gain", "6 dB", zip=True)
    texts.add_itxt("Gate", "200 ns")
    Image.fromarray(_frames()[0]).save(path, pnginfo=texts)


def _mef(path: Path) -> None:
    from astropy.io import fits

    images = [fits.ImageHDU(frame, name=f"AMP{at}") for at, frame in enumerate(_frames())]
    fits.HDUList([fits.PrimaryHDU(), *images]).writeto(path)


def _sif(**options) -> Callable[[Path], object]:
    return lambda path: camera_files.write_sif(path, _frames(np.float32), **options)


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["frames"] = _frames()


def _avi(path: Path) -> None:
    video = cv2.VideoWriter(str(path), 0, 25, (COLUMNS, ROWS), isColor=False)
    for frame in _frames(np.uint8):
        video.write(frame)
    video.release()


def _store(path: Path) -> None:
    array = array_writer.ArrayWriter(path, (ROWS, COLUMNS), np.uint16)
    for number, frame in enumerate(_frames()):
        array.append(frame, 0.1 * number, number)
    array.close()


def _zarr(path: Path) -> None:
    import zarr

    zarr.save_array(path, _frames())


FILES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "tiff": ("a.tif", _tiff()),
    "tiff, big and in tiles": ("a.tif", _tiff(bigtiff=True, tile=(16, 16), byteorder=">")),
    "tiff, packed": ("a.tif", _tiff(compression="zlib", predictor=True)),
    "tiff of ImageJ": ("a.tif", _tiff(imagej=True, metadata={"axes": "TYX"})),
    "tiff, 12 bits": ("a.tif", _tiff(bitspersample=12)),
    "tiff, Zstandard": ("a.tif", _tiff(compression="zstd")),
    "png": ("a.png", _picture(np.uint16, ROWS, COLUMNS)),
    "png in colour": ("a.png", _picture(np.uint8, ROWS, COLUMNS, 3)),
    "jpeg": ("a.jpg", _picture(np.uint8, ROWS, COLUMNS)),
    "bmp": ("a.bmp", _picture(np.uint8, ROWS, COLUMNS)),
    "pgm": ("a.pgm", _picture(np.uint16, ROWS, COLUMNS)),
    "ser": ("a.ser", _ser),
    "spe": ("a.spe", _spe),
    "spe of LightField": ("a.spe", _lightfield),
    **{f"sif of version {version}": ("a.sif", _sif(version=version)) for version in SIF_VERSIONS},
    "sif of two sections": ("a.sif", _sif(background=_frames(np.float32))),
    "img": ("a.img", _img),
    "png with text": ("a.png", _png_with_text),
    "fits of extensions": ("a.fits", _mef),
    "hdf5": ("a.h5", _hdf5),
    "avi": ("a.avi", _avi),
    "npy": ("a.npy", lambda path: np.save(path, _frames())),
    "npy of reals": ("a.npy", lambda path: np.save(path, _frames(np.float64))),
    "fits": ("a.fits", _fits(np.int16)),
    "fits, scaled": ("a.fits", _fits(np.uint16)),
    "fits, gzip": ("a.fits.gz", _fits(np.int16)),
    "fits, fpack": ("a.fits.fz", _fpack),
    "dng": ("a.dng", lambda path: dng.write(path, _frames(np.uint16, 40, 60))),
    "store": ("a.zarr", _store),
    "zarr": ("b.zarr", _zarr),
    **{f"mesh {kind}": (f"a{kind}", _mesh) for kind in build.KINDS},
}
"""What is read: the name of each file, and who writes a sound one."""


@cache
def sound(name: str) -> Path:
    """Return a sound file, or a folder of them, written once; copies of it are mangled."""
    file, write = FILES[name]
    path = Path(tempfile.mkdtemp(prefix="charact-sound-")) / file
    write(path)
    return path


def once(rng: random.Random, folder: Path) -> bool:
    """Mangle one file of any kind and read it; whether it was still sound."""
    return read(rng.choice(tuple(FILES)), rng, folder)


def read(name: str, rng: random.Random, folder: Path, *, wrong: bool = True) -> bool:
    """Read a file, mangled if it should be; whether it was sound. Anything but BadInput comes
    out.
    """
    whole, path = sound(name), folder / sound(name).name
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    if whole.is_dir():
        shutil.copytree(whole, path)
        parts = sorted(part for part in path.iterdir() if part.is_file())
        part = path / journal.METADATA if rng.random() < 0.5 else rng.choice(parts)
    else:
        part = Path(shutil.copy(whole, path))
    if wrong:
        part.write_bytes(mangled_bytes(part.read_bytes(), rng))
    plane = "r" if name == "dng" or "colour" in name else None
    if wrong and rng.random() < 0.1:
        plane = rng.choice(PLANES)
    try:
        several = wrong and name in ("fits of extensions", "sif of two sections", "hdf5")
        extension = rng.choice(EXTENSIONS) if several else None
        _read(name, path, plane, extension, partial=wrong and rng.random() < 0.5)
    except BadInput as error:
        assert str(error).strip() and "\n" not in str(error), "a refusal is one sentence"
        return False
    return True


def _read(
    name: str, path: Path, plane: str | None, extension: str | None, *, partial: bool
) -> None:
    if name.startswith("mesh"):
        build_surfaces(scene_of(path))
        return
    read_conditions(path, extension)
    stack = read_frames(path, plane, axis="frame", extension=extension, partial=partial)
    assert stack.data.ndim == 3 and stack.data.size, "frames are pictures of rows and columns"


def scene_of(mesh: Path) -> OutdoorScene:
    """Return a scene in which nothing stands but the mesh of a file."""
    scene = _road()
    thing = Object(label="thing", material=scene.material[0].label, file=mesh.name, unit="m")
    return replace(scene, object=(thing,), folder=str(mesh.parent))


@cache
def _road() -> OutdoorScene:
    scene = load_scene("road")
    assert isinstance(scene, OutdoorScene)
    return scene


def mangled_bytes(data: bytes, rng: random.Random) -> bytes:
    """Return a file with something wrong in it: in its words and lines if it has any, else in its
    bytes and numbers.
    """
    if rng.random() < 0.3:
        return mangled(data, rng)
    if rng.random() < 0.3 and (numbers := list(NUMBER.finditer(data))):
        return _other_number(data, rng.choice(numbers), rng)
    if data[:1] == b"{" and rng.random() < 0.7:
        return _other_json(data, rng)
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        width = rng.choice((1, 1, 2, 4, 8))
        # Headers come first, and there numbers have the most to say.
        end = len(out) if rng.random() < 0.4 else min(len(out), 400)
        at = rng.randrange(max(1, end - width))
        value = rng.choice(
            (0, 1, 2 ** (8 * width) - 1, 2 ** (8 * width - 1), rng.randrange(2 ** (8 * width)))
        )
        out[at : at + width] = value.to_bytes(width, rng.choice(("little", "big")))
    return bytes(out)


NUMBER = re.compile(rb"(?<![\w.])\d{1,12}(?![\w.])")


def _other_number(data: bytes, number: re.Match[bytes], rng: random.Random) -> bytes:
    """Return a file with another number of as many digits in its text: cards, comments and lines
    keep their places.
    """
    digits = len(number[0])
    value = rng.choice((0, 1, 10**digits - 1, rng.randrange(10**digits), int(number[0]) + 1))
    text = str(value).zfill(digits)[-digits:].encode()
    return data[: number.start()] + text + data[number.end() :]


def _other_json(data: bytes, rng: random.Random) -> bytes:
    """Return a document of JSON with one value of another kind or size."""
    try:
        document = json.loads(data)
    except ValueError:
        return mangled(data, rng)
    if not isinstance(document, dict) or not document:
        return data
    strange = (
        0,
        -1,
        1e99,
        "",
        "x",
        None,
        [],
        {},
        [10**12, 4, 4],
        [10**6, 10**6],
        [0, 4, 4],
        "int8",
        "float64",
        "<U9",
    )
    document[rng.choice(sorted(document))] = rng.choice(strange)
    return json.dumps(document).encode()
