"""Series of a point source at many levels, drawn at random inside the scope of the bloom methods."""

import warnings
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from charact.method import Context, Method
from charact.study.bloom.scene import BloomScene, bloom_session, truth
from charact.study.bloom.truth import plateau_per_px2
from charact.study.harness import CaseTimer
from labdata.errors import BadInput
from labdata.measurement import Measurement
from labdata.session import Session

# Levels that show the halo: its plateau over full scale, from the faintest to the brightest, two decades apart.
SHOWN = (0.008, 0.8)
BRIGHTEST = 1e6
# Frames reach this far beyond the halo on every side, px.
AROUND_PX = 22


@dataclass(frozen=True, kw_only=True)
class BloomSeries:
    """A point source and the levels at which it was taken.

    `scene`, `overloads`: the source, and its levels as of `BloomScene`, the faintest first; `darks`: whether a dark
    stack was taken.
    """

    scene: BloomScene
    overloads: tuple[float, ...]
    darks: bool = True

    def session_drawn(self, rng: np.random.Generator) -> Session:
        """Draw its frames."""
        return bloom_session(self.scene, self.overloads, rng, darks=self.darks)

    def truth(self, quantity: str, stack: str | None) -> float | None:
        """Return what should be found of the session, or of the stack of a label; None: nothing is known of it."""
        overload = self.overloads[0 if stack is None else int(stack.removeprefix("point-"))]
        known = _truth(self.scene, overload, self.overloads[0]).get(quantity)
        return known if known is not None and np.isfinite(known) else None


@lru_cache(maxsize=32)
def _truth(scene: BloomScene, overload: float, faintest: float) -> dict[str, float]:
    return truth(scene, overload, faintest=faintest)


def halo_overload(scene: BloomScene) -> float:
    """Return the overload at which the plateau of the halo meets full scale."""
    plateau = scene.row_pitch * scene.halo_fraction * plateau_per_px2(scene)
    return scene.span_dn / (plateau * scene.source_dn(1.0))


def scene_in_scope(rng: np.random.Generator, *, widest_px: float = 70.0, most_frames: int = 16) -> BloomScene:
    """Return a source inside the scope: every other core has a wing; one camera in four has 12 bits.

    `widest_px`, `most_frames`: widest halo and most frames of a stack.
    """
    diameter = float(rng.uniform(25.0, widest_px))
    side = int(np.ceil(diameter + 2 * AROUND_PX + rng.uniform(0.0, 20.0)))
    fine = rng.random() < 0.25
    scale = 16.0 if fine else 1.0
    return BloomScene(
        rows=side,
        cols=side + 10,
        frames=int(rng.integers(4, most_frames + 1)),
        row=float((side - 1) / 2 + rng.uniform(-3.0, 3.0)),
        col=float((side + 9) / 2 + rng.uniform(-3.0, 3.0)),
        core_sigma_px=float(rng.uniform(1.0, 2.5)),
        wing_share=float(rng.uniform(0.02, 0.15)) if rng.random() < 0.5 else 0.0,
        wing_radius_px=float(rng.uniform(2.0, 4.0)),
        wing_exponent=float(rng.uniform(2.0, 3.0)),
        halo_diameter_px=diameter,
        halo_fraction=float(np.exp(rng.uniform(np.log(0.02), np.log(0.3)))),
        halo_elastic_share=float(rng.uniform(0.1, 1.0)),
        glare_fraction=float(rng.uniform(0.005, 0.05)),
        dark_dn=scale * float(rng.uniform(8.0, 20.0)),
        background_dn=scale * float(rng.uniform(2.0, 6.0)),
        full_scale_dn=4095.0 if fine else 255.0,
        bits=12 if fine else 8,
        photoelectron_dn=scale * float(rng.uniform(2.0, 4.0)),
        excess=float(rng.uniform(1.4, 2.0)),
        post_gain_sigma_px=float(rng.uniform(0.5, 0.8)),
        read_noise_dn=scale * float(rng.uniform(0.4, 0.8)),
        light_sd=0.02,
    )


def levels_in_scope(scene: BloomScene, rng: np.random.Generator, *, shown: int = 5) -> tuple[float, ...]:
    """Return overloads: two decades that show the halo, one where the core just clips, and one or two beyond."""
    meets = halo_overload(scene)
    low, high = (meets * share for share in SHOWN)
    showing = np.geomspace(low, high, shown) * np.exp(rng.uniform(-0.1, 0.1, shown))
    faint = float(np.exp(rng.uniform(np.log(0.5), np.log(max(0.6, min(20.0, 0.3 * low))))))
    beyond = min(BRIGHTEST, meets * float(np.exp(rng.uniform(np.log(2.0), np.log(50.0)))))
    levels = [faint, *showing, beyond]
    if rng.random() < 0.2 and beyond < BRIGHTEST:
        levels.append(BRIGHTEST)
    return tuple(sorted(float(level) for level in levels))


def series_in_scope(rng: np.random.Generator, **limits: Any) -> BloomSeries:
    """Return a series inside the scope; `limits` are those of `scene_in_scope`."""
    scene = scene_in_scope(rng, **limits)
    return BloomSeries(scene=scene, overloads=levels_in_scope(scene, rng))


def without_halo(series: BloomSeries) -> BloomSeries:
    """Return a series whose source has no halo."""
    return replace(series, scene=replace(series.scene, halo_fraction=0.0))


def measure_series(
    method: Method, series: BloomSeries, drawn: Session, *, seed: int, quick: bool
) -> tuple[tuple[Measurement, ...] | None, float]:
    """Put a method to the frames of a series: its measurements, and its seconds.

    Input that the method refuses gives no measurement; None stands for any other error and any warning, which a user
    would see.
    """
    context = Context(quick=quick, seed=seed, full_scale_dn=series.scene.full_scale_dn)
    clock = CaseTimer()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = method.function(drawn, context=context).measurements
    except BadInput:
        found = ()
    except Exception:  # the study must outlive the method it breaks
        found = None
    return found, clock.seconds()
