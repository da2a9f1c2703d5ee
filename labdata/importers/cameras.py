"""Readers of camera software files: Princeton Instruments SPE, SER, Hamamatsu .img."""

import re
import struct
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import require_picture
from labdata.importers.axes import COL, COLOUR, FRAME, ROW, Recorded
from labdata.importers.headers import Stated, number_of, stated, stated_in_text
from labdata.importers.parts import whole_frames

SPE_HEADER_BYTES = 4100
# Header fields: byte offset and format (Princeton Instruments, SPE 3.0 File Format Specification,
# appendix A)
SPE_FIELDS = {
    "accumulations": (2, "<h"),
    "exposure_s": (10, "<f"),
    "temperature_c": (36, "<f"),
    "cols": (42, "<H"),
    "pulser": (94, "<h"),
    "type": (108, "<h"),
    "gate_us": (118, "<f"),
    "intensified": (144, "<h"),
    "intensifier_gain": (148, "<h"),
    "rows": (656, "<H"),
    "many_accumulations": (668, "<I"),
    "footer": (678, "<Q"),
    "frames": (1446, "<i"),
    "version": (1992, "<f"),
}
SPE_TYPES = {0: "<f4", 1: "<i4", 2: "<i2", 3: "<u2", 5: "<f8", 6: "u1", 8: "<u4"}

IMG_HEADER_BYTES = 64
IMG_TYPES = {0: "u1", 2: "<u2", 3: "<u4"}
PHOTON_COUNTING, ANALOG_INTEGRATION = "3", "4"  # Modes whose image is a sum of exposures
IMG_SECTION = re.compile(r"\[([^\[\]]+)\],?([^\[]*)")
IMG_ENTRY = re.compile(r'([^,="\r\n]+)=("[^"]*"|[^,\r\n]*)')
# Corrections of the software, which change noise and level
IMG_CORRECTIONS = {
    "BacksubCorr": "a background was subtracted",
    "ShadingCorr": "shading was corrected",
    "CurveCorr": "curvature was corrected",
    "DefectCorrection": "defects were replaced",
}

SER_MAGIC = b"LUCAM-RECORDER"
SER_HEADER_BYTES = 178
SER_MOSAICS = {8: "rggb", 9: "grbg", 10: "gbrg", 11: "bggr"}
# Samples per pixel by ColorID: grey, RGB, BGR (SER format description version 3, Grischa Hahn)
SER_COLOURS = {0: 1, 100: 3, 101: 3}


def read_spe(path: Path, *, partial: bool = False) -> Recorded:
    """Read an SPE file, 2.x (WinView, WinSpec) by its header, 3.0 (LightField) by the XML at its
    end; see `labdata.importers.read_frames`.
    """
    content, field = _spe_header(path)
    kind = np.dtype(SPE_TYPES[field["type"]])
    frames, rows, cols = field["frames"], field["rows"], field["cols"]
    stride = rows * cols * kind.itemsize
    if field["version"] >= 3.0:
        blocks = [
            block.attrib
            for block in _spe_footer(content, field).iter()
            if block.tag.endswith("}DataBlock")
        ]
        frame, regions = blocks[0], blocks[1:]
        if len(regions) != 1:
            raise BadInput(
                f"an SPE file must hold one region a frame, got {len(regions)} in {path}"
            )
        # Recorded time stamps lie between the frames.
        frames, stride = int(frame["count"]), int(frame["stride"])
        rows, cols = int(regions[0]["height"]), int(regions[0]["width"])
    frames, notes = whole_frames(
        path.name,
        frames=frames,
        start=SPE_HEADER_BYTES,
        stride=stride,
        frame_bytes=rows * cols * kind.itemsize,
        size=content.size,
        partial=partial,
    )
    strides = (stride, cols * kind.itemsize, kind.itemsize)
    data = np.ndarray((frames, rows, cols), kind, content, SPE_HEADER_BYTES, strides)
    return Recorded(data=data, names=(FRAME, ROW, COL), notes=notes)


def _spe_header(path: Path) -> tuple[np.memmap, dict[str, Any]]:
    """Return the bytes of an SPE file and the fields of its header."""
    content = np.memmap(path, np.uint8, "r")
    header = content[:SPE_HEADER_BYTES].tobytes()
    return content, {
        name: struct.unpack_from(form, header, at)[0] for name, (at, form) in SPE_FIELDS.items()
    }


def _spe_footer(content: np.memmap, field: dict[str, Any]) -> ElementTree.Element:
    return ElementTree.fromstring(content[field["footer"] :].tobytes())


def spe_conditions(path: Path, extension: str | None = None) -> Stated:
    """Return exposure, temperature, gate and gains of an SPE file, summed exposures counted.

    Notes
    -----
    LightField writes the settings as elements of their own names: exposures in ms, gates in ns.
    WinView leaves the exposure 0 where it has written no settings.
    """
    content, field = _spe_header(path)
    if field["version"] < 3.0:
        if not field["exposure_s"]:
            return stated()
        is_wide = field["accumulations"] < 0
        gated = field["pulser"] or field["intensified"]
        return stated(
            field["many_accumulations" if is_wide else "accumulations"],
            exposure_s=field["exposure_s"],
            temperature_c=field["temperature_c"],
            gate_ns=1e3 * field["gate_us"] if gated else None,
            gain_control=field["intensifier_gain"] if field["intensified"] else None,
        )
    footer = _spe_footer(content, field)

    def number(place: str) -> float | None:
        return number_of(footer.findtext(f".//{{*}}{place.replace('/', '/{*}')}"))

    exposure_ms = number("ShutterTiming/ExposureTime")
    combined = number("FrameCombination/FramesCombined") or 1.0
    is_sum = footer.findtext(".//{*}FrameCombination/{*}Method") == "Sum"
    pulse = footer.find(".//{*}RepetitiveGate/{*}Pulse")
    conditions, notes = stated(
        (combined if is_sum else 1.0) * (number("ReadoutControl/Accumulations") or 1.0),
        exposure_s=None if exposure_ms is None else 1e-3 * exposure_ms,
        temperature_c=number("Temperature/Reading"),
        gate_ns=None if pulse is None else number_of(pulse.get("width")),
        em_gain=number("EMGain"),
        gain_control=number("Intensifier/Gain"),
    )
    if combined > 1.0 and not is_sum:
        notes += (f"each frame is the mean of {combined:g} exposures by its header",)
    return conditions, notes


