"""Which picture of a file is read, what its planes are, and what its header states."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.special import erf

import charact
from labdata import BadInput, open_session, read_frames
from tests.charact.cli.runner import charact as run
from tests.truth.camera_files import write_img, write_sif, write_spe

CASES = Path(__file__).resolve().parents[2].parent / "shared" / "cases"


def case(name: str) -> Path:
    folders = sorted(CASES.glob(f"{name}-*"))
    if not folders:
        pytest.skip(f"the case {name} is not among the shared data")
    return folders[0]


def measurements(*arguments: object) -> dict:
    done = run(*arguments, "--quick", "--json")
    assert done.exit_code == 0, done.stderr
    return {m["quantity"]: m for m in json.loads(done.stdout)["measurements"]}


def edge(sigma_px: float, size: int = 96, seed: int = 1) -> np.ndarray:
    """A 12-bit edge at 5 degrees, blurred by a Gaussian, shape (row, col)."""
    row, col = np.mgrid[:size, :size] - size / 2
    across = col * np.cos(np.deg2rad(5.0)) + row * np.sin(np.deg2rad(5.0))
    clean = 400.0 + 1300.0 * (1.0 + erf(across / sigma_px / np.sqrt(2.0)))
    return np.rint(clean + np.random.default_rng(seed).normal(0, 12, clean.shape)).astype(np.uint16)


def mtf50_of(sigma_px: float) -> float:
    """MTF50 of a Gaussian blur, cy/px."""
    return float(np.sqrt(np.log(2.0) / 2.0) / np.pi / sigma_px)


def manifest(folder: Path, frames: str, **keys: object) -> Path:
    """Write the session of one stack of flats, whose further keys are given as TOML."""
    lines = "".join(f"{key} = {value}\n" for key, value in keys.items())
    (folder / "session.toml").write_text(
        f'name = "s"\n[[stack]]\nlabel = "a"\nkind = "flat"\nframes = "{frames}"\n{lines}'
    )
    return folder


# Planes that a writer marked as colours


def marked(path: Path, data: np.ndarray, **options: object) -> Path:
    """Write an array as tifffile does where nothing states what its planes are."""
    with warnings.catch_warnings(action="ignore"):
        tifffile.imwrite(path, data, photometric="rgb", planarconfig="separate", **options)
    return path


def flats(path: Path, *, frames: int, size: int, kind: type, gain: float, read_noise_e: float):
    """Write a session of flats and darks of one gain, DN/e-, whose flats are marked as colours."""
    rng = np.random.default_rng(frames + size)
    read_dn, top = read_noise_e * gain, np.iinfo(kind).max

    def drawn(mean_e: float, count: int) -> np.ndarray:
        electrons = rng.poisson(mean_e, (count, size, size))
        signal = 10.0 + gain * electrons + rng.normal(0, read_dn, electrons.shape)
        return np.clip(np.rint(signal), 0, top).astype(kind)

    text = 'name = "marked"\n'
    tifffile.imwrite(path / "dark.tif", drawn(0.0, 8), photometric="minisblack")
    text += '[[stack]]\nlabel = "dark"\nkind = "dark"\nframes = "dark.tif"\n'
    for number, level in enumerate((0.05, 0.1, 0.2, 0.4, 0.6)):
        label = f"flat-{number}"
        marked(path / f"{label}.tif", drawn(level * top / gain, frames))
        text += f'[[stack]]\nlabel = "{label}"\nkind = "flat"\nframes = "{label}.tif"\n'
    (path / "session.toml").write_text(text)


def test_four_frames_marked_as_colours_and_alpha_are_frames_of_a_session():
    found = measurements("noise", case("r1"))
    assert found["system_gain"]["value"] == pytest.approx(0.40, rel=0.02)
    assert found["read_noise"]["value"] == pytest.approx(5.0 * 0.40, rel=0.03)


@pytest.mark.parametrize(
    ("size", "kind", "gain"), [(64, np.uint16, 0.8), (96, np.uint16, 6.0), (120, np.uint8, 0.05)]
)
def test_frames_of_other_depths_and_sizes_marked_so_are_frames_too(tmp_path, size, kind, gain):
    flats(tmp_path, frames=4, size=size, kind=kind, gain=gain, read_noise_e=12.0)
    found = measurements("noise", tmp_path)["system_gain"]
    low, high = found["interval95"]
    assert low - (high - low) / 4 < gain < high + (high - low) / 4


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_three_planes_marked_as_colours_are_refused_with_both_ways_out(tmp_path, kind):
    flats(tmp_path, frames=3, size=64, kind=kind, gain=0.05, read_noise_e=12.0)
    done = run("noise", tmp_path, "--quick")
    assert done.exit_code == 1
    for word in ("marks as colours", "--axis 0", "minisblack", "--plane luminance"):
        assert word in done.stderr
    text = (tmp_path / "session.toml").read_text()
    for setting, frames in (('axis = "0"', 3), ('plane = "luminance"', 1)):
        stated = text.replace('kind = "flat"', f'kind = "flat"\n{setting}')
        (tmp_path / "session.toml").write_text(stated)
        assert open_session(tmp_path).stack("flat-1").read().shape[0] == frames


def test_a_colour_picture_with_alpha_never_becomes_frames(tmp_path):
    """Alpha is one value; colours behind one another, pixel by pixel, are no frames either."""
    picture = np.random.default_rng(1).integers(0, 4000, (4, 40, 50)).astype(np.uint16)
    picture[3] = 65535
    marked(tmp_path / "planar.tif", picture)
    tifffile.imwrite(tmp_path / "pixels.tif", np.moveaxis(picture, 0, -1), photometric="rgb")
    with pytest.raises(BadInput, match="marks as colours: `axis` 0 if they are frames"):
        read_frames(tmp_path / "planar.tif", axis="frame")
    for name in ("planar.tif", "pixels.tif"):
        assert read_frames(tmp_path / name).plane == "luminance"
        assert np.array_equal(read_frames(tmp_path / name, "g").data[0], picture[1])
    assert read_frames(tmp_path / "pixels.tif", axis="frame").shape[0] == 1


def test_planes_of_a_program_that_states_no_array_stay_colours_in_a_session(tmp_path):
    picture = np.random.default_rng(1).integers(0, 4000, (4, 40, 50)).astype(np.uint16)
    marked(tmp_path / "a.tif", picture, metadata=None)
    frames = read_frames(tmp_path / "a.tif", axis="frame")
    assert frames.plane == "luminance"
    assert any("four planes" in note and "`axis` 0" in note for note in frames.notes)


# One picture of several


def mef(path: Path, images: dict[str, np.ndarray], primary: np.ndarray | None = None) -> Path:
    """Write a FITS file of image extensions, with a table between them."""
    fits = pytest.importorskip("astropy.io.fits")
    table = fits.BinTableHDU.from_columns([fits.Column("x", "J", array=np.arange(9))])
    units = [fits.ImageHDU(data, name=name) for name, data in images.items()]
    fits.HDUList([fits.PrimaryHDU(primary), units[0], table, *units[1:]]).writeto(path)
    return path


def test_the_first_of_four_amplifiers_is_named_with_the_others_and_each_can_be_chosen():
    file = case("bb1") / "m.fits"
    plain = measurements("mtf", "edge", file, "--method", "edge-slanted")["mtf50"]
    (note,) = (note for note in plain["notes"] if "AMP1" in note)
    for word in ("the first of 4", "2 AMP2", "3 AMP3", "4 AMP4", "--extension"):
        assert word in note
    for extension, truth in (("AMP1", 0.123), ("amp2", 0.220), ("3", 0.220), ("AMP4", 0.220)):
        chosen = measurements(
            "mtf", "edge", file, "--method", "edge-slanted", "--extension", extension
        )["mtf50"]
        assert chosen["value"] == pytest.approx(truth, rel=0.025)
        assert not any("the first of" in note for note in chosen["notes"])


def test_an_extension_is_chosen_by_name_or_number_in_every_way_of_reading(tmp_path):
    pictures = {"RED": edge(1.2), "NIR": edge(2.4)}
    file = mef(tmp_path / "a.fits", pictures, primary=edge(0.8)[:80, :90])
    assert read_frames(file).shape == (1, 80, 90)
    assert "0 (80 x 90) was read, the first of 3" in read_frames(file).notes[0]
    for extension, name in (("RED", "RED"), ("nir", "NIR"), ("1", "RED"), ("3", "NIR")):
        assert np.array_equal(read_frames(file, extension=extension).data[0], pictures[name])
    measured = charact.mtf(file, method="edge-slanted", extension="NIR").mtf50
    assert measured.value == pytest.approx(mtf50_of(2.4), rel=0.03)
    assert run("import", "frames", file, tmp_path / "S", "--extension", "NIR").exit_code == 0
    stack = open_session(tmp_path / "S").stacks[0]
    assert np.array_equal(stack.read().data[0], pictures["NIR"])
    assert run("convert", file, tmp_path / "out", "--extension", "RED").exit_code == 0
    assert np.array_equal(tifffile.imread(tmp_path / "out" / "a.tif")[0], pictures["RED"])


@pytest.mark.parametrize("wrong", ["BLUE", "2", "7", "", "-1"])
def test_a_wrong_extension_is_refused_with_the_list(tmp_path, wrong):
    file = mef(tmp_path / "a.fits", {"RED": edge(1.2), "NIR": edge(2.4)})
    with pytest.raises(BadInput, match=r"must be one of 1 RED \(96 x 96\), 3 NIR \(96 x 96\)"):
        read_frames(file, extension=wrong)


def test_a_name_that_two_extensions_have_is_chosen_by_number(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    units = [fits.ImageHDU(edge(width), name="SCI") for width in (1.0, 2.0)]
    fits.HDUList([fits.PrimaryHDU(), *units]).writeto(tmp_path / "a.fits")
    with pytest.raises(BadInput, match="which several have: choose by number"):
        read_frames(tmp_path / "a.fits", extension="SCI")
    assert np.array_equal(read_frames(tmp_path / "a.fits", extension="2").data[0], edge(2.0))


def test_packed_extensions_are_counted_as_plain_ones(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    units = [fits.CompImageHDU(edge(width), name=f"A{width:g}") for width in (1.0, 2.0, 3.0)]
    fits.HDUList([fits.PrimaryHDU(), *units]).writeto(tmp_path / "a.fits")
    for number, width in ((1, 1.0), (3, 3.0)):
        assert np.array_equal(
            read_frames(tmp_path / "a.fits", extension=str(number)).data[0], edge(width)
        )


def test_a_card_that_no_one_can_read_spoils_no_image(tmp_path):
    file = mef(tmp_path / "a.fits", {"RED": edge(1.2), "NIR": edge(2.4)})
    card = b"GCOUNT  =                    1"
    content = file.read_bytes().replace(card, b"STRANGE = 'half a text".ljust(len(card)))
    assert b"STRANGE" in content
    file.write_bytes(content)
    for extension, width in (("RED", 1.2), ("NIR", 2.4)):
        assert np.array_equal(read_frames(file, extension=extension).data[0], edge(width))


def test_arrays_of_hdf5_and_series_of_tiff_are_chosen_in_the_same_way(tmp_path):
    h5py = pytest.importorskip("h5py")
    small, large = edge(1.0, 64), edge(2.0, 96)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["entry/raw"], file["entry/small"] = large, small
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(small, metadata=None)
        file.write(large, metadata=None)
    note = read_frames(tmp_path / "a.h5").notes[0]
    assert "/entry/raw (96 x 96) was read, the largest of 2" in note
    for extension in ("/entry/small", "entry/small", "small", "1"):
        assert np.array_equal(read_frames(tmp_path / "a.h5", extension=extension).data[0], small)
    with pytest.raises(
        BadInput, match=r"one shape, got 0 .*64 x 64.*, 1 .*96 x 96.* `extension` 0"
    ):
        read_frames(tmp_path / "a.tif")
    for extension, data in (("0", small), ("1", large)):
        assert np.array_equal(read_frames(tmp_path / "a.tif", extension=extension).data[0], data)


def test_a_file_of_one_picture_has_no_extension(tmp_path):
    np.save(tmp_path / "a.npy", edge(1.0))
    with pytest.raises(BadInput, match="chooses a picture of a FITS, TIFF, HDF5 or SIF file"):
        read_frames(tmp_path / "a.npy", extension="1")
    with pytest.raises(BadInput, match="which holds one"):
        charact.noise(manifest(tmp_path, "a.npy", extension='"1"'), quick=True)
    with pytest.raises(BadInput, match="for an array"):
        charact.mtf(edge(1.0), extension="1")


# Cameras' own files

SIF_VERSIONS = [65540, 65542, 65547, 65550, 65555, 65558, 65559, 65564]


@pytest.mark.parametrize("version", SIF_VERSIONS)
@pytest.mark.parametrize("shape", [(1, 40, 50), (5, 33, 21)])
def test_frames_of_every_version_of_solis_are_those_that_were_written(tmp_path, version, shape):
    data = np.random.default_rng(version).normal(900.0, 30.0, shape).astype(np.float32)
    write_sif(tmp_path / "a.sif", data, version=version)
    assert np.array_equal(read_frames(tmp_path / "a.sif").data, data)


def test_frames_of_solis_are_those_that_another_reader_reads(tmp_path):
    sif_parser = pytest.importorskip("sif_parser")
    data = np.random.default_rng(1).normal(900.0, 30.0, (3, 40, 50)).astype(np.float32)
    write_sif(tmp_path / "a.sif", data, version=65550)
    with warnings.catch_warnings(action="ignore"), (tmp_path / "a.sif").open("rb") as file:
        assert np.array_equal(read_frames(file.name).data, sif_parser.np_open(file)[0])


def test_the_background_of_a_sif_file_is_its_second_picture(tmp_path):
    data, background = edge(1.0)[None], edge(3.0)[None]
    write_sif(tmp_path / "a.sif", data, background=background)
    assert np.array_equal(read_frames(tmp_path / "a.sif").data, data)
    assert "the first of 2" in read_frames(tmp_path / "a.sif").notes[0]
    assert np.array_equal(read_frames(tmp_path / "a.sif", extension="1").data, background)


@pytest.mark.parametrize(("missing_bytes", "whole"), [(40, 4), (4 * 2000 + 40, 3), (4 * 6001, 1)])
def test_the_whole_frames_of_a_sif_file_that_ends_early_are_read_on_request(
    tmp_path, missing_bytes, whole
):
    data = np.random.default_rng(1).normal(900.0, 30.0, (5, 40, 50)).astype(np.float32)
    content = write_sif(tmp_path / "a.sif", data).read_bytes()
    end = content.index(data.tobytes()) + data.nbytes
    (tmp_path / "a.sif").write_bytes(content[: end - missing_bytes])
    with pytest.raises(BadInput, match=f"than its 5 frames: `partial` reads the {whole} that"):
        read_frames(tmp_path / "a.sif")
    stack = read_frames(tmp_path / "a.sif", partial=True)
    assert np.array_equal(stack.data, data[:whole])
    assert stack.notes == (f"the file ends early: the {whole} whole frames of 5 were read",)
    assert run("convert", tmp_path / "a.sif", tmp_path / "o", "--partial").exit_code == 0
    assert np.array_equal(
        tifffile.imread(tmp_path / "o" / "a.tif").reshape(-1, 40, 50), data[:whole]
    )
    assert run("import", "frames", tmp_path / "a.sif", tmp_path / "S", "--partial").exit_code == 0
    assert len(open_session(tmp_path / "S").stacks[0].read()) == whole


COMMENT = (
    '[Application],Date="20/01/2023",Software="HPD-TA"\r\n[Camera],CameraName="Orca R2"\r\n'
    "[Acquisition],NrExposure={number},ExposureTime={time},AcqMode={mode},"
    'areSource="0,0,672,512",BacksubCorr={background},ShadingCorr=0\r\n'
    '[Streak camera],DeviceName="C5680",MCP Gain="20",Gate Time="0"[Comment],UserComment=""'
)


def comment(number: int = 1, time: str = "5 s", mode: int = 2, background: int = 0) -> str:
    return COMMENT.format(number=number, time=time, mode=mode, background=background)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32])
@pytest.mark.parametrize("shape", [(40, 60), (33, 21)])
def test_the_pixels_of_a_hamamatsu_file_are_those_that_were_written(tmp_path, kind, shape):
    image = np.random.default_rng(1).integers(0, np.iinfo(kind).max, shape).astype(kind)
    write_img(tmp_path / "a.img", image, comment())
    found = read_frames(tmp_path / "a.img")
    assert np.array_equal(found.data[0], image)
    assert not found.notes
    write_img(tmp_path / "a.img", image, comment(background=-1))
    assert "a background was subtracted" in read_frames(tmp_path / "a.img").notes[0]


# What headers state


def stated_by(path: Path, **keys: object) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the conditions of a session's one stack, with its notes."""
    session = open_session(manifest(path.parent, path.name, **keys))
    conditions = vars(session.stacks[0].conditions)
    return {name: value for name, value in conditions.items() if value is not None}, session.notes


