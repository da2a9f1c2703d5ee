"""A guest whose kernel has a camera: Debian's kernel in QEMU, the vivid driver, and the tests run
on /dev/video0.

Run as `python tests/vivid/guest.py [pytest arguments]`. Nothing is installed: the kernel's package
is unpacked into `build/vivid`. The guest stands on the host's files, which it cannot change.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "vivid"
INIT = Path(__file__).with_name("init")
PROGRAMS = {"qemu-system-x86_64": "qemu-system-x86", "busybox": "busybox-static", "cpio": "cpio"}
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay", "vivid")
TESTS = ("tests/vivid/test_vivid.py",)
TREE = ("labdata", "drivers", "tests", "pyproject.toml")
FETCH_S, BOOT_AND_TEST_S = 240, 540
MEMORY_MB = 1024


class Skip(Exception):
    """Why there can be no guest on this machine."""


def main(tests: list[str]) -> int:
    """Boot the guest, run the tests in it and return their exit status; 0 with a sentence where
    there can be none.
    """
    began_s = time.monotonic()
    try:
        require_programs()
        kernel, modules = unpacked_kernel()
    except Skip as why:
        print(f"vivid: skipped: {why}")
        return 0
    ready_s = time.monotonic()
    image = initramfs(modules, command(tests, tree()))
    status = booted(kernel, image)
    print(
        f"vivid: packages {ready_s - began_s:.1f} s, guest with its tests "
        f"{time.monotonic() - ready_s:.1f} s, exit status {status}"
    )
    return status


def require_programs() -> None:
    """Install what is missing from Debian's packages, where this user may."""
    missing = [package for program, package in PROGRAMS.items() if shutil.which(program) is None]
    if not missing:
        return
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        raise Skip(
            f"the guest needs the Debian packages {' '.join(missing)}, which this user may not "
            f"install"
        )
    print(f"vivid: installing {' '.join(missing)} from Debian's packages", flush=True)
    outside("apt-get", "update", "-qq")
    outside("apt-get", "install", "-y", "-qq", "--no-install-recommends", *missing)


def unpacked_kernel() -> tuple[Path, Path]:
    """Return Debian's kernel and the folder of its modules, unpacked and not installed."""
    found = sorted(BUILD.glob("kernel/boot/vmlinuz-*"))
    if not found:
        if shutil.which("apt-get") is None:
            raise Skip("the guest needs Debian's kernel, and this machine has no apt-get")
        BUILD.mkdir(parents=True, exist_ok=True)
        if os.geteuid() == 0:
            outside("apt-get", "update", "-qq")
        said = outside("apt-cache", "depends", "linux-image-amd64")
        names = re.findall(r"Depends: (linux-image-\S+)", said)
        if not names:
            raise Skip(f"linux-image-amd64 must name a kernel package, got {said!r}")
        print(f"vivid: fetching {names[0]}", flush=True)
        outside("apt-get", "download", "-qq", names[0])
        (package,) = BUILD.glob(f"{names[0]}_*.deb")
        shutil.rmtree(BUILD / "unpacking", ignore_errors=True)
        outside("dpkg-deb", "-x", str(package), str(BUILD / "unpacking"))
        package.unlink()
        (BUILD / "unpacking").rename(BUILD / "kernel")
        found = sorted(BUILD.glob("kernel/boot/vmlinuz-*"))
    version = found[-1].name.removeprefix("vmlinuz-")
    modules = BUILD / "kernel" / "lib" / "modules" / version
    if not (modules / "modules.dep").exists():
        outside("busybox", "depmod", "-b", str(BUILD / "kernel"), version)
    return found[-1], modules


def outside(*arguments: str) -> str:
    """Run a program of the system's and return what it said; failing, there is no guest."""
    try:
        done = subprocess.run(
            arguments,
            cwd=BUILD if BUILD.exists() else ROOT,
            capture_output=True,
            text=True,
            timeout=FETCH_S,
            env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"},
        )
    except subprocess.TimeoutExpired:
        raise Skip(f"{shlex.join(arguments)} must end within {FETCH_S} s") from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["nothing"])[-1]
        raise Skip(f"{shlex.join(arguments)} must succeed, it said: {last}")
    return done.stdout


