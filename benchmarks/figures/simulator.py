"""Figures of docs/explanation/simulator.md and of the tutorial, by simulation, and the tutorial's
card.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmarks.figures import effect_plans
from benchmarks.figures.lab_card import CARD, card, luminance, radiance, shown
from labdata import Camera, Conditions, load_sensor, open_session, save_sensor
from simulate.camera import true_quantities
from simulate.camera.scene_to_photoelectrons import (
    camera_from_description,
    mcp_input_from_photoelectrons,
    photoelectrons_from_radiance,
)

FOLDER = Path("docs/pictures/simulator").resolve()
CAMERA = "pulnix-ag5745ef3"
GAINS = (500.0, 2500.0, 15000.0, 60000.0)
LUX = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
SEED = 4
# Of the tutorial's card: its white, DN, so that the pinhole still fits into 16 bits.
WHITE_DN = 60.0
# Greys of a picture full of noise: more cost bytes and show nothing.
GREYS = 96
# Rows and columns of a detail at fourfold size.
DETAIL = (74, 68)
FLAT_CONTRAST = 0.05
# Frames of video that the eye sees as one, about a quarter of a second.
AS_SEEN = 8
STAGES_WIDTH = 1400
TUTORIAL = ("--sensor", CAMERA, "--photoelectrons-per-dn", 0.18, "--frames", 16)
INK, PAPER = 235, 30

Picture = NDArray[np.floating]


def main() -> None:
    """Write all pictures, and the plans printed beside them."""
    sensor = load_sensor(CAMERA)
    FOLDER.mkdir(exist_ok=True)
    tutorial_card(FOLDER / "lab-card.tif")
    frames = dict(exposed(sensor))
    _save(contact_sheet(sensor, frames), FOLDER / "gains-and-levels.png")
    _save(details(sensor, frames), FOLDER / "details.png")
    stage_sheet(sensor, FOLDER / "stages.png")
    tutorial_frame(FOLDER / "tutorial.png")
    effect_plans.main()


def tutorial_card(path: Path) -> None:
    """Write the card as a picture of 16 bits, white at `WHITE_DN`."""
    import tifffile

    dn = np.round(luminance() * WHITE_DN).astype(np.uint16)
    tifffile.imwrite(path, dn, compression="zlib", predictor=True, software="charact")


def voltage(sensor: Camera, luminous_gain: float) -> float:
    """Return the plate's voltage for a luminous gain, V."""
    plate = sensor.microchannel_plate
    relative = luminous_gain / float(sensor.tube.luminous_gain)
    return float(plate.reference_v) * relative ** (1.0 / float(plate.gain_exponent))


def exposed(sensor: Camera) -> Iterator[tuple[tuple[float, float], Picture]]:
    """Yield the scene's frame, cut to what is shown, DN, for every level and gain."""
    camera = camera_from_description(sensor)
    at_one_lux = photoelectrons_from_radiance(
        camera, radiance(sensor, luminance(2), 1.0), Conditions()
    )
    for lux in LUX:
        freed = at_one_lux.with_values(at_one_lux.values * np.float32(lux))
        light = camera.to_mcp_input(freed, Conditions())
        for gain in GAINS:
            conditions = Conditions(mcp_v=voltage(sensor, gain))
            stream = camera.frames(light, conditions, seed=SEED)
            yield (lux, gain), next(stream)[shown()].astype(float)