FRAMES = np.full((2, 16, 20), 100, np.uint16)
LIGHTFIELD = """<Experiment><Devices><Cameras><Camera>
    <ShutterTiming><ExposureTime type="Double">20</ExposureTime></ShutterTiming>
    <Sensor><Temperature><Reading>-25</Reading><SetPoint>-25</SetPoint></Temperature></Sensor>
    <Intensifier><Gain type="Int32">50</Gain></Intensifier><ADC><EMGain>1</EMGain></ADC>
    <Gating><RepetitiveGate><Pulse width="100" delay="25"/></RepetitiveGate></Gating>
    <FrameCombination><Method>Sum</Method><FramesCombined>5</FramesCombined></FrameCombination>
    </Camera></Cameras></Devices></Experiment>"""


def png(path: Path, **texts: str) -> None:
    from PIL import Image, PngImagePlugin

    info = PngImagePlugin.PngInfo()
    for at, (key, text) in enumerate(texts.items()):
        if at % 3 == 2:
            info.add_itxt(key, text)
        else:
            info.add_text(key, text, zip=at % 3 == 1)
    Image.fromarray(FRAMES[0]).save(path, pnginfo=info)


def cards(path: Path, primary: dict | None = None, **header: object) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    if primary is None:
        fits.writeto(path, FRAMES, fits.Header({**header, "NUMKIN": len(FRAMES)}))
        return
    units = (
        fits.PrimaryHDU(header=fits.Header(primary)),
        fits.ImageHDU(FRAMES[0], fits.Header(header)),
    )
    fits.HDUList(list(units)).writeto(path)