def tree() -> Path:
    """Return a copy of the files under test, so that nobody changes them under the guest's feet."""
    copy = BUILD / "tree"
    shutil.rmtree(copy, ignore_errors=True)
    for name in TREE:
        if (ROOT / name).is_dir():
            shutil.copytree(
                ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "data")
            )
        else:
            shutil.copy(ROOT / name, copy / name)
    return copy


def command(tests: list[str], folder: Path) -> str:
    """Return the shell script that the guest runs."""
    pytest = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-s",
        "-v",
        "--color=no",
    ]
    pytest += ["--durations=5", *(tests or TESTS)]
    exports = {
        "HOME": "/tmp",
        "PATH": "/usr/bin:/bin",
        "PYTHONPATH": str(folder),
        "OPENBLAS_NUM_THREADS": "1",
    }
    exports |= {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1"}
    lines = [f"export {name}={shlex.quote(value)}" for name, value in exports.items()]
    return "\n".join([*lines, f"cd {shlex.quote(str(folder))}", shlex.join(pytest), ""])


def initramfs(modules: Path, script: str) -> Path:
    """Return the guest's first file system: busybox, the modules it needs, and what it shall
    run.
    """
    tree = BUILD / "initramfs"
    shutil.rmtree(tree, ignore_errors=True)
    for folder in ("bin", "dev", "proc", "sys"):
        (tree / folder).mkdir(parents=True)
    shutil.copy(shutil.which("busybox") or "", tree / "bin" / "busybox")
    shutil.copy(INIT, tree / "init")
    (tree / "init").chmod(0o755)
    (tree / "command").write_text(script)
    there = tree / "lib" / "modules" / modules.name
    for path in ("modules.dep", *needed(modules)):
        (there / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(modules / path, there / path)
    image = BUILD / "initramfs.cpio"
    names = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
    with image.open("wb") as file:
        subprocess.run(
            ["cpio", "--quiet", "-o", "-H", "newc", "-R", "0:0"],
            cwd=tree,
            input=names.encode(),
            stdout=file,
            check=True,
            timeout=FETCH_S,
        )
    return image


def needed(modules: Path) -> list[str]:
    """Return the files of the guest's modules and of those that they depend on."""
    depends = dict(
        line.split(":", 1) for line in (modules / "modules.dep").read_text().splitlines()
    )
    named = {Path(path).name.split(".")[0].replace("-", "_"): path for path in depends}
    found: dict[str, None] = {}
    waiting = [named[name.replace("-", "_")] for name in MODULES]
    while waiting:
        path = waiting.pop()
        found[path] = None
        waiting += [other for other in depends[path].split() if other not in found]
    return list(found)


def booted(kernel: Path, image: Path) -> int:
    """Boot the guest, print what it prints, and return the exit status of its tests."""
    qemu = [
        "qemu-system-x86_64",
        "-machine",
        "pc,accel=tcg",
        "-cpu",
        "max",
        "-smp",
        "2",
        "-m",
        str(MEMORY_MB),
    ]
    qemu += ["-nographic", "-no-reboot", "-nodefaults", "-serial", "stdio", "-net", "none"]
    qemu += [
        "-kernel",
        str(kernel),
        "-initrd",
        str(image),
        "-append",
        "console=ttyS0 quiet panic=-1",
    ]
    qemu += [
        "-virtfs",
        "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
    ]
    status = None
    with subprocess.Popen(
        ["timeout", "--kill-after=5", str(BOOT_AND_TEST_S), *qemu],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        errors="replace",
    ) as guest:
        for line in guest.stdout or ():
            print(line, end="", flush=True)
            if said := re.search(r"guest: exit status (\d+)", line):
                status = int(said[1])
    if status is None:
        print(
            f"vivid: the guest must tell the exit status of its tests within {BOOT_AND_TEST_S} s, "
            "it did not"
        )
        return 1
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
