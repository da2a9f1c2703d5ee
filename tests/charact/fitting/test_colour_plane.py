"""One colour plane of a mosaic: its samples lie two pixels apart, its pixels are those of the whole
camera.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import measure
from charact.fitting import fit_sensor
from charact.method import Context
from charact.validation import MatchedFrames, Validation, simulate_frames, validate
from labdata import (
    BadInput,
    Camera,
    Conditions,
    Curve,
    FrameStack,
    Kind,
    LoadedStackEntry,
    Result,
    Session,
    Target,
    load_camera,
    measurement_from_sd,
)
from labdata.camera.parameters import Draws
from simulate.lab import LabBench
from tests.truth.sessions import session_in_memory, stack_in_memory

# The pitch of the shipped description: light stated in photons leaves it, and lengths can be
# compared.
PITCH_UM, BLUR_UM, F_NUMBER = 5.5, 1.6, 2.8
TRUTH = {
    "optics.aberration_blur_um": BLUR_UM,
    "optics.f_number": F_NUMBER,
    "ccd.quantum_efficiency": 0.5,
    "ccd.read_noise_e": 6.0,
    "ccd.prnu": 0.008,
    "ccd.dsnu_e": 2.0,
    "video.black_level_dn": 60.0,
    "video.conversion_gain_dn_per_e": 0.31,
}
# Of the light on a green pixel, what the filters of the others leave.
LIGHT = {"r": 0.55, "g1": 1.0, "b": 0.35}
SITE = {"r": (0, 0), "g1": (0, 1), "b": (1, 1)}
GREEN = Conditions(exposure_s=0.02, wavelength_nm=530.0)
EDGE = Target(angle_deg=5.0)


def camera(rows: int, columns: int, **values: float) -> Camera:
    """Return the true camera."""
    sheet = load_camera("machine-vision")
    one = sheet.with_values({**TRUTH, **values})
    return replace(one, name="true mosaic", ccd=replace(one.ccd, rows=rows, columns=columns))


def mtf_of_plane(frequency_cy_per_px: np.ndarray) -> np.ndarray:
    """Return the MTF at cycles per sample of a plane: optics at f/(2 pitch), aperture sinc(f/2)."""
    per_mm = frequency_cy_per_px / (2e-3 * PITCH_UM)
    x = per_mm * 0.53e-3 * F_NUMBER
    diffraction = 2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x**2))
    blur = np.exp(-2.0 * (np.pi * per_mm * 1e-3 * BLUR_UM) ** 2)
    return diffraction * blur * np.sinc(frequency_cy_per_px / 2.0)


def session_of(
    plane: str, *, shape: tuple[int, int], frames: int, seed: int, photons: tuple[float, ...]
) -> Session:
    """Return a session of every second row and column of a whole camera's frames."""
    bench, row, col = LabBench(camera(*shape)), *SITE[plane]
    stacks: list[LoadedStackEntry] = []

    def add(kind: Kind, light: float | None, target: Target, exposure_s: float = 0.02) -> None:
        stated = replace(GREEN, photons_per_px=light, exposure_s=exposure_s)
        passed = replace(stated, photons_per_px=light and light * LIGHT[plane])
        whole = bench.expose(
            kind, target, passed, frames=frames, seed=1000 * seed + len(stacks)
        ).data
        kept = FrameStack(data=whole[:, row::2, col::2], plane=plane, sample_pitch_px=2)
        stacks.append(
            stack_in_memory(
                kind, kept, stated, label=f"{kind} {len(stacks)}", target=target, bit_depth=12
            )
        )

    add("dark", None, Target())
    add("dark", None, Target(), 0.9)
    for light in photons:
        add("flat", light, Target())
    add("edge", photons[-1], EDGE)
    return session_in_memory(stacks, camera=load_camera("machine-vision"), bit_depth=12)


def result_of(session: Session, rng: np.random.Generator) -> Result:
    """Return the MTF of the edge and the gain as unerring methods would measure them, with
    noise.
    """
    frequency = np.arange(0.0, 1.0, 0.01)
    sd = np.full(frequency.size, 0.004)
    # Errors of neighbouring frequencies go together.
    apart = np.abs(np.subtract.outer(frequency, frequency))
    root = np.linalg.cholesky(np.exp(-apart / 0.08) + 1e-9 * np.eye(frequency.size))
    value = mtf_of_plane(frequency) + sd * (root @ rng.standard_normal(frequency.size))
    label = session.of_kind("edge")[0].label
    curve = Curve(
        frequency_cy_per_px=frequency,
        value=value,
        stack=label,
        interval68=np.array([value - 0.994458 * sd, value + 0.994458 * sd]),
    )
    half = float(np.interp(-0.5, -value, frequency))
    gain = TRUTH["video.conversion_gain_dn_per_e"]
    return Result(
        measurements=(
            measurement_from_sd("mtf50", "cy/px", half, 0.004, method="told", stack=label),
            measurement_from_sd("system_gain", "DN/e-", gain, 0.005 * gain, method="told"),
        ),
        curves={f"mtf:{label}": curve},
    )


def shot(
    kind: Kind, target: Target, *, shape: tuple[int, int], frames: int, pitch_px: int = 2
) -> MatchedFrames:
    conditions = replace(GREEN, photons_per_px=None if kind == "dark" else 8000.0)
    return MatchedFrames(
        label=kind,
        kind=kind,
        conditions=conditions,
        target=target,
        frames=frames,
        corner=(0, 0),
        shape=shape,
        pitch_px=pitch_px,
    )


