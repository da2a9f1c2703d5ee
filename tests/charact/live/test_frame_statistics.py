"""Numbers of a live frame: statistics, focus, the judgement of a signal, and the doctor of a
bench.
"""

import json
import os

import numpy as np
import pytest

from charact.live import (
    AVERAGED_FRAMES,
    SATURATED_BGR,
    BestFocus,
    Finding,
    Focus,
    FocusReader,
    SaturationJudge,
    doctor,
    half_interval_dn,
    measure_frame,
    read_focus,
    render_preview,
    video_devices,
)
from charact.method import Context
from labdata import BadInput, Conditions, Step, StopCriterion
from tests.charact.cli.runner import charact, done_well, json_of
from tests.charact.live.sources import AtOnce, edge
from tests.truth.blur import TrueBlur

# Meters read what is in the frame: counts are exact, the noise lies within its stated standard
# errors.


@pytest.mark.parametrize(
    "dtype,full_scale_dn", [(np.uint8, 255), (np.uint16, 1023), (np.uint16, 65535)]
)
def test_every_saturated_pixel_is_counted_and_every_pixel_is_in_the_histogram(
    dtype, full_scale_dn, seed
) -> None:
    rng = np.random.default_rng(seed)
    frame = rng.integers(0, full_scale_dn, (97, 131)).astype(dtype)
    places = rng.choice(frame.size, 37, replace=False)
    frame.ravel()[places] = full_scale_dn
    meters = measure_frame(frame, full_scale_dn=full_scale_dn)
    assert meters.saturated_px == 37
    assert meters.histogram.sum() == meters.pixels == frame.size
    assert meters.highest_dn == full_scale_dn
    assert meters.mean_dn == pytest.approx(frame.mean())
    assert len(meters.histogram) * meters.bin_dn == full_scale_dn + 1


def test_one_saturated_pixel_that_the_picture_leaves_out_is_counted_and_marked() -> None:
    import cv2

    frame = np.full((300, 4 * 768), 50, np.uint8)
    frame[101, 203] = 255
    meters = measure_frame(frame, full_scale_dn=255.0)
    picture = render_preview(frame, meters, full_scale_dn=255.0)
    drawn = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert meters.saturated_px == 1
    assert picture.step == 4 and drawn.shape == (75, 768, 3)
    # A JPEG smears the mark over its neighbours; its blue stands out all the same.
    blue, _, red = SATURATED_BGR
    excess = drawn[..., 0].astype(int) - drawn[..., 2]
    assert np.unravel_index(excess.argmax(), excess.shape) == (25, 50)
    assert excess.max() > 0.1 * (blue - red)


def test_stated_error_of_the_noise_holds_where_pixels_share_their_noise(seed) -> None:
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    shared = [
        gaussian_filter(rng.normal(0.0, 60.0, (480, 640)), 2.0, mode="wrap") for _ in range(41)
    ]
    frames = [np.rint(2000.0 + one).astype(np.uint16) for one in shared]
    read = [
        measure_frame(b, a, full_scale_dn=4095.0)
        for a, b in zip(frames[::2], frames[1::2], strict=False)
    ]
    scatter = np.std([meters.noise_dn for meters in read], ddof=1)
    stated = np.mean([meters.noise_se_dn for meters in read])
    assert 0.5 < stated / scatter < 1.7


def test_mean_and_noise_are_those_of_the_region_and_saturation_that_of_the_frame(seed) -> None:
    rng = np.random.default_rng(seed)
    a, b = (rng.normal(100.0, 4.0, (200, 200)) for _ in range(2))
    frames = [np.rint(one).astype(np.uint8) for one in (a, b)]
    for frame in frames:
        frame[:100] = 255
    meters = measure_frame(*frames, full_scale_dn=255.0, region=(100, 0, 100, 200))
    assert meters.saturated_px == 100 * 200
    assert meters.mean_dn == pytest.approx(100.0, abs=4 * 4.0 / np.sqrt(20_000))
    assert meters.noise_dn == pytest.approx(np.sqrt(16.0 + 1 / 12), abs=5 * meters.noise_se_dn)


def test_what_cannot_be_metered_is_refused_in_a_sentence() -> None:
    frame = np.zeros((10, 10), np.uint8)
    with pytest.raises(BadInput, match="inside the image of 10 rows"):
        measure_frame(frame, full_scale_dn=255.0, region=(5, 5, 6, 5))
    with pytest.raises(BadInput, match="unsigned integers"):
        measure_frame(frame.astype(float), full_scale_dn=255.0)
    with pytest.raises(BadInput, match="one shape"):
        measure_frame(frame, frame[:5], full_scale_dn=255.0)


