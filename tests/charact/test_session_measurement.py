"""A session is measured whole: what each method gets, and in how many threads."""

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from charact.method import METHODS, Context, register
from charact.method.registry import single_blas_thread
from charact.session_measurement import _best_point, _with_measured_gap, measure, with_inputs
from labdata import (
    BadInput,
    FrameStack,
    Provenance,
    Result,
    load_sensor,
    make_refusal,
    measurement_from_sd,
    open_session,
    sha256_of,
)
from tests.truth import EdgeScene, session_in_memory, stack_in_memory

# What one target of a session tells is known when the next is measured.


@pytest.fixture
def context() -> Context:
    return Context(camera=load_sensor("pulnix-ag5745ef3"))


def test_a_halo_of_four_gaps_sets_the_gap(context: Context) -> None:
    halo = measurement_from_sd("halo_diameter", "px", 48.0, 0.1, method="series-forward")
    gap = _with_measured_gap(context, Result(measurements=(halo,))).camera.photocathode.gap_mm
    mm_per_px = 11.0e-3 * float(context.camera.taper.demagnification)
    assert gap.value == pytest.approx(48.0 * mm_per_px / 4.0, rel=1e-12)
    assert gap.high - gap.low == pytest.approx(2 * 1.959964 * 0.1 * mm_per_px / 4.0, rel=1e-5)


@pytest.mark.parametrize(
    "halo",
    [
        make_refusal("halo_diameter", "px", "no halo", method="series-forward"),
        measurement_from_sd(
            "halo_diameter", "px", 48.0, 0.1, method="series-forward", flags=("saturated",)
        ),
    ],
)
def test_a_halo_that_is_not_sound_tells_nothing(context: Context, halo) -> None:
    assert _with_measured_gap(context, Result(measurements=(halo,))) is context


def edge_and_dark(folder: Path, volts: int, seed: int) -> None:
    """Keep a session of an edge at 700 V and a dark in a folder."""
    rng = np.random.default_rng(seed)
    np.save(folder / "edge.npy", EdgeScene(rows=90, cols=90, snr=60.0).frames_drawn(rng).data)
    np.save(folder / "dark.npy", rng.poisson(10.0, (4, 90, 90)).astype(np.uint8))
    stacks = (("edge", 700), ("dark", volts))
    (folder / "session.toml").write_text(
        'name = "s"\n'
        + "".join(
            (
                f'[[stack]]\nlabel = "{kind}"\nkind = "{kind}"\nframes = "{kind}.npy"\nmcp_v = '
                f"{voltage}\n"
            )
            for kind, voltage in stacks
        )
    )


def test_what_an_analysis_says_of_its_progress_is_told_within_its_part(
    tmp_path: Path, seed: int
) -> None:
    edge_and_dark(tmp_path, 700, seed)
    told: list[tuple[str, float]] = []
    measure(tmp_path, quick=True, progress=lambda sentence, share: told.append((sentence, share)))
    sentences = [sentence for sentence, _ in told]
    edge = sentences.index("MTF of edge")
    assert sentences[:2] == ["noise against gain", "noise of dark"]
    assert all(0.0 <= share < 0.5 for _, share in told[:edge])
    assert all(0.5 <= share <= 1.0 for _, share in told[edge:])


@pytest.mark.parametrize(("volts", "known"), [(700, True), (720, False)])
def test_the_dark_under_an_edge_s_settings_is_its_black(
    tmp_path: Path, volts: int, known: bool, seed: int
) -> None:
    edge_and_dark(tmp_path, volts, seed)
    (mtf50,) = [m for m in measure(tmp_path, quick=True).find("mtf50") if m.stack == "edge"]
    dark = np.load(tmp_path / "dark.npy").mean()
    assert (f"Black level {dark:.4g} DN." in mtf50.notes) == known
    assert any(note.startswith("Black level") for note in mtf50.notes) == known


def test_of_sound_points_the_one_with_most_light_is_told_though_another_seems_surer(
    monkeypatch, seed: int
) -> None:
    """A faint point whose halo by chance came out small has the narrowest interval, and too high an
    MTF.
    """
    rng = np.random.default_rng(seed)
    frames = {
        label: np.rint(20.0 + rng.normal(0.0, 2.0, (8, 40, 40)))
        for label in ("faint", "bright", "brightest")
    }
    for label, light in (("faint", 60.0), ("bright", 150.0), ("brightest", 400.0)):
        frames[label][:, 18:21, 18:21] += light
    told = {
        "faint": (0.21, 0.005, ()),
        "bright": (0.19, 0.009, ()),
        "brightest": (0.18, 0.004, ("saturated",)),
    }

    def measured(_, stack, **__):
        (label,) = (name for name, held in frames.items() if np.array_equal(held, stack.data))
        value, sd, flags = told[label]
        one = measurement_from_sd(
            "mtf50", "cy/px", value, sd, method="fake", flags=flags, orientation_deg=0.0
        )
        return Result(measurements=(one,))

    monkeypatch.setattr("charact.estimators.mtf.measure", measured)
    stacks = tuple(
        stack_in_memory("point", FrameStack(data=held), label=label)
        for label, held in frames.items()
    )
    session = session_in_memory(stacks)
    found = _best_point(session, 2.0, Context(seed=1, quick=True))
    assert [m.stack for m in found.measurements] == ["bright"]