def contact_sheet(sensor: Camera, frames: dict[tuple[float, float], Picture]) -> Image.Image:
    """Return one frame of every level (down) and gain (across), all on the same scale of DN, pixel
    for pixel.
    """
    known = true_quantities.true_quantities(sensor)
    nominal = float(sensor.tube.luminous_gain)
    rows, cols = next(iter(frames.values())).shape
    gap, left, top = 4, 104, 44
    sheet = Image.new(
        "L", (left + len(GAINS) * (cols + gap), top + len(LUX) * (rows + gap) + 22), PAPER
    )
    for across, gain in enumerate(GAINS):
        k = known["photoelectron_gain"] * gain / nominal
        text = f"{gain:,.0f} lm/lm\n{k:.2g} DN per photoelectron"
        _write(sheet, (left + across * (cols + gap), 8), text)
        for down, lux in enumerate(LUX):
            place = (left + across * (cols + gap), top + down * (rows + gap))
            sheet.paste(_grey(frames[lux, gain], 0.0, 255.0), place)
    for down, lux in enumerate(LUX):
        white = known["photoelectrons_per_lux"] * lux
        written = f"{white:.2g}" if white < 100.0 else f"{white:,.0f}"
        _write(
            sheet,
            (8, top + down * (rows + gap) + 4),
            f"{lux:.0e} lux,\n{written} photo-\nelectrons",
        )
    legend = (
        "single frames, 0 DN black to 255 DN white; lux on the cathode, photoelectrons per "
        "pixel and field: of white"
    )
    _write(sheet, (8, sheet.height - 18), legend)
    return sheet


