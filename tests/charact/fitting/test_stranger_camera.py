"""Measure, fit and validate frames that no simulator of ours made: a linear camera of EMVA 1288 in
plain NumPy.

Of release 4.0: the mean K (eta mu_p + dark charge) + black level, photoelectrons and dark charge
Poisson, Gaussian read noise, DSNU and PRNU, rounding. There is no clamp: dark charge raises the
level. The edge is a step behind a circular pupil (Goodman, Introduction to Fourier Optics, 6.4),
Gaussian aberrations and square pixels, with veiling glare.
"""

from pathlib import Path

import numpy as np
import pytest

from charact import validation
from charact.fitting import fit_sensor
from charact.session_measurement import measure
from labdata import Session, open_session

ROWS, COLUMNS = 240, 320
BITS, PITCH_UM, WAVELENGTH_UM = 12, 5.5, 0.53
SHORT_S, LONG_S = 0.01, 1.0
# The dark side of the edge over its bright one, of the contrast 0.75.
DARK_SIDE = 1.0 / 7.0
TRUTH = {
    "video.conversion_gain_dn_per_e": 0.21,
    "ccd.quantum_efficiency": 0.55,
    "ccd.read_noise_e": 5.0,
    "ccd.dark_current_e_per_s": 60.0,
    "ccd.prnu": 0.009,
    "ccd.dsnu_e": 1.2,
    "optics.f_number": 2.8,
    "optics.aberration_blur_um": 3.3,
    "optics.veiling_glare_fraction": 0.015,
    # The level of the shortest dark: no clamp takes its charge off.
    "video.black_level_dn": 40.0 + 0.21 * 60.0 * SHORT_S,
}
# Half-widths of 95 % over the value: 6 % but for lens blur against diffraction, and glare against
# contrast.
WIDEST = {"optics.f_number": 0.4, "optics.veiling_glare_fraction": 1.0}