# Focus: MTF50 of a known blur, and a best that only a sharper picture replaces.


CONTEXT = Context(quick=True, full_scale_dn=255.0)


def reading(value: float, half: float = 0.01, flags: tuple[str, ...] = ()) -> Focus:
    return Focus(mtf50_cy_per_px=value, interval95=(value - half, value + half), flags=flags)


def test_focus_is_the_mtf50_of_the_blur(seed) -> None:
    rng = np.random.default_rng(seed)
    frames = np.stack([edge(rng, blur_px=1.5) for _ in range(4)])
    truth = TrueBlur(sigma_px=1.5).mtf50(5.0)
    focus = read_focus(frames, None, CONTEXT)
    assert focus.mtf50_cy_per_px is not None and focus.interval95 is not None
    assert focus.interval95[0] < truth < focus.interval95[1]
    assert focus.interval95[1] - focus.interval95[0] < 0.1 * truth


def test_a_picture_without_an_edge_has_a_reason_and_no_number(seed) -> None:
    flat = np.random.default_rng(seed).normal(100.0, 3.0, (2, 120, 120)).astype(np.uint8)
    focus = read_focus(flat, None, CONTEXT)
    assert focus.mtf50_cy_per_px is None and focus.reason


def test_the_best_is_held_while_the_lens_is_turned_through_focus(seed) -> None:
    rng = np.random.default_rng(seed)
    seen = 0
    with FocusReader(CONTEXT, None, AtOnce()) as reader:
        for blur_px in (2.0, 1.2, 3.0):
            for _ in range(3 * AVERAGED_FRAMES + 1):
                reader.look_at(edge(rng, blur_px=blur_px, shape=(100, 100)))
                seen += reader.newest is not None
        assert seen > 0 and reader.newest is not None and reader.best.best is not None
        sharpest, blurred = (TrueBlur(sigma_px=sigma).mtf50(5.0) for sigma in (1.2, 3.0))
        assert reader.best.best.mtf50_cy_per_px == pytest.approx(sharpest, rel=0.06)
        assert reader.newest.mtf50_cy_per_px == pytest.approx(blurred, rel=0.1)
        assert reader.best.is_reached_by(reader.newest) is False
        reader.forget_best()
        assert reader.best.best is None


def test_noise_alone_does_not_push_the_best_upwards(seed) -> None:
    """Of 50 lenses that nobody turns, 1,500 readings each: intervals of two standard errors on
    either side.
    """
    error, bests = 0.005, []
    for readings in np.random.default_rng(seed).normal(0.2, error, (50, 1500)):
        held = BestFocus()
        for value in readings:
            held = held.after(reading(float(value), half=2 * error))
        assert held.best is not None and held.best.mtf50_cy_per_px is not None
        bests.append((held.best.mtf50_cy_per_px - 0.2) / error)
        # An ordinary reading finds it again, and one four standard errors lower does not.
        assert held.is_reached_by(reading(0.2, half=2 * error))
    assert 1.0 < np.median(bests) < 2.0
    assert np.sum(np.array(bests) > 3.0) <= 2
    assert not held.is_reached_by(reading(0.18 - error, half=2 * error))


def test_only_clearly_sharper_trusted_readings_take_the_place_of_the_best() -> None:
    held = BestFocus().after(reading(0.2))
    assert held.after(reading(0.205)) == held
    assert held.after(reading(0.19)) == held
    assert held.after(reading(0.4, flags=("saturated",))) == held
    assert held.after(Focus(reason="no target")) == held
    once = held.after(reading(0.22))
    assert once.best == reading(0.2)
    assert once.after(reading(0.2)).after(reading(0.22)).best == reading(0.2)
    assert once.after(reading(0.23)).best == reading(0.22) == once.after(reading(0.22)).best
    assert once.after(reading(0.215)).best == reading(0.215)


def test_readings_that_share_frames_are_held_against_the_best_once(seed) -> None:
    """One sharp moment, in all readings that its frames enter: no two of them confirm each
    other.
    """
    rng = np.random.default_rng(seed)
    with FocusReader(CONTEXT, None, AtOnce()) as reader:
        for blur_px in (
            *[2.0] * 2 * AVERAGED_FRAMES,
            *[1.2] * AVERAGED_FRAMES,
            *[2.0] * 2 * AVERAGED_FRAMES,
        ):
            reader.look_at(edge(rng, blur_px=blur_px, shape=(100, 100)))
        assert reader.best.best is not None and reader.best.best.mtf50_cy_per_px is not None
        blurred = TrueBlur(sigma_px=2.0).mtf50(5.0)
        assert reader.best.best.mtf50_cy_per_px == pytest.approx(blurred, rel=0.1)