def test_a_number_is_tied_to_its_frames(tmp_path: Path, seed: int) -> None:
    edge_and_dark(tmp_path, 700, seed)
    session = open_session(tmp_path)
    edge = measurement_from_sd(
        "mtf50", "cy/px", 0.2, 0.01, method="a", stack="edge", provenance=Provenance(version="1")
    )
    both = measurement_from_sd(
        "mtf50", "cy/px", 0.2, 0.01, method="b", provenance=Provenance(version="1")
    )
    one, all_of_them = with_inputs(Result(measurements=(edge, both)), session).measurements
    digests = {
        name: sha256((tmp_path / name).read_bytes()).hexdigest()
        for name in ("edge.npy", "dark.npy")
    }
    assert one.provenance is not None and one.provenance.inputs == {"edge.npy": digests["edge.npy"]}
    assert all_of_them.provenance is not None and all_of_them.provenance.inputs == digests


def test_a_folder_of_frames_has_one_digest_that_every_file_in_it_changes(tmp_path: Path) -> None:
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "0").write_bytes(b"frame")
    before = sha256_of(tmp_path)
    assert before == sha256(f"{sha256(b'frame').hexdigest()}  c/0\n".encode()).hexdigest()
    (tmp_path / "c" / "1").write_bytes(b"another")
    assert sha256_of(tmp_path) != before


def tiny_session(folder: Path, seed: int, size: int = 3) -> None:
    """Keep a session of darks, flats and targets of a few pixels in a folder."""
    rng = np.random.default_rng(seed)
    stacks = [
        ("dark", "dark", 0),
        *((f"flat {level}", "flat", level) for level in (50, 100, 200, 400)),
    ]
    stacks += [(kind, kind, 90) for kind in ("edge", "bars", "point")]
    lines = ['name = "tiny"', "bit_depth = 12"]
    for label, kind, level in stacks:
        np.save(
            folder / f"{label}.npy", rng.poisson(10.0 + level, (8, size, size)).astype(np.uint16)
        )
        lines += [
            "[[stack]]",
            f'label = "{label}"',
            f'kind = "{kind}"',
            f'frames = "{label}.npy"',
            "exposure_s = 0.01",
        ]
        lines += [f"illuminance_lux = {level}.0"] * (level > 0)
        lines += ["target = { bars = 4, frequency_cy_per_px = 0.1 }"] * (kind == "bars")
    (folder / "session.toml").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("size", [1, 3])
def test_frames_of_a_few_pixels_lose_their_targets_alone(
    tmp_path: Path, seed: int, size: int
) -> None:
    tiny_session(tmp_path, seed, size)
    result = measure(tmp_path, quick=True)
    assert result.find("dark_signal")[0].value is not None
    for stack, quantity in (("edge", "mtf50"), (None, "bloom_diameter"), (None, "post_gain_mtf50")):
        refused = [m for m in result.find(quantity) if m.stack == stack]
        assert refused and all(m.status == "refused" and m.reason for m in refused)


@pytest.mark.parametrize(
    "failure",
    [
        np.linalg.LinAlgError("singular matrix"),
        ZeroDivisionError("division by zero"),
        FloatingPointError(),
    ],
)
def test_a_numerical_failure_of_one_method_is_a_refusal_and_the_others_go_on(
    tmp_path: Path,
    seed: int,
    monkeypatch: pytest.MonkeyPatch,
    failure: ArithmeticError | ValueError,
) -> None:
    def fail(*_: object, **__: object) -> Result:
        raise failure

    edge_and_dark(tmp_path, 700, seed)
    monkeypatch.setattr("charact.estimators.mtf.measure", fail)
    result = measure(tmp_path, quick=True)
    (refused,) = (m for m in result.find("mtf50") if m.stack == "edge")
    assert refused.status == "refused" and "failed numerically" in (refused.reason or "")
    assert result.find("dark_signal")[0].value is not None


def test_a_session_that_no_analysis_can_use_is_bad_input(tmp_path: Path, seed: int) -> None:
    edge_and_dark(tmp_path, 700, seed)
    (tmp_path / "dark.npy").write_bytes(b"no array")
    (tmp_path / "edge.npy").write_bytes(b"no array")
    with pytest.raises(BadInput):
        measure(tmp_path, quick=True)


# A method works on one thread of the linear algebra library, whatever the process had, and gives
# the others back.


def threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


@pytest.fixture
def two_threads():
    with threadpool_limits(limits=2, user_api="blas"):
        yield


def test_a_method_that_fails_gives_the_threads_back(two_threads):
    @single_blas_thread()
    def failing() -> None:
        raise ValueError("on purpose")

    with pytest.raises(ValueError, match="on purpose"):
        failing()
    assert threads() == {2}


def test_a_registered_method_works_so(two_threads):
    register("kind of this test", "counting", quantities=("mtf50",), scope="Counts threads.")(
        lambda: Result(evidence={"threads": {"counts": threads()}})
    )
    method = METHODS.pop(("kind of this test", "counting"))
    assert method.function().evidence["threads"]["counts"] == {1}
    assert threads() == {2}
