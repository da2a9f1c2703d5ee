"""Packages that are also functions: `charact.mtf(frames)` and the package `charact.mtf`."""

import sys
from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """A package whose call is the function of its name in `charact.api`."""

    def __call__(self, *args: Any, **settings: Any) -> Any:
        """Call the function of this name in `charact.api`; `help(charact.api)` describes it."""
        from importlib import import_module

        return getattr(import_module("charact.api"), self.__name__.rpartition(".")[2])(
            *args, **settings
        )


def make_callable(package: str) -> None:
    """Let a package be called."""
    sys.modules[package].__class__ = CallablePackage