HEADERS = {
    "emccd.sif": (
        lambda path: write_sif(path, FRAMES, gain=300, real_gain=True, exposure_s=0.02),
        {"exposure_s": 0.02, "temperature_c": -70.0, "em_gain": 300.0},
    ),
    "old.sif": (
        lambda path: write_sif(path, FRAMES, version=65540, temperature_c=-20.0),
        {"exposure_s": 0.02, "temperature_c": -20.0},
    ),
    "unstable.sif": (
        lambda path: write_sif(path, FRAMES, version=65548, temperature_c=-999.0),
        {"exposure_s": 0.02},
    ),
    "istar.sif": (
        lambda path: write_sif(path, FRAMES, head="DH734_18mm", gain=180, gate_ps=750000.0),
        {"exposure_s": 0.02, "temperature_c": -70.0, "gain_control": 180.0, "gate_ns": 750.0},
    ),
    "oldest-istar.sif": (
        lambda path: write_sif(path, FRAMES, version=65541, head="DH501", gain=4, gate_ps=5e3),
        {"exposure_s": 0.02, "temperature_c": -70.0, "gain_control": 4.0, "gate_ns": 5.0},
    ),
    "accumulated.sif": (
        lambda path: write_sif(path, FRAMES, mode=2, accumulations=5),
        {"exposure_s": 0.1, "temperature_c": -70.0},
    ),
    "single.sif": (
        lambda path: write_sif(path, FRAMES, mode=1, accumulations=5),
        {"exposure_s": 0.02, "temperature_c": -70.0},
    ),
    "winview.spe": (
        lambda path: write_spe(path, FRAMES, exp_sec=0.05, DetTemperature=-40.0, avgexp=1),
        {"exposure_s": 0.05, "temperature_c": -40.0},
    ),
    "pimax.spe": (
        lambda path: write_spe(
            path,
            FRAMES,
            exp_sec=0.05,
            DetTemperature=-20.0,
            avgexp=-1,
            lavgexp=40000,
            PImaxUsed=1,
            PImaxGain=128,
            PulseRepWidth=0.25,
        ),
        {"exposure_s": 2000.0, "temperature_c": -20.0, "gain_control": 128.0, "gate_ns": 1e7},
    ),
    "unset.spe": (lambda path: write_spe(path, FRAMES), {}),
    "lightfield.spe": (
        lambda path: write_spe(path, FRAMES, LIGHTFIELD),
        {
            "exposure_s": 0.1,
            "temperature_c": -25.0,
            "gain_control": 50.0,
            "em_gain": 1.0,
            "gate_ns": 500.0,
        },
    ),
    "integrated.img": (
        lambda path: write_img(path, FRAMES[0], comment(number=4, mode=4)),
        {"exposure_s": 20.0, "gain_control": 20.0},
    ),
    "acquired.img": (
        lambda path: write_img(path, FRAMES[0], comment(number=4, time="100 ms", mode=2)),
        {"exposure_s": 0.1, "gain_control": 20.0},
    ),
    "text.png": (
        lambda path: png(path, Exposure="10 ms", Gain="6 dB", Gate="200 ns", Author="5 s"),
        {"exposure_s": 0.01, "camera_gain_db": 6.0, "gate_ns": 200.0},
    ),
    "keys.png": (
        lambda path: png(path, exposure_us="500", temperature_c="-20.5", Comment="night"),
        {"exposure_s": 5e-4, "temperature_c": -20.5},
    ),
    "cube.fits": (
        lambda path: cards(path, EXPTIME=0.5, GAIN=120, EGAIN=1.4, **{"CCD-TEMP": -10.0}),
        {"exposure_s": 0.5, "temperature_c": -10.0},
    ),
    "andor.fits": (
        lambda path: cards(
            path, EXPOSURE=0.5, TEMP=-70.0, GAIN=250, EMREALGN=1, OUTPTAMP="Electron Multiplying"
        ),
        {"exposure_s": 0.5, "temperature_c": -70.0, "em_gain": 250.0},
    ),
    "extension.fits": (
        lambda path: cards(path, {"EXPTIME": 3.0, "CCD-TEMP": -999.0}, GAIN=2.0),
        {"exposure_s": 3.0},
    ),
}


