"""Others' benches: targets at random places, phases and angles, light of unknown colour or amount,
and light that drifts.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from charact.method import Context
from charact.observables.frame_view import FrameView
from charact.validation import GROUPS, MatchedFrames, MatchedStacks, simulate_frames
from charact.validation.session_bench import measured_bench
from charact.validation.simulated_frames import bench_of, light_of, mean_of
from charact.validation.target_features import SetStacks
from labdata import Camera, Conditions, Kind, Target, load_camera

EMCCD, TUBE = "emccd-512", "pulnix-ag5745ef3"
PLAIN = Target()
# Illuminance of an edge and a point, lux, and conditions.
LIGHT = {
    EMCCD: (4e-3, 1.6e-2, Conditions(em_gain=50.0, temperature_c=-20.0, exposure_s=0.025)),
    TUBE: (2e-4, 2e-2, Conditions(mcp_v=800.0, gate_ns=1.6e7)),
}
SIZE: dict[str, tuple[int, int]] = {"dark": (32, 32), "flat": (32, 48), "point": (48, 48)}


def shot(name: str, kind: Kind, target: Target = PLAIN, lux: float | None = None, **more):
    """Return a stack that is compared, of a shipped camera."""
    conditions = replace(LIGHT[name][2], illuminance_lux=lux)
    across = kind == "edge" and abs(np.sin(np.deg2rad(target.angle_deg or 0.0))) > 0.7
    shape = SIZE.get(kind, (64, 96) if across else (96, 64))
    fields = {"label": kind, "frames": 8, "corner": (0, 0), "shape": shape, **more}
    return MatchedFrames(kind=kind, conditions=conditions, target=target, **fields)


def stacks_of(measured, flats=(), edge=None, point=None, bars=(), name=EMCCD) -> MatchedStacks:
    """Return the stacks of a validation with their measured frames."""
    dark = shot(name, "dark")
    rng = np.random.default_rng(0)
    frames = {"dark": rng.normal(200.0, 2.0, (8, *dark.shape)), **measured}
    return MatchedStacks(
        dark=dark, flats=flats, edge=edge, point=point, display_only=bars, measured=frames, notes=()
    )


def drawn(mean: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return eight frames of photons and reading, whole DN: 10 DN a photon, 3 DN read noise."""
    photons = rng.poisson(mean / 10.0, (8, *mean.shape)) * 10.0
    return np.rint(200.0 + photons + rng.normal(0.0, 3.0, photons.shape))


@pytest.mark.parametrize("radius_px", [0.7, 2.0])
def test_a_pinhole_drawn_in_numpy_is_found_where_it_lies(seed: int, radius_px: float) -> None:
    """The camera's own blur, .6 px, is none of these."""
    rng, camera = np.random.default_rng(seed), load_camera(EMCCD)
    for _ in range(5):
        offset = rng.uniform(-3.0, 3.0, 2)
        across = [
            np.diff(0.5 * erf((np.arange(49) - 24.0 - length) / np.sqrt(2.0) / radius_px))
            for length in offset
        ]
        frames = drawn(3e4 * np.outer(*across) + 20.0, rng)
        point = shot(EMCCD, "point", Target(pinhole_px=1.0), 1e-2)
        placed = measured_bench(stacks_of({"point": frames}, point=point), camera).point
        # 3,000 photons place a spot to its radius over their root.
        assert placed.offset_px == pytest.approx(offset, abs=4.5 * radius_px / np.sqrt(24e3) + 0.01)