# The judge of an acquisition: a mean's interval holds what it promises, and saturated pixels are
# counted, all.


SHAPE = (20, 30)


def watched(means_dn, *, until=None, kind="flat", frames=1000):
    step = Step(
        label="a",
        kind=kind,
        frames=frames,
        conditions=Conditions(illuminance_lux=1e-4),
        until=until,
    )
    watcher = SaturationJudge().watch(step, 4095.0)
    for taken, mean_dn in enumerate(means_dn, 1):
        watcher.see(np.full(SHAPE, mean_dn))
        if why := watcher.enough():
            return taken, why, watcher
    return len(means_dn), None, watcher


def test_the_interval_of_a_mean_holds_it_as_often_as_it_says(seed):
    rng = np.random.default_rng(seed)
    held = [abs(rest.mean()) <= half_interval_dn(rest) for rest in rng.standard_normal((2000, 30))]
    # 95 % of 2000 draws less three standard errors of that count.
    assert np.mean(held) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 2000)


def test_a_level_that_drifts_or_lags_is_known_less_well_than_white_noise(seed):
    rng = np.random.default_rng(seed)
    white = rng.standard_normal(200)
    lagging = np.convolve(white, 0.8 ** np.arange(20), "same")
    lagging *= white.std() / lagging.std()
    assert half_interval_dn(lagging) > 1.5 * half_interval_dn(white)
    assert half_interval_dn(np.linspace(-1.0, 1.0, 200)) > 3 * np.linspace(
        -1.0, 1.0, 200
    ).std() / np.sqrt(200)


def test_levels_that_were_stopped_early_are_as_near_the_truth_as_was_asked(seed):
    rng = np.random.default_rng(seed)
    within_dn, truth_dn, errors, taken = 0.3, 800.0, [], []
    for _ in range(300):
        means_dn = truth_dn + rng.standard_normal(400)
        frames, why, _ = watched(means_dn, until=StopCriterion(mean_within_dn=within_dn))
        assert why is not None
        taken.append(frames)
        errors.append(abs(means_dn[:frames].mean() - truth_dn))
    # Looking several times costs a little of the 95 %: 90 % is what is asked here.
    assert np.mean(np.array(errors) <= within_dn) > 0.90 - 3 * np.sqrt(0.9 * 0.1 / 300)
    assert 30 < np.median(taken) < 100  # (1.96 / 0.3)^2 = 43 frames


def test_every_saturated_pixel_counts():
    watcher = SaturationJudge().watch(
        Step(label="a", kind="flat", frames=9, conditions=Conditions()), 4095.0
    )
    frame = np.zeros(SHAPE)
    frame.flat[:3] = 4095.0
    watcher.see(frame)
    assert watcher.complaint() == "0.5 % of all pixels are at full scale, 4095 DN"
    assert not watcher.is_saturated()
    frame.flat[:60] = 4095.0
    watcher.see(frame)
    assert watcher.is_saturated()


def test_a_point_is_meant_to_saturate():
    watcher = SaturationJudge().watch(
        Step(label="a", kind="point", frames=9, conditions=Conditions()), 4095.0
    )
    watcher.see(np.full(SHAPE, 4095.0))
    assert watcher.complaint() is None


# The doctor names what is amiss with its fix, and the core works without any instrument.


def can_work(found: tuple[Finding, ...]) -> bool:
    return all(one.ok for one in found if one.core)


REQUIRES = (
    "numpy>=2.1",
    "zarr>=3.1",
    'starlette>=0.46; extra == "live"',
    'uvicorn>=0.34 ; extra == "live"',
)


def test_a_package_that_is_missing_or_too_old_is_named_with_what_installs_it() -> None:
    there = {"numpy": "2.10.0", "zarr": "3.0.9", "starlette": "0.46.1"}
    core, live = doctor.package_findings(REQUIRES, there.get)
    assert core.core and not core.ok and core.says == "zarr must be 3.1 or later, got 3.0.9"
    assert (
        not live.core
        and live.says == "uvicorn is not installed"
        and "charact[live]" in (live.fix or "")
    )
    good = {"numpy": "2.1", "zarr": "3.1.6rc1", "starlette": "1.0", "uvicorn": "0.34.0"}
    assert all(one.ok for one in doctor.package_findings(REQUIRES, good.get))