@pytest.mark.parametrize("name", HEADERS)
def test_what_a_header_states_are_the_conditions_of_the_stack(tmp_path, name):
    write, truth = HEADERS[name]
    write(tmp_path / name)
    found, notes = stated_by(tmp_path / name)
    assert found == pytest.approx(truth)
    assert any("by the headers of the files" in note for note in notes) == bool(truth)
    sums = name in ("accumulated.sif", "pimax.spe", "lightfield.spe", "integrated.img")
    assert any("is the sum of" in note for note in notes) == sums


def test_a_session_precedes_the_header_and_a_contradiction_is_told(tmp_path):
    write_sif(tmp_path / "a.sif", FRAMES, exposure_s=0.02)
    found, notes = stated_by(tmp_path / "a.sif", exposure_s=0.05, temperature_c=-69.5)
    assert found == {"exposure_s": 0.05, "temperature_c": -69.5}
    (note,) = notes
    assert "exposure_s 0.05 by the session and 0.02 by the headers" in note
    done = run("noise", tmp_path, "--quick")
    assert "exposure_s 0.05 by the session and 0.02 by the headers" in done.stderr
    assert not stated_by(tmp_path / "a.sif", exposure_s=0.02, temperature_c=-70)[1]
    assert "headers" not in run("noise", tmp_path, "--quick").stderr


