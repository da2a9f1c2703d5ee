"""Sessions and results are read as they were written."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from labdata import (
    BadInput,
    Conditions,
    Curve,
    Posterior,
    Provenance,
    Result,
    Session,
    Target,
    load_sensor,
    make_measurement,
    make_refusal,
    measurement_from_draws,
    open_session,
    result_io,
    save_sensor,
)

# A session opens as it is written, reads its frames when asked, and names what is wrong in one
# sentence.


def session_of(folder: Path, manifest: str, **files: np.ndarray) -> Path:
    """Write a session with .npy files of the given names."""
    folder.mkdir(exist_ok=True)
    (folder / "session.toml").write_text(manifest)
    for name, data in files.items():
        np.save(folder / f"{name}.npy", data)
    return folder


FLAT = '[[stack]]\nlabel = "flat-03"\nkind = "flat"\nframes = "a.npy"\n'


def test_a_session_opens_as_it_is_written(tmp_path):
    manifest = """
name = "flat series, 21 March"
sensor = "pulnix-ag5745ef3"
bit_depth = 12

[[stack]]
label = "flat-03"
kind = "flat"
frames = "flat-03.tif"
exposure_s = 0.0167
mcp_v = 780.0
gate_ns = 1.6e7
illuminance_lux = 1e-4
photons_per_px = 5200.0
target = { bars = 4, frequency_cy_per_px = 0.12, angle_deg = 90.0 }
"""
    folder = session_of(tmp_path, manifest)
    data = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)
    tifffile.imwrite(folder / "flat-03.tif", data, photometric="minisblack")
    for path in (folder, str(folder), folder / "session.toml"):
        session = open_session(path)
        assert session.name == "flat series, 21 March"
        assert session.is_interlaced
        (stack,) = session.of_kind("flat")
        assert stack.conditions == Conditions(
            exposure_s=0.0167,
            mcp_v=780.0,
            gate_ns=1.6e7,
            illuminance_lux=1e-4,
            photons_per_px=5200.0,
        )
        assert stack.target == Target(bars=4, frequency_cy_per_px=0.12, angle_deg=90.0)
    read = session.stack("flat-03").read()
    assert np.array_equal(read.data, data)
    assert read.full_scale_dn == 4095


def test_frames_are_not_read_before_they_are_asked_for(tmp_path):
    folder = session_of(tmp_path, 'name = "s"\n' + FLAT)
    (folder / "a.npy").write_text("no array")
    session = open_session(folder)
    assert isinstance(session, Session)
    with pytest.raises(BadInput, match=r"must hold one whole array of numbers"):
        session.stack("flat-03").read()


def test_files_of_one_stack_follow_one_another(tmp_path):
    first, second = np.zeros((2, 3, 4), np.uint8), np.ones((3, 4), np.uint8)
    manifest = 'name = "s"\n' + FLAT.replace('"a.npy"', '["a.npy", "b.npy"]')
    session = open_session(session_of(tmp_path, manifest, a=first, b=second))
    assert session.stack("flat-03").read().data[:, 0, 0].tolist() == [0, 0, 1]
    np.save(tmp_path / "b.npy", np.ones((9, 9), np.uint8))
    with pytest.raises(
        BadInput, match=r"must have one picture size, got \(3, 4\) and \(9, 9\) in 'flat-03'"
    ):
        session.stack("flat-03").read()


def test_what_one_file_of_a_stack_shows_holds_for_all_of_them(tmp_path):
    dim, bright = np.full((1, 3, 4), 9, np.uint16), np.full((1, 3, 4), 4095, np.uint16)
    manifest = 'name = "s"\n' + FLAT.replace('"a.npy"', '["a.npy", "b.npy"]')
    read = open_session(session_of(tmp_path, manifest, a=dim, b=bright)).stack("flat-03").read()
    assert read.full_scale_dn == 4095
    assert len(read.notes) == 1


def test_a_sensor_beside_the_session_is_found(tmp_path):
    from dataclasses import replace

    ours = replace(load_sensor("pulnix-ag5745ef3"), name="ours")
    session_of(
        tmp_path,
        'name = "s"\nsensor = "ours.toml"\ninterlaced = false\n' + FLAT,
        a=np.zeros((1, 2, 2)),
    )
    save_sensor(ours, tmp_path / "ours.toml")
    session = open_session(tmp_path)
    assert session.camera == ours
    assert not session.is_interlaced


def test_pixels_beyond_the_digitiser_are_refused(tmp_path):
    folder = session_of(
        tmp_path, 'name = "s"\nbit_depth = 8\n' + FLAT, a=np.full((1, 2, 2), 300, np.uint16)
    )
    with pytest.raises(
        BadInput, match="must not exceed the 255 DN of 8 bits, got 300 in stack 'flat-03'"
    ):
        open_session(folder).stack("flat-03").read()


@pytest.mark.parametrize(
    ("manifest", "sentence"),
    [
        ('name = "s"\n', "a session must have at least one stack, got none in {folder}"),
        (
            'name = "s"\n' + FLAT * 2,
            "every stack's label must be its own, got 'flat-03' twice in {folder}",
        ),
        (
            'name = "s"\n' + FLAT.replace("a.npy", "b.npy"),
            "the frames of stack 'flat-03' must exist to be read, got {folder}/b.npy",
        ),
        (
            'name = "s"\n' + FLAT.replace('"a.npy"', "[]"),
            "a stack must name its frames, got none for 'flat-03' in {folder}",
        ),
        (
            'name = "s"\nbit_depth = 0\n' + FLAT,
            "bit_depth must lie between 1 and 32, got 0 in {folder}",
        ),
        (
            'name = "s"\nsensor = "none"\n' + FLAT,
            "a sensor must be one of emccd-512, gen3-digital-iccd, insb-mwir-640, machine-vision, "
            "pulnix-ag5745ef3, scanning-lwir, vox-lwir-640 or the path of a TOML file, got 'none'",
        ),
    ],
)
def test_what_is_wrong_with_a_session_is_one_sentence(tmp_path, manifest, sentence):
    folder = session_of(tmp_path, manifest, a=np.zeros((1, 2, 2)))
    with pytest.raises(BadInput) as error:
        open_session(folder)
    assert str(error.value) == sentence.format(folder=folder)


def test_what_a_target_states_for_another_kind_is_noted(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((1, 4, 4), np.uint8))
    stack = (
        '[[stack]]\nlabel = "{0}"\nkind = "{0}"\nframes = "a.npy"\ntarget = {{ bars = 4, '
        "pinhole_px = 1.0 }}\n"
    )
    (tmp_path / "session.toml").write_text(
        'name = "a"\n' + stack.format("edge") + stack.format("bars")
    )
    assert open_session(tmp_path).notes == (
        "stack 'edge' of kind 'edge' does not use its target's bars and pinhole_px",
        "stack 'bars' of kind 'bars' does not use its target's pinhole_px",
    )


def test_what_is_no_session_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "none", tmp_path / "none" / "session.toml"):
        with pytest.raises(BadInput, match=r"a session must be a folder with a session\.toml, got"):
            open_session(path)


def test_a_stated_bit_depth_outweighs_what_the_data_show(tmp_path):
    data = np.full((1, 3, 3), 1023, np.uint16)
    for stated, full_scale in (("", 1023), ("bit_depth = 12\n", 4095)):
        folder = session_of(tmp_path / str(full_scale), 'name = "s"\n' + stated + FLAT, a=data)
        read = open_session(folder).stack("flat-03").read()
        assert read.full_scale_dn == full_scale
        assert any("found from the data" in note for note in read.notes) == (not stated)


def test_black_is_the_level_of_the_dark_under_the_very_settings(tmp_path):
    """Darks at two voltages: an edge at one of them has its black, one at a third has none but is
    like the first.
    """
    manifest = 'name = "s"\n' + "".join(
        f'[[stack]]\nlabel = "{kind}-{volts}"\nkind = "{kind}"\nframes = "{kind}.npy"\n'
        f"mcp_v = {volts}\ngate_ns = 1e6\nexposure_s = 0.02\n"
        for kind, volts in (
            ("dark", 700),
            ("edge", 700),
            ("edge", 750),
            ("dark", 800),
            ("edge", 800),
        )
    )
    dark = np.array([[[7, 8], [9, 9]], [[8, 8], [8, 9]]])
    folder = session_of(tmp_path, manifest, dark=dark, edge=np.ones((1, 2, 2)))
    session = open_session(folder)
    assert session.black_dn(session.stack("edge-700")) == 8.25
    assert session.black_dn(session.stack("edge-750")) is None
    assert session.dark_like(session.stack("edge-750").conditions) == session.stack("dark-700")
    assert session.dark_like(session.stack("edge-800").conditions) == session.stack("dark-800")
    without = open_session(session_of(tmp_path / "other", 'name = "s"\n' + FLAT, a=dark))
    assert without.dark_like(Conditions()) is None
    assert without.black_dn(without.stack("flat-03")) is None


# A result written and read is the same result, and its JSON keeps the contract.


def a_result(seed: int = 1) -> Result:
    draws = np.random.default_rng(seed).normal(0.2, 0.01, (500, 2))
    posterior = Posterior(
        names=("mtf50", "width"),
        units=("cy/px", "px"),
        draws=draws,
        autocorrelation_time=np.array([20.0, 30.0]),
        acceptance=0.4,
        r_hat=np.array([1.0, 1.01]),
        effective_sample_size=np.array([400.0, 300.0]),
        seed=seed,
        flags=("prior-bound",),
    )
    provenance = Provenance(
        version="0.1.0", seed=seed, settings={"window_px": 30}, inputs={"a.tif": "00"}
    )
    shared = {"posterior": posterior, "provenance": provenance, "seconds": 0.4}
    return Result(
        measurements=(
            measurement_from_draws(
                "mtf50",
                "cy/px",
                draws[:, 0],
                method="edge",
                stack="edge-01",
                region=(1, 2, 30, 40),
                **shared,
            ),
            measurement_from_draws(
                "mtf10", "cy/px", 2 * draws[:, 0], method="edge", flags=("lag",), **shared
            ),
            make_measurement(
                "mtf",
                "1",
                0.5,
                (0.4, 0.6),
                (0.3, 0.7),
                method="bars",
                frequency_cy_per_px=0.12,
                notes=("a",),
            ),
            make_refusal("halo_diameter", "px", "no point source was found", method="halo"),
        ),
        curves={
            "mtf": Curve(
                frequency_cy_per_px=np.linspace(0, 0.5, 9),
                value=np.ones(9),
                interval95=np.ones((2, 9)),
            )
        },
        evidence={
            "edge-spread": {"figure": "edge-spread", "x_px": [0.0, 1.5], "truth": {"mtf50": 0.2}}
        },
    )


def same(one, other) -> bool:
    """Whether two results are equal, arrays included."""
    if dataclasses.is_dataclass(one):
        return type(one) is type(other) and all(
            same(getattr(one, item.name), getattr(other, item.name))
            for item in dataclasses.fields(one)
        )
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other


def test_a_kept_result_comes_back_whole(tmp_path):
    result = a_result()
    result_io.save(result, tmp_path)
    assert same(result_io.load(tmp_path), result)


def test_saving_again_replaces_and_leaves_one_file_of_draws(tmp_path):
    result_io.save(a_result(1), tmp_path)
    result_io.save(a_result(2), tmp_path)
    assert same(result_io.load(tmp_path), a_result(2))
    assert len(list(tmp_path.glob("results-*.npz"))) == 1
    assert not list(tmp_path.glob(".*.partial"))


def test_measurements_of_one_posterior_share_its_draws_on_the_disk(tmp_path):
    result_io.save(a_result(), tmp_path)
    (draws,) = tmp_path.glob("results-*.npz")
    with np.load(draws) as packed:
        assert sum(name.endswith(".draws") for name in packed.files) == 1


@pytest.mark.parametrize(
    "damage", [b"", b"{", b'{"format": 1}', b'{"format": 9, "draws": "none.npz"}']
)
def test_a_damaged_result_is_refused_in_a_sentence(tmp_path, damage):
    result_io.save(a_result(), tmp_path)
    (tmp_path / result_io.RESULTS).write_bytes(damage)
    with pytest.raises(BadInput, match="must be whole and readable"):
        result_io.load(tmp_path)


def test_a_number_that_is_not_finite_is_a_gap_and_not_a_crash(tmp_path):
    curve = Curve(frequency_cy_per_px=np.array([0.0, 0.1]), value=np.array([1.0, np.nan]))
    result_io.save(
        Result(curves={"mtf": curve}, evidence={"a": {"x": [np.inf, np.float32(2.0)]}}), tmp_path
    )
    loaded = result_io.load(tmp_path)
    assert loaded is not None
    assert np.isnan(loaded.curves["mtf"].value[1])
    assert loaded.evidence["a"]["x"] == [None, 2.0]


def test_the_json_of_a_verb_keeps_the_contract():
    written = json.loads(
        json.dumps(
            result_io.to_json(a_result(), given="edge.tif", version="0.1.0"), allow_nan=False
        )
    )
    assert written["charact"] == "0.1.0"
    assert written["input"] == "edge.tif"
    first, second, third, last = written["measurements"]
    for one in written["measurements"]:
        assert {
            "quantity",
            "unit",
            "value",
            "interval68",
            "interval95",
            "status",
            "flags",
            "method",
            "seconds",
        } <= (one.keys())
    assert first["status"] == "ok"
    assert first["region"] == [1, 2, 30, 40]
    assert first["stack"] == "edge-01"
    assert (
        first["interval95"][0] <= first["interval68"][0] <= first["value"] <= first["interval68"][1]
    )
    assert second["status"] == "suspect"
    assert second["flags"] == ["lag"]
    assert "region" not in second
    assert third["frequency_cy_per_px"] == 0.12
    assert third["notes"] == ["a"]
    assert last["value"] is None
    assert last["reason"] == "no point source was found"
    curve = written["curves"]["mtf"]
    assert (
        len(curve["frequency_cy_per_px"]) == len(curve["value"]) == len(curve["interval95"][0]) == 9
    )
    assert curve["interval68"] is None