def test_an_edge_drawn_in_numpy_is_found_at_its_place_angle_and_polarity(seed: int) -> None:
    rng, camera = np.random.default_rng(seed), load_camera(EMCCD)
    for quarter in range(4):
        angle_deg, shift = 90.0 * quarter + rng.uniform(-12.0, 12.0), rng.uniform(-2.0, 2.0)
        # Nothing is stated of its angle.
        edge = shot(EMCCD, "edge", Target(), 4e-3, shape=(96, 96))
        y, x = np.indices(edge.shape) - 47.5
        normal = np.array([np.sin(np.deg2rad(angle_deg)), np.cos(np.deg2rad(angle_deg))])
        distance = x * normal[1] + y * normal[0] - shift
        frames = drawn(100.0 + 2e3 * (1.0 + erf(distance / np.sqrt(2.0))), rng)
        placed = measured_bench(stacks_of({"edge": frames}, edge=edge), camera).edge
        turned = (placed.target.angle_deg - angle_deg + 180.0) % 360.0 - 180.0
        assert turned == pytest.approx(0.0, abs=0.06)
        assert np.dot(placed.offset_px, normal) == pytest.approx(shift, abs=0.03)


def test_bars_are_found_at_their_phase_and_an_angle_otherwise_stated_is_noted(seed: int) -> None:
    rng, camera = np.random.default_rng(seed), load_camera(EMCCD)
    target = Target(bars=4, frequency_cy_per_px=0.15, angle_deg=6.5)
    offset = tuple(rng.uniform(-3.0, 3.0, 2))
    bars = shot(EMCCD, "bars", target, 4e-3, shape=(96, 96), offset_px=offset)
    measured = simulate_frames(camera, (bars,), seed=seed)
    stated = replace(bars, target=replace(target, angle_deg=4.0), offset_px=(0.0, 0.0))
    bench = measured_bench(stacks_of(measured, bars=(stated,)), camera)
    (placed,) = bench.display_only
    assert placed.offset_px == pytest.approx(offset, abs=0.03)
    assert placed.target.angle_deg == pytest.approx(6.5, abs=0.1)
    assert any("is stated at 4 deg and measured at 6.5" in note for note in bench.notes)


def numbers_of(frames, camera: Camera) -> dict[str, float]:
    """Return the numbers of edge and point."""
    context = Context(
        quick=True,
        camera=camera if camera.has_tube else None,
        interlaced=camera.video.interlaced,
        full_scale_dn=2.0**camera.video.bit_depth - 1.0,
    )
    stacks = SetStacks(
        darks=(FrameView("dark", frames["dark"], interlaced=camera.video.interlaced),),
        flats=(),
        context=context,
        edge=frames["edge"],
        point=frames["point"],
    )
    groups = ("mtf", "edge", "point")
    return {k: v for name in groups for k, v in GROUPS[name].numbers(stacks).items()}


@pytest.mark.parametrize("name", [EMCCD, TUBE])
def test_targets_at_random_places_look_like_those_simulated_where_they_are_found(
    name: str, seed: int
) -> None:
    rng, camera = np.random.default_rng(seed), load_camera(name)
    edge_lux, point_lux, _ = LIGHT[name]
    dark = shot(name, "dark")
    angle_deg = 90.0 * rng.integers(4) + rng.uniform(-12.0, 12.0)
    edge = shot(name, "edge", Target(angle_deg=angle_deg), edge_lux, frames=16)
    point = shot(name, "point", Target(pinhole_px=1.0), point_lux)
    true = [replace(of, offset_px=tuple(rng.uniform(-2.0, 2.0, 2))) for of in (edge, point)]
    measured = simulate_frames(camera, (dark, *true), seed=seed)
    chosen = replace(stacks_of({}, edge=edge, point=point, name=name), measured=measured)
    bench = measured_bench(chosen, camera)
    sets = [
        numbers_of(simulate_frames(camera, shots, seed=seed + 10 * run, like=camera), camera)
        for run in range(1, 6)
        for shots in [(dark, bench.edge, bench.point)]
    ]
    found = numbers_of(measured, camera)
    labels = [label for label in sets[0] if np.isfinite([of[label] for of in sets]).all()]
    values = np.array([[of[label] for label in labels] for of in sets])
    # The scatter of five sets is known to a third: of Student's t with four degrees of freedom
    # the largest of 30 values is below 15 in 997 of 1,000 trials.
    z = (np.array([found[label] for label in labels]) - values.mean(axis=0)) / (
        values.std(axis=0, ddof=1) * np.sqrt(6.0 / 5.0) + 1e-4
    )
    assert len(labels) > 20
    assert np.abs(z).max() < 15.0, labels[int(np.abs(z).argmax())]


