"""Drivers of the test bench: instruments, cameras, interlock and acquisition."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.acquisition.acquire import acquire, bench_of
    from drivers.acquisition.plan_check import PlanReport, plan_report
    from drivers.cameras import camera_named

__all__ = ["PlanReport", "acquire", "bench_of", "camera_named", "plan_report"]


def __getattr__(name: str) -> Any:
    """Import the use cases on first use, so that the command line starts fast."""
    if name not in __all__:
        raise AttributeError(f"module 'drivers' has no attribute {name!r}")
    from drivers import cameras
    from drivers.acquisition import acquire, plan_check

    return next(
        getattr(room, name) for room in (acquire, plan_check, cameras) if hasattr(room, name)
    )
