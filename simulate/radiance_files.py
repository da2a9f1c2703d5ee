"""Radiance of a view as a file, .npz, FITS, ENVI or OpenEXR, with bands, units and geometry."""

from pathlib import Path
from struct import pack
from typing import TYPE_CHECKING, Any

import numpy as np

from labdata import BadInput, write_atomically

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from simulate.infrared_view import InfraredView
    from simulate.outdoor_rendering import RenderedView

# Formats and endings of their files; the data of an ENVI header lie in a file of the ending .raw in
# the same folder.
FORMATS = {"npz": ".npz", "fits": ".fits", "envi": ".hdr", "exr": ".exr"}
SPECTRAL, BINNED = "W m-2 sr-1 nm-1", "W m-2 sr-1"


def save_view_radiance(view: "RenderedView | InfraredView", path: Path) -> None:
    """Write the radiance of a view; the ending of the path, one of `FORMATS`, states the format.

    Parameters
    ----------
    view
        A rendering of an outdoor scene.
    path
        The file. An .npz has `radiance` (band, row, col) with `wavelength_nm` or, of an infrared
        one, whose radiance is that in each bin, `edges_um`; `unit`; and of the lens `position_m`,
        `forward`, `focal_px` (x, y), `roll_deg` and `distortion_fraction`, and `range_m` (row,
        col). The other formats have the same: FITS as image, header, and extensions for bands and
        range; ENVI as float32 by bands with a header, but without the range; OpenEXR as one float32
        channel a band and the channel `range_m`, uncompressed.

    Raises
    ------
    BadInput
        If the ending is another, or astropy is missing for FITS.

    Notes
    -----
    ENVI header: fields of the ENVI user guide, which GDAL and Spectral Python read; the pose is in
    further fields. OpenEXR: "OpenEXR File Layout" of openexr.com; names of channels by Fichet,
    Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10(3), 2021, with a decimal
    comma, S0.550,000000nm; of infrared bins their middle.
    """
    writers = {
        ".npz": lambda content, path: np.savez_compressed(path, **content),
        ".fits": _write_fits,
        ".hdr": _write_envi,
        ".exr": _write_exr,
    }
    if path.suffix not in writers:
        raise BadInput(f"a file of radiance must end in {', '.join(writers)}, got {path.name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    writers[path.suffix](_content(view), path)


def _write_fits(content: dict[str, Any], path: Path) -> None:
    from labdata.importers.axes import optional_module

    fits = optional_module("astropy.io.fits", "fits", path)
    image = fits.PrimaryHDU(content["radiance"])
    image.header["BUNIT"] = content["unit"]
    image.header["FOCALX"], image.header["FOCALY"] = content["focal_px"]
    image.header["ROLL"], image.header["DISTORT"] = (
        content["roll_deg"],
        content["distortion_fraction"],
    )
    for name, key in (("position_m", "POS"), ("forward", "AXIS")):
        for axis, value in zip("XYZ", content[name], strict=True):
            image.header[f"{key}{axis}"] = value
    table_names = [name for name in ("range_m", "wavelength_nm", "edges_um") if name in content]
    tables = [fits.ImageHDU(np.asarray(content[name]), name=name.upper()) for name in table_names]
    fits.HDUList([image, *tables]).writeto(path, overwrite=True)


def _bands(
    content: dict[str, Any],
) -> "tuple[str, NDArray[np.floating], NDArray[np.floating] | None]":
    """Return the unit of wavelengths, those of the bands, and of bins their widths."""
    if "wavelength_nm" in content:
        return "nm", np.asarray(content["wavelength_nm"], float), None
    edges = np.asarray(content["edges_um"], float)
    return "um", 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)