def test_files_of_a_stack_that_contradict_each_other_give_no_condition(tmp_path):
    for at, exposure_s in enumerate((0.02, 0.04)):
        write_sif(tmp_path / f"{at}.sif", FRAMES, exposure_s=exposure_s, temperature_c=-70 - at / 2)
    (tmp_path / "session.toml").write_text(
        'name = "s"\n[[stack]]\nlabel = "a"\nkind = "dark"\nframes = ["0.sif", "1.sif"]\n'
    )
    session = open_session(tmp_path)
    assert session.stacks[0].conditions.exposure_s is None
    assert session.stacks[0].conditions.temperature_c == -70.25
    assert session.stacks[0].from_headers == ("temperature_c",)
    assert any("exposure_s of 0.02 to 0.04: not used" in note for note in session.notes)


def test_a_number_without_a_unit_is_not_a_condition(tmp_path):
    png(tmp_path / "a.png", Exposure="10", Gain="3")
    found, notes = stated_by(tmp_path / "a.png")
    assert not found
    assert sum("has no unit" in note for note in notes) == 2


def test_a_damaged_header_leaves_the_session_open(tmp_path):
    write_sif(tmp_path / "a.sif", FRAMES)
    (tmp_path / "a.sif").write_bytes((tmp_path / "a.sif").read_bytes()[:300])
    assert stated_by(tmp_path / "a.sif") == ({}, ())
    with pytest.raises(BadInput, match="must describe its frames"):
        open_session(tmp_path).stacks[0].read()


def test_the_header_of_a_file_is_used_in_python_and_on_import(tmp_path):
    write_sif(tmp_path / "a.sif", FRAMES, exposure_s=0.02)
    assert charact.stack(tmp_path / "a.sif", "dark").conditions.exposure_s == 0.02
    assert charact.stack(tmp_path / "a.sif", "dark", exposure_s=0.3).conditions.exposure_s == 0.3
    done = run("import", "frames", tmp_path / "a.sif", tmp_path / "S")
    assert "exposure_s, temperature_c of the stack: by the headers" in done.stdout