def test_a_fit_of_a_plane_finds_the_pixels_of_the_camera(seed: int) -> None:
    session = session_of(
        "g1",
        shape=(320, 400),
        frames=16,
        seed=seed,
        photons=(300.0, 1500.0, 4000.0, 8000.0, 13000.0),
    )
    fitted = fit_sensor(session, result_of(session, np.random.default_rng(seed)), seed=seed)
    found = fitted.parameters()
    assert all(found[path].standing == "fitted" for path in TRUTH)
    ends = {path: (found[path].low or 0.0, found[path].high or 0.0) for path in TRUTH}
    missed = [path for path, true in TRUTH.items() if not ends[path][0] <= true <= ends[path][1]]
    assert len(missed) <= 1  # of eight intervals of 95 %
    assert found["optics.aberration_blur_um"].value == pytest.approx(BLUR_UM, rel=0.25)
    assert (fitted.ccd.rows, fitted.ccd.columns) == (320, 400)
    assert float(fitted.ccd.pitch_x_um) == PITCH_UM
    assert any("plane g1 of a mosaic" in note for note in fitted.notes)


def test_the_edge_of_a_plane_is_measured_with_the_aperture_of_a_pixel(seed: int) -> None:
    frames = simulate_frames(
        camera(2, 2), (shot("edge", EDGE, shape=(192, 96), frames=16),), seed=seed
    )["edge"]
    stack = FrameStack(data=frames, black_level_dn=60.0, plane="g1", sample_pitch_px=2)
    found = measure("edge", stack, context=Context(quick=True, full_scale_dn=4095.0))
    (half,) = found.find("mtf50")
    fine = np.arange(0.01, 1.2, 0.001)
    low, high = half.interval95 or (0.0, 0.0)
    assert half.status == "ok"
    away = np.interp(-0.5, -mtf_of_plane(fine), fine) - half.value
    assert abs(away) < 4.5 * (high - low) / (2.0 * 1.96)
    assert not any("model-misfit" in one.flags for one in found.measurements)


def test_targets_of_a_plane_are_stated_in_its_samples(seed: int) -> None:
    bars = Target(bars=8, frequency_cy_per_px=0.125, angle_deg=0.0)
    frames = simulate_frames(
        camera(2, 2), (shot("bars", bars, shape=(64, 64), frames=4),), seed=seed
    )["bars"]
    row = frames.mean(axis=(0, 1)) - frames.mean()
    assert np.argmax(np.abs(np.fft.rfft(row))) == 8  # 0.125 cy of 64 samples
    pinhole = Target(pinhole_px=6.0)
    spot = simulate_frames(
        camera(2, 2), (shot("point", pinhole, shape=(64, 64), frames=4),), seed=seed
    )["point"]
    mean = spot.mean(axis=0) - np.median(spot)
    assert np.sqrt(np.sum(mean > 0.5 * mean.max()) * 4.0 / np.pi) == pytest.approx(6.0, abs=0.7)


def session_to_validate(plane: str, seed: int) -> Session:
    """Return a session whose frames are as large as a crop: the glare of an edge depends on the
    size of the frame.
    """
    return session_of(plane, shape=(240, 192), frames=8, seed=seed, photons=(2000.0, 8000.0))


def validation_of(session: Session, seed: int) -> Validation:
    """Validate the true camera, its gain known to a tenth of a percent."""
    gain = TRUTH["video.conversion_gain_dn_per_e"]
    drawn = gain * (1.0 + 1e-3 * np.random.default_rng(seed).standard_normal(40))
    draws = Draws(
        names=("video.conversion_gain_dn_per_e",), values=tuple((float(one),) for one in drawn)
    )
    return validate(session, replace(camera(2, 2), draws=draws), seed=seed)


def failing(validation: Validation) -> set[str]:
    return {one.title.split()[0] for one in validation.statistics if not one.passed}


def test_a_validation_passes_on_its_own_plane(seed: int) -> None:
    assert not failing(validation_of(session_to_validate("g1", seed), seed))


def test_a_validation_fails_with_another_plane_and_with_frames_taken_for_all_pixels(
    seed: int,
) -> None:
    assert "Level" in failing(validation_of(session_to_validate("b", seed), seed))
    session = session_to_validate("g1", seed)
    blind = tuple(
        replace(one, kept=replace(one.read(), plane="mono", sample_pitch_px=1))
        for one in session.stacks
        if isinstance(one, LoadedStackEntry)
    )
    assert "MTF" in failing(validation_of(replace(session, stacks=blind), seed))


def small(plane: str, pitch_px: int, label: str) -> LoadedStackEntry:
    kept = FrameStack(data=np.zeros((3, 8, 8), np.uint16), plane=plane, sample_pitch_px=pitch_px)
    return stack_in_memory("dark", kept, label=label)


def test_stacks_of_two_planes_are_refused_by_name() -> None:
    stacks = small("r", 2, "dark"), small("g1", 2, "flat")
    session = session_in_memory(stacks, name="s", camera=load_camera("machine-vision"))
    for use in (lambda: fit_sensor(session, Result()), lambda: validate(session, camera(2, 2))):
        with pytest.raises(
            BadInput, match="one colour plane, got r in 'dark' and g1 in 'flat' of session 's'"
        ):
            use()


def test_a_mosaic_behind_an_image_tube_is_refused() -> None:
    tube = load_camera("gen3-digital-iccd")
    session = session_in_memory((small("g1", 2, "dark"),), name="s", camera=tube)
    with pytest.raises(
        BadInput, match=f"without an image tube, got g1 of session 's', camera '{tube.name}'"
    ):
        fit_sensor(session, Result())
    with pytest.raises(BadInput, match="without an image tube"):
        validate(session, camera(2, 2))