def edge_picture() -> np.ndarray:
    """Return light over that of the bright side, of an edge at 5 degrees, means over pixels; shape
    (row, col).
    """
    count, step_px, angle = 2**15, 1.0 / 64.0, np.deg2rad(5.0)
    frequency = np.fft.rfftfreq(count, step_px)
    x = np.minimum(frequency / PITCH_UM * WAVELENGTH_UM * TRUTH["optics.f_number"], 1.0)
    transfer = 2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x**2))
    transfer *= np.exp(
        -2.0 * (np.pi * frequency * TRUTH["optics.aberration_blur_um"] / PITCH_UM) ** 2
    )
    transfer *= np.sinc(frequency * np.cos(angle)) * np.sinc(frequency * np.sin(angle))
    line_spread = np.roll(np.fft.irfft(transfer, count), count // 2)
    edge_spread = np.cumsum(line_spread) - line_spread / 2.0
    row, col = np.arange(ROWS)[:, None] - ROWS / 2.0 + 0.5, np.arange(COLUMNS) - COLUMNS / 2.0 + 0.5
    distance = col * np.cos(angle) + row * np.sin(angle)
    light = DARK_SIDE + (1.0 - DARK_SIDE) * np.interp(
        distance, (np.arange(count) - count // 2) * step_px, edge_spread
    )
    glare = TRUTH["optics.veiling_glare_fraction"]
    return (1.0 - glare) * light + glare * light.mean()


class LinearCamera:
    """Camera of the linear model whose system gain is that of the truth, or so many times it."""

    def __init__(self, seed: int, gain: float = 1.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.gain = gain * TRUTH["video.conversion_gain_dn_per_e"]
        self.response = 1.0 + TRUTH["ccd.prnu"] * self.rng.standard_normal((ROWS, COLUMNS))
        self.offset_e = TRUTH["ccd.dsnu_e"] * self.rng.standard_normal((ROWS, COLUMNS))

    def expose(self, photons: np.ndarray | float, seconds: float, frames: int = 16) -> np.ndarray:
        """Return frames, shape (frame, row, col), DN."""
        mean_e = (
            TRUTH["ccd.quantum_efficiency"] * photons * self.response
            + TRUTH["ccd.dark_current_e_per_s"] * seconds
        )
        charge = self.rng.poisson(mean_e, (frames, ROWS, COLUMNS)) + self.offset_e
        charge = charge + TRUTH["ccd.read_noise_e"] * self.rng.standard_normal(charge.shape)
        return np.clip(np.rint(self.gain * charge + 40.0), 0, 2**BITS - 1).astype(np.uint16)


def session_of(
    folder: Path, stacks: list[tuple[str, str, np.ndarray, float, float, str]]
) -> Session:
    """Write stacks of kind, label, frames, exposure, photons and further keys; return the
    session.
    """
    lines = ['name = "stranger"', 'sensor = "machine-vision"', f"bit_depth = {BITS}"]
    for kind, label, frames, seconds, photons, more in stacks:
        np.save(folder / f"{label}.npy", frames)
        lit = (
            f"photons_per_px = {photons}\nwavelength_nm = {1000.0 * WAVELENGTH_UM}\n{more}"
            if photons
            else ""
        )
        lines.append(f'[[stack]]\nlabel = "{label}"\nkind = "{kind}"\nframes = "{label}.npy"')
        lines.append(f"exposure_s = {seconds}\ntemperature_c = 25.0\n{lit}")
    (folder / "session.toml").write_text("\n".join(lines))
    return open_session(folder)


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Session:
    camera, full = LinearCamera(1), 33_000.0  # photons at 94 % of full scale
    stacks = [
        ("dark", "dark", camera.expose(0.0, SHORT_S), SHORT_S, 0.0, ""),
        ("dark", "dark-long", camera.expose(0.0, LONG_S), LONG_S, 0.0, ""),
    ]
    for place, level in enumerate((0.08, 0.25, 0.45, 0.6, 0.75)):
        stacks.append(
            (
                "flat",
                f"flat-{place}",
                camera.expose(level * full, SHORT_S),
                SHORT_S,
                level * full,
                "",
            )
        )
    edge = camera.expose(0.7 * full * edge_picture(), SHORT_S)
    stacks.append(
        ("edge", "edge", edge, SHORT_S, 0.7 * full, "target = { contrast = 0.75, angle_deg = 5.0 }")
    )
    return session_of(tmp_path_factory.mktemp("stranger"), stacks)


@pytest.fixture(scope="module")
def fitted(session):
    return fit_sensor(session, measure(session, quick=True))


def test_every_interval_holds_the_truth(fitted):
    known = fitted.parameters()
    for path, truth in TRUTH.items():
        p = known[path]
        half = (p.high - p.low) / 2.0
        assert p.standing == "fitted", path
        assert abs(p.value - truth) < 3.0 / 1.96 * half, (
            f"{path} {p.value} [{p.low}, {p.high}], truth {truth}"
        )
        assert half < WIDEST.get(path, 0.06) * truth, path


def test_the_fit_names_what_the_description_cannot_have(fitted):
    assert not any("not-converged" in note or "model-misfit" in note for note in fitted.notes)
    assert any("dark level rises by 12.6 DN/s" in note for note in fitted.notes)


def test_validation_passes_on_the_camera(session, fitted):
    done = validation.validate(session, fitted)
    assert done.passed, [
        (one.name, one.worst, one.p_value) for one in done.statistics if not one.passed
    ]


def test_validation_fails_on_a_gain_of_20_percent_more(tmp_path, fitted):
    camera = LinearCamera(2, gain=1.2)
    dark = ("dark", "dark", camera.expose(0.0, SHORT_S, 8), SHORT_S, 0.0, "")
    flat = ("flat", "flat", camera.expose(12_000.0, SHORT_S, 8), SHORT_S, 12_000.0, "")
    done = validation.validate(session_of(tmp_path, [dark, flat]), fitted)
    assert {"level", "photon-transfer"} & {one.name for one in done.statistics if not one.passed}


def test_codes_shifted_left_round_to_their_steps(tmp_path):
    # 8 bits in 12: steps of 16 DN add 256/12 DN^2 of rounding to (0.21 x 60 e-)^2 = 159 DN^2 of
    # read noise, 6 % of it.
    camera = LinearCamera(3)
    noise_e = 60.0
    stacks = []
    for place, level in enumerate((0.0, 4000.0, 9000.0, 15_000.0)):
        frames = camera.expose(
            level, SHORT_S, 8
        ) + camera.gain * noise_e * camera.rng.standard_normal((8, ROWS, COLUMNS))
        codes = 16 * np.rint((frames + 200.0) / 16.0).astype(np.uint16)
        stacks.append(("flat" if level else "dark", f"stack-{place}", codes, SHORT_S, level, ""))
    session = session_of(tmp_path, stacks)
    p = fit_sensor(session, measure(session, quick=True)).parameters()["ccd.read_noise_e"]
    truth = np.hypot(noise_e, TRUTH["ccd.read_noise_e"])
    assert (
        abs(p.value - truth) < 3.0 / 1.96 * (p.high - p.low) / 2.0 and p.high - p.low < 0.1 * truth
    )
