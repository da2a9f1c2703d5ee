"""Versions: Python, the packages that charact needs, and those of its extras, as its own metadata names them."""

import re
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib import metadata

from charact.live.doctor.finding import Finding

LEAST_PYTHON = (3, 11)
# Name, least version and extra, as in: starlette>=0.46; extra == "live"
_REQUIREMENT = re.compile(r"^([\w.-]+)\s*(?:>=\s*([0-9.]+))?.*?(?:;.*extra\s*==\s*['\"]([\w-]+)['\"])?$")


def software_findings() -> Iterator[Finding]:
    """Yield Python's version, the needed packages, and each extra."""
    yield python_finding(sys.version_info[:3])
    try:
        requires = metadata.requires("charact") or []
    except metadata.PackageNotFoundError:
        yield Finding(
            area="packages", says="charact is not installed, its needs are unknown", fix="pip install charact"
        )
        return
    yield from package_findings(requires, _installed_version)


def python_finding(version: tuple[int, ...]) -> Finding:
    """Return what is to be said of Python's version."""
    told = ".".join(str(part) for part in version)
    fix = None if version >= LEAST_PYTHON else "install Python 3.11 or later"
    return Finding(area="python", says=f"Python {told}", fix=fix, core=True)


def package_findings(requires: Iterable[str], installed: Callable[[str], str | None]) -> Iterator[Finding]:
    """Yield one finding for the needed packages, and one for each extra.

    Parameters
    ----------
    requires
        Requirements as the metadata of a distribution names them.
    installed
        Returns the version of a package, None where it is not installed.
    """
    wanting: dict[str | None, list[str]] = {}
    for requirement in requires:
        if (parsed := _REQUIREMENT.match(requirement.strip())) is None:
            continue
        name, least, extra = parsed.groups()
        wanting.setdefault(extra, [])
        if lack := _lack(name, least, installed(name)):
            wanting[extra].append(lack)
    for extra, lacks in sorted(wanting.items(), key=lambda pair: pair[0] or ""):
        of, suffix = ("packages", "") if extra is None else (f"extra {extra}", f"[{extra}]")
        yield Finding(
            area=of,
            says=", ".join(lacks) or "all there",
            fix=f"pip install --upgrade 'charact{suffix}'" if lacks else None,
            core=extra is None,
        )


def _lack(name: str, least: str | None, version: str | None) -> str | None:
    if version is None:
        return f"{name} is not installed"
    if least is not None and _numbers(version) < _numbers(least):
        return f"{name} must be {least} or later, got {version}"
    return None


def _numbers(version: str) -> tuple[int, ...]:
    """Return the release of a version as numbers: 1.10 is later than 1.9."""
    parts = re.match(r"[0-9]+(?:\.[0-9]+)*", version)
    return tuple(int(part) for part in parts.group().split(".")) if parts else ()


def _installed_version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
