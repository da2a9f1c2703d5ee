"""A method of another package is listed and used by its name."""

import sys
from importlib.metadata import EntryPoint, EntryPoints
from types import ModuleType

import numpy as np
import pytest

import charact
from charact.method import METHODS, register, registry
from labdata import Result, measurement_from_sd


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch):
    """A package whose module registers the method "edge-theirs" when it is imported."""

    def install(module: str) -> None:
        point = EntryPoint(name="edge-theirs", value=module, group=registry.ENTRY_POINTS)
        monkeypatch.setattr(registry, "entry_points", lambda group: EntryPoints([point]))

    yield install
    METHODS.pop(("edge", "edge-theirs"), None)
    sys.modules.pop("their_package", None)


def test_a_method_of_another_package_is_listed_and_measures(package, monkeypatch):
    module = ModuleType("their_package")
    monkeypatch.setitem(sys.modules, "their_package", module)
    package("their_package")

    @register("edge", "edge-theirs", quantities=("mtf50",), scope="always 0.3")
    def measure(stack, *, region, context) -> Result:
        return Result(
            measurements=(measurement_from_sd("mtf50", "cy/px", 0.3, 0.01, method="edge-theirs"),)
        )

    assert "edge-theirs" in registry.methods_of_kind("edge")
    found = charact.mtf(np.zeros((40, 40)), roi=(0, 0, 40, 40), method="edge-theirs")
    assert found.mtf50.value == 0.3


def test_a_package_that_cannot_be_imported_is_one_sentence(package):
    package("no_such_package")
    with pytest.raises(charact.BadInput, match=r"edge-theirs.*must be importable"):
        charact.mtf(np.zeros((40, 40)), method="edge-theirs")
