"""The doctor names what is amiss with its fix, and the core works without any instrument."""

import json
import os

from charact.live import Finding, doctor, video_devices
from tests.charact.cli.runner import charact, done_well, json_of


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