def flats_in_light(lux: tuple[float, ...], **light) -> tuple[MatchedFrames, ...]:
    return tuple(
        shot(EMCCD, "flat", lux=value, label=f"flat-{number}", **light)
        for number, value in enumerate(lux)
    )


def test_light_of_unknown_colour_is_one_free_level_and_its_ratios_are_compared(seed: int) -> None:
    camera, lux = load_camera(EMCCD), (1e-3, 3e-3, 6e-3)
    flats = flats_in_light(lux)
    measured = simulate_frames(camera, (shot(EMCCD, "dark"), *flats), seed=seed)
    unknown = tuple(
        replace(
            flat,
            conditions=replace(flat.conditions, illuminance_lux=None, photons_per_px=5e5 * value),
        )
        for flat, value in zip(flats, lux, strict=True)
    )
    bench = measured_bench(replace(stacks_of(measured, unknown), measured=measured), camera)
    assert bench.fitted == {"ln signal of flat-2"}
    assert sum("unknown colour" in note for note in bench.notes) == 1
    lit = {}
    for flat in (bench.flats[-1], *bench.flats[:-1]):
        lit[flat.label] = light_of(bench_of(camera, flat), flat, lit)
    # Means of 12,288 pixels of a register's noise.
    assert [lit[flat.label].illuminance_lux for flat in flats] == pytest.approx(lux, rel=0.02)
    ratio = lit["flat-0"].illuminance_lux / lit["flat-2"].illuminance_lux
    assert ratio == pytest.approx(1.0 / 6.0, rel=1e-9)


def test_light_of_unknown_amount_is_a_level_of_each_stack_that_no_number_tests(seed: int) -> None:
    camera, flats = load_camera(TUBE), ()
    for number, lux in enumerate((5e-5, 2e-4)):
        flats += (shot(TUBE, "flat", lux=lux, label=f"flat-{number}", shape=(96, 128)),)
    measured = simulate_frames(camera, (shot(TUBE, "dark"), *flats), seed=seed)
    unknown = tuple(
        replace(flat, conditions=replace(flat.conditions, illuminance_lux=None)) for flat in flats
    )
    chosen = replace(stacks_of({}, unknown, name=TUBE), measured=measured)
    bench = measured_bench(chosen, camera)
    assert bench.fitted >= {"ln signal of flat-1", "signal of flat-0 over flat-1"}
    for flat, true in zip(bench.flats, flats, strict=True):
        lit = light_of(bench_of(camera, flat), flat, {})
        assert lit.illuminance_lux == pytest.approx(true.conditions.illuminance_lux, rel=0.05)
        level = mean_of(bench_of(camera, flat), replace(flat, conditions=lit)).mean()
        dark = mean_of(bench_of(camera, flat), replace(flat, kind="dark")).mean()
        assert level - dark == pytest.approx(flat.level_dn, rel=0.01)


def test_light_that_drifts_is_followed_and_named_and_steady_light_is_not(seed: int) -> None:
    camera = load_camera(EMCCD)
    flats = flats_in_light((6e-3,) * 8, shape=(64, 64))
    course = tuple(1.0 + 0.02 * np.linspace(-1.0, 1.0, 8))
    drifting = (replace(flats[0], course=course), *flats[1:])
    measured = simulate_frames(camera, (shot(EMCCD, "dark"), *drifting), seed=seed)
    bench = measured_bench(replace(stacks_of(measured, flats), measured=measured), camera)
    assert [bool(flat.course) for flat in bench.flats] == [True] + 7 * [False]
    # A frame's mean scatters by 40 % of a pixel's level over 64.
    assert bench.flats[0].course == pytest.approx(course, abs=0.006)
    assert "drift of flat-0, DN a frame" in bench.fitted
    (note,) = bench.notes
    assert note.startswith("the light of flat-0, or the gain, drifts by +")