def _write_envi(content: dict[str, Any], path: Path) -> None:
    data = np.ascontiguousarray(content["radiance"], "<f4")
    bands, rows, columns = data.shape
    unit, centres, widths = _bands(content)

    def among(values: Any) -> str:
        return (
            "{"
            + ", ".join(value if isinstance(value, str) else f"{value:.9g}" for value in values)
            + "}"
        )

    fields = {
        "description": among([f"radiance, {content['unit']}"]),
        "samples": columns,
        "lines": rows,
        "bands": bands,
        "header offset": 0,
        "file type": "ENVI Standard",
        "data type": 4,
        "interleave": "bsq",
        "byte order": 0,
        "band names": among(f"{centre:.6g} {unit}" for centre in centres),
        "wavelength units": {"nm": "Nanometers", "um": "Micrometers"}[unit],
        "wavelength": among(centres),
        **({} if widths is None else {"fwhm": among(widths)}),
        "z plot titles": among([f"Wavelength ({unit})", f"Radiance ({content['unit']})"]),
        "radiance unit": content["unit"],
        **{
            name.replace("_", " "): among(content[name])
            for name in ("position_m", "forward", "focal_px")
        },
        **{
            name.replace("_", " "): f"{content[name]:.9g}"
            for name in ("roll_deg", "distortion_fraction")
        },
    }
    write_atomically(path.with_suffix(".raw"), data.tobytes())
    lines = ["ENVI", *(f"{name} = {value}" for name, value in fields.items())]
    write_atomically(path, ("\n".join(lines) + "\n").encode("ascii"))


def _write_exr(content: dict[str, Any], path: Path) -> None:
    unit, centres, _ = _bands(content)
    names = [f"S0.{centre:.6f}{unit}".replace(".", ",").replace(",", ".", 1) for centre in centres]
    planes = dict(zip(names, content["radiance"], strict=True)) | {"range_m": content["range_m"]}
    channels = sorted(planes)
    # Values of a row lie channel by channel in the order of the names: (row, channel, col).
    data = np.stack([np.asarray(planes[name], "<f4") for name in channels], axis=1)
    rows, _, columns = data.shape
    # 32-bit float, not for perception, every column and row
    of_channel = pack("<iB3xii", 2, 0, 1, 1)
    window = pack("<4i", 0, 0, columns - 1, rows - 1)
    radiance_unit = content["unit"].replace(" ", ".").replace("-", "^-")
    attributes = [
        (
            "channels",
            "chlist",
            b"".join(name.encode() + b"\0" + of_channel for name in channels) + b"\0",
        ),
        ("compression", "compression", b"\0"),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", pack("<f", content["focal_px"][1] / content["focal_px"][0])),
        ("screenWindowCenter", "v2f", pack("<2f", 0.0, 0.0)),
        ("screenWindowWidth", "float", pack("<f", columns / content["focal_px"][0])),
        ("spectralLayoutVersion", "string", b"1.0"),
        ("emissiveUnits", "string", radiance_unit.encode()),
        ("position_m", "v3f", pack("<3f", *content["position_m"])),
        ("forward", "v3f", pack("<3f", *content["forward"])),
        ("focal_px", "v2f", pack("<2f", *content["focal_px"])),
        ("roll_deg", "float", pack("<f", content["roll_deg"])),
        ("distortion_fraction", "float", pack("<f", content["distortion_fraction"])),
    ]
    header = b"".join(
        b"\0".join((name.encode(), kind.encode(), pack("<i", len(value)) + value))
        for name, kind, value in attributes
    )
    # magic number, version of single scan-line images
    preamble = pack("<2i", 20000630, 2) + header + b"\0"
    row_bytes = data[0].nbytes
    row_offsets = len(preamble) + 8 * rows + (8 + row_bytes) * np.arange(rows, dtype="<u8")
    blocks = np.empty(
        rows, np.dtype([("row", "<i4"), ("size", "<i4"), ("data", "<f4", data.shape[1:])])
    )
    blocks["row"], blocks["size"], blocks["data"] = np.arange(rows), row_bytes, data
    write_atomically(path, preamble + row_offsets.astype("<u8").tobytes() + blocks.tobytes())


def _content(view: "RenderedView | InfraredView") -> dict[str, Any]:
    from simulate.infrared_view import InfraredView

    lens, picture = view.viewpoint, view.picture
    geometry = {
        "position_m": np.asarray(lens.position_m, float),
        "forward": np.asarray(lens.forward, float),
        "focal_px": np.asarray(lens.focal_px, float),
        "roll_deg": float(lens.roll_deg),
        "distortion_fraction": float(lens.distortion_fraction),
        "range_m": picture.truth.range_m,
    }
    if isinstance(view, InfraredView):
        planes = np.ascontiguousarray(np.moveaxis(view.picture.radiance, 2, 0))
        light = {"radiance": planes, "edges_um": np.asarray(view.picture.edges_um), "unit": BINNED}
    else:
        cube = view.picture.cube
        light = {"radiance": cube.radiance, "wavelength_nm": cube.wavelength_nm, "unit": SPECTRAL}
    return light | geometry