def details(sensor: Camera, frames: dict[tuple[float, float], Picture]) -> Image.Image:
    """Return parts of those frames and of a flat field enlarged, each on its own scale, which is
    written above it.
    """
    panels = (
        (
            "single photoelectrons: white card\n1e-6 lux, 60,000 lm/lm, 0 to 100 DN",
            frames[1e-6, 60000.0],
            (112, 30),
            200,
        ),
        (
            "halo, electron by electron\n1e-4 lux, 15,000 lm/lm, 0 to 100 DN",
            frames[1e-4, 15000.0],
            (116, 121),
            100,
        ),
        (
            "halo of the same pinhole, rim\n1e-3 lux, 2,500 lm/lm, 0 to 60 DN",
            frames[1e-3, 2500.0],
            (116, 121),
            60,
        ),
        (
            "bars torn where multi-fibres meet\n1e-3 lux, 2,500 lm/lm, 0 to 110 DN",
            frames[1e-3, 2500.0],
            (2, 130),
            110,
        ),
    )
    pictures = [
        (text, _grey(_window(frame, corner, 4), 0.0, white), 4)
        for text, frame, corner, white in panels
    ]
    plain = with_plain_fibres(sensor)
    flats = (
        ("flat field, 1e-2 lux, 500 lm/lm", flat(sensor, lux=1e-2, luminous_gain=500.0)),
        ("more fibre pattern, less mottle, 1e-2 lux", flat(plain, lux=1e-2, luminous_gain=500.0)),
        ("the same, 1e-3 lux, 2,500 lm/lm", flat(plain, lux=1e-3, luminous_gain=2500.0)),
        ("the same, 1e-4 lux, 15,000 lm/lm", flat(plain, lux=1e-4, luminous_gain=15000.0)),
    )
    for text, frame in flats:
        part, mean = _window(frame, (120, 200), 2), float(frame.mean())
        grey = _grey(part, mean * (1 - FLAT_CONTRAST), mean * (1 + FLAT_CONTRAST))
        pictures.append(
            (
                f"{text}\n{AS_SEEN} frames, {100 * FLAT_CONTRAST:.0f} % to either side of the mean",
                grey,
                2,
            )
        )
    rows, cols, gap, top = 4 * DETAIL[0], 4 * DETAIL[1], 6, 36
    sheet = Image.new("L", (4 * (cols + gap), 2 * (rows + gap + top)), PAPER)
    for number, (text, picture, zoom) in enumerate(pictures):
        place = (number % 4 * (cols + gap), number // 4 * (rows + gap + top))
        _write(sheet, (place[0] + 4, place[1] + 4), text)
        size = (picture.width * zoom, picture.height * zoom)
        sheet.paste(picture.resize(size, Image.Resampling.NEAREST), (place[0], place[1] + top))
    return sheet


def with_plain_fibres(sensor: Camera) -> Camera:
    """Return the sensor whose honeycomb is as deep, and whose screen as even, as its description
    allows.
    """
    lines, mottle = sensor.taper.pattern_contrast, sensor.phosphor.gain_nonuniformity
    return sensor.with_parameters(
        {
            "taper.pattern_contrast": replace(lines, value=lines.high),
            "phosphor.gain_nonuniformity": replace(mottle, value=mottle.low),
        }
    )


def flat(sensor: Camera, *, lux: float, luminous_gain: float) -> Picture:
    """Return the mean of `AS_SEEN` frames of even light, DN above black."""
    camera, conditions = (
        camera_from_description(sensor),
        Conditions(mcp_v=voltage(sensor, luminous_gain)),
    )
    even = np.full(
        camera.shape, true_quantities.true_quantities(sensor)["photoelectrons_per_lux"] * lux
    )
    light = mcp_input_from_photoelectrons(camera, even, conditions)
    stream = camera.frames(light, conditions, seed=SEED)
    return np.mean(list(islice(stream, AS_SEEN)), axis=0) - float(sensor.video.black_level_dn)


def stage_sheet(sensor: Camera, path: Path) -> None:
    """Write the contact sheet that `charact simulate --stage-images` makes of the card's radiance,
    in fewer greys.

    The camera's chip is cut down to the card, so that a panel shows its pixels.
    """
    with tempfile.TemporaryDirectory() as folder:
        cube = radiance(sensor, card(2), 1e-4)
        source, small, stages = (
            Path(folder, name) for name in ("lab-card.npz", "small-chip.toml", "stages")
        )
        np.savez(source, wavelength_nm=cube.wavelength_nm, radiance=cube.radiance)
        save_sensor(replace(sensor, ccd=replace(sensor.ccd, rows=CARD[0], columns=CARD[1])), small)
        _charact(
            "simulate",
            source,
            Path(folder, "out"),
            "--sensor",
            small,
            "--frames",
            1,
            "--stage-images",
            stages,
        )
        with Image.open(stages / "stages.png") as sheet:
            grey = sheet.convert("L")
    _save(
        grey.resize(
            (STAGES_WIDTH, grey.height * STAGES_WIDTH // grey.width), Image.Resampling.LANCZOS
        ),
        path,
    )


def tutorial_frame(path: Path) -> None:
    """Write the first frame of the README's tutorial, cut to the card."""
    with tempfile.TemporaryDirectory() as folder:
        _charact("simulate", FOLDER / "lab-card.tif", Path(folder, "out"), *TUTORIAL)
        frame = open_session(Path(folder, "out")).stacks[0].read().data[0]
    _save(
        _grey(frame[shown()].astype(float), 0.0, 120.0).resize(
            (420, 380), Image.Resampling.NEAREST
        ),
        path,
    )


def _charact(*arguments: object) -> None:
    command = [Path(sys.executable).with_name("charact"), *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def _window(picture: Picture, corner: tuple[int, int], zoom: int) -> Picture:
    """The part of a picture that fills a panel when enlarged."""
    (row, col), (rows, cols) = corner, (n * 4 // zoom for n in DETAIL)
    return picture[row : row + rows, col : col + cols]


def _grey(picture: Picture, black: float, white: float) -> Image.Image:
    level = np.clip((picture - black) / (white - black), 0.0, 1.0)
    return Image.fromarray(
        np.round(np.round(level * (GREYS - 1)) * (255.0 / (GREYS - 1))).astype(np.uint8)
    )


def _write(sheet: Image.Image, place: tuple[int, int], text: str) -> None:
    ImageDraw.Draw(sheet).multiline_text(
        place, text, fill=INK, font=ImageFont.load_default(11), spacing=2
    )


def _save(sheet: Image.Image, path: Path) -> None:
    """Write a picture of few greys with its own palette, which is smaller."""
    sheet.quantize(128).save(path, optimize=True)


if __name__ == "__main__":
    main()