def test_what_charact_needs_is_read_from_its_own_metadata() -> None:
    assert [
        doctor.python_finding(version).ok for version in ((3, 10, 14), (3, 11, 0), (3, 12, 1))
    ] == [
        False,
        True,
        True,
    ]
    found = {one.area: one for one in doctor.software_findings()}
    assert found["packages"].ok and {"extra live", "extra pdf", "extra fits", "extra dask"} <= set(
        found
    )


def test_a_small_socket_buffer_is_named_with_the_command_that_widens_it(tmp_path) -> None:
    (tmp_path / "rmem_max").write_text("212992\n")
    found = doctor.socket_buffer(tmp_path)
    assert (
        not found.ok
        and "0.203 MiB" in found.says
        and "net.core.rmem_max=8388608" in (found.fix or "")
    )
    (tmp_path / "rmem_max").write_text("8388608\n")
    assert doctor.socket_buffer(tmp_path).ok
    assert doctor.socket_buffer(tmp_path / "none").ok


def test_packet_sizes_are_those_of_interfaces_that_are_up(tmp_path) -> None:
    for name, state, mtu in (
        ("eth0", "up", 1500),
        ("eth1", "up", 9000),
        ("eth2", "up", 576),
        ("wlan0", "down", 500),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "operstate").write_text(state)
        (tmp_path / name / "mtu").write_text(str(mtu))
    found = {one.says.split(":")[0]: one for one in doctor.packet_sizes(tmp_path)}
    assert set(found) == {"eth0", "eth1", "eth2"}
    assert found["eth0"].ok and "jumbo" in found["eth0"].says and "jumbo" not in found["eth1"].says
    assert not found["eth2"].ok


def test_a_full_or_slow_disk_has_a_fix_and_one_that_takes_nothing_stops_the_core(tmp_path) -> None:
    assert (
        doctor.room_finding(tmp_path, 2 * 10**12).ok and not doctor.room_finding(tmp_path, 10**9).ok
    )
    # 22.7 MB/s: ten minutes of 768 x 493 px of 16 bit at 30 Hz.
    assert "10 minutes" in doctor.room_finding(tmp_path, 600 * 30 * 2 * 768 * 493 + 1).says
    assert doctor.speed_finding(tmp_path, 250.0).ok and not doctor.speed_finding(tmp_path, 40.0).ok
    found = tuple(doctor.disk_findings(tmp_path))
    assert len(found) == 2 and can_work(found) and list(tmp_path.iterdir()) == []
    assert not can_work(tuple(doctor.disk_findings(tmp_path / "nowhere")))


def test_devices_are_told_with_the_kernels_name_and_with_whether_they_may_be_opened(
    tmp_path, monkeypatch
) -> None:
    devices, kernel = tmp_path / "dev", tmp_path / "sys"
    devices.mkdir()
    (devices / "video10").touch()
    (devices / "video2").touch()
    (kernel / "video2").mkdir(parents=True)
    (kernel / "video2" / "name").write_text("USB capture\n")
    offered = {str(devices / "video2"): "inputs #0 Composite; Mono8"}
    found = [one for one in video_devices(devices, kernel, offered) if "/dev/video" in one.says]
    assert found[0].says.endswith("video2: USB capture, inputs #0 Composite; Mono8")
    assert found[1].says.endswith("video10: nameless, no readable capture format")
    assert all(one.ok for one in found)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setattr(doctor, "group_of", lambda path: "video")
    shut = [one for one in video_devices(devices, kernel) if "/dev/video" in one.says]
    assert all(not one.ok and "usermod -a -G video" in (one.fix or "") for one in shut)


def test_the_verb_prints_ok_or_the_fix_and_ends_with_the_cores_verdict(
    tmp_path, monkeypatch
) -> None:
    # Nothing is asked of the network in a test.
    monkeypatch.setattr(
        doctor,
        "camera_findings",
        lambda: iter([Finding(area="aravis", says="none", fix="plug one in")]),
    )
    plain = done_well("doctor", tmp_path)
    assert "FIX  aravis" in plain.stdout and "-> plug one in" in plain.stdout
    assert all(
        line.startswith(("ok ", "FIX", "     ", "The core"))
        for line in plain.stdout.splitlines()
        if line
    )
    told = json_of("doctor", tmp_path)
    assert told["core_can_work"] is True
    assert all(one["ok"] is (one["fix"] is None) for one in told["findings"])
    nowhere = charact("doctor", tmp_path / "nowhere", "--json")
    assert nowhere.exit_code == 1 and json.loads(nowhere.stdout)["core_can_work"] is False