def read_ser(path: Path, *, partial: bool = False) -> Recorded:
    """Read a SER recording: a header of 178 bytes, then the frames; see
    `labdata.importers.read_frames`.
    """
    with path.open("rb") as file:
        header = file.read(SER_HEADER_BYTES)
    if not header.startswith(SER_MAGIC):
        raise BadInput(f"a .ser file must be a SER recording, got something else in {path}")
    colour, is_little_endian, columns, rows, bits, frames = struct.unpack_from("<6I", header, 18)
    samples = 1 if colour in SER_MOSAICS else SER_COLOURS.get(colour)
    if samples is None or not 1 <= bits <= 16:
        raise BadInput(
            f"a SER file must be grey, a Bayer mosaic or RGB of up to 16 bits, got ColorID "
            f"{colour} in {path}"
        )
    # Most writers invert the byte-order flag: 0 is little-endian (Siril, FireCapture, PIPP).
    kind = np.dtype("u1" if bits <= 8 else ">u2" if is_little_endian else "<u2")
    frame_bytes = rows * columns * samples * kind.itemsize
    frames, notes = whole_frames(
        path.name,
        frames=frames,
        start=SER_HEADER_BYTES,
        stride=frame_bytes,
        frame_bytes=frame_bytes,
        size=path.stat().st_size,
        partial=partial,
    )
    data = np.memmap(path, kind, "r", SER_HEADER_BYTES, (frames, rows, columns, samples))
    data = data[..., ::-1] if colour == 101 else data
    names = (FRAME, ROW, COL, COLOUR)
    full_scale_dn = float(2**bits - 1) if data.max(initial=0) <= 2**bits - 1 else None
    return Recorded(
        data=data,
        names=names,
        pattern=SER_MOSAICS.get(colour),
        full_scale_dn=full_scale_dn,
        notes=notes,
    )


def read_img(path: Path) -> Recorded:
    """Read an image of HiPic or HPD-TA (ITEX); see `labdata.importers.read_frames`.

    Notes
    -----
    A header of 64 bytes, little-endian: "IM", length of the comment, columns, rows, two offsets,
    type of the pixels, number of further images. The comment follows, in sections
    `[Name],key=value,...`, then the pixels (HPD-TA User Manual, "ITEX file format").
    """
    start, rows, cols, kind, comment = _img_header(path)
    pixels = np.dtype(kind).itemsize * rows * cols
    whole_frames(
        path.name,
        frames=1,
        start=start,
        stride=pixels,
        frame_bytes=pixels,
        size=path.stat().st_size,
        partial=False,
    )
    data = np.memmap(path, kind, "r", start, (1, rows, cols))
    acquisition = comment.get("Acquisition", {})
    changes = [text for key, text in IMG_CORRECTIONS.items() if acquisition.get(key) == "-1"]
    notes = (
        [f"the camera's software changed the pixels: {' and '.join(changes)}"] if changes else []
    )
    if acquisition.get("AcqMode") == PHOTON_COUNTING:
        notes.append("the pixels are counts of photons, not grey values of a camera")
    return Recorded(data=data, names=(FRAME, ROW, COL), notes=tuple(notes))


def _img_header(path: Path) -> tuple[int, int, int, str, dict[str, dict[str, str]]]:
    """Return the position of the pixels, rows, columns, their type, and the comment."""
    with path.open("rb") as file:
        header = file.read(IMG_HEADER_BYTES)
        if len(header) < IMG_HEADER_BYTES or header[:2] != b"IM":
            raise BadInput(f"a .img file must begin as one of HiPic or HPD-TA, got {path}")
        length, cols, rows, _, _, kind, images = struct.unpack_from("<HHHHHHI", header, 2)
        text = file.read(length).decode("utf-8", "replace")
    if kind not in IMG_TYPES or images > 1:
        raise BadInput(
            f"a .img file must hold one image of 8, 16 or 32 bits, got type {kind} and {images} "
            f"images in {path}"
        )
    require_picture(rows, cols, path.name)
    comment = {
        name: {key.strip(): value.strip('" ') for key, value in IMG_ENTRY.findall(entries)}
        for name, entries in IMG_SECTION.findall(text)
    }
    return IMG_HEADER_BYTES + length, rows, cols, IMG_TYPES[kind], comment


def img_conditions(path: Path, extension: str | None = None) -> Stated:
    """Return exposure, gain of the microchannel plate and gate, summed exposures counted."""
    *_, comment = _img_header(path)
    acquisition, streak = comment.get("Acquisition", {}), comment.get("Streak camera", {})
    texts = {"exposure": acquisition.get("ExposureTime", ""), "gate": streak.get("Gate Time", "")}
    times, _ = stated_in_text(texts)
    summed = acquisition.get("AcqMode") in (PHOTON_COUNTING, ANALOG_INTEGRATION)
    return stated(
        number_of(acquisition.get("NrExposure")) or 1.0 if summed else 1.0,
        exposure_s=times.exposure_s,
        gain_control=number_of(streak.get("MCP Gain")),
        gate_ns=times.gate_ns,
    )
