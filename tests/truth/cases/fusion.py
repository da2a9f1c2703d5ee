"""Cases of the fusion methods: closed-form pairs in scope, and each way they break, past its
breaking point.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from charact.frames import NoiseLaw
from charact.fusion import Band, Fused, fit_to_truth, fuse, restoration_errors
from charact.method import Context, Method
from labdata import Result, make_measurement
from tests.truth.cases.case import (
    Axes,
    AxisPosition,
    Case,
    cases_along_axes,
    cases_in_scope,
    scene_at,
)
from tests.truth.fusion import Pair, bands_of


@dataclass(frozen=True, kw_only=True)
class FusionScene:
    """A pair of cameras, what is wrong with the description of them, and whether their shift is
    measured.
    """

    pair: Pair = field(default_factory=Pair)
    shift_px: float = 0.0  # displacement of the thermal frame along the rows
    halo_off_px: float = 0.0  # radius of the halo in the bloom map less the true one
    gain_ratio: float = 1.0  # described over true covariance gain; 0: no noise law
    noise_bands: int = 0  # further bands without a scene
    registered: bool = False

    def bands_drawn(self, rng: np.random.Generator) -> list[Band]:
        """Draw the bands, the visible one with the bloom map of its own frame where lamps clip."""
        visible, thermal = self.pair.frames(rng)
        if self.shift_px:
            from scipy.ndimage import shift

            thermal = shift(thermal, (0.0, self.shift_px), mode="nearest")
        lamps = bool(np.count_nonzero(visible >= 0.985 * self.pair.full_dn) >= 12)
        halo_px = self.pair.halo_px + self.halo_off_px
        bands = list(bands_of(self.pair, (visible, thermal), halo_px=halo_px, with_map=lamps))
        law = bands[0].noise
        assert law is not None
        law = replace(law, gain_dn=self.gain_ratio * law.gain_dn) if self.gain_ratio else None
        bands[0] = replace(bands[0], noise=law)
        noise = NoiseLaw(gain_dn=0.0, read_dn=1.0)
        return bands + [
            Band(name=f"noise-{number + 1}", image=rng.normal(size=visible.shape), noise=noise)
            for number in range(self.noise_bands)
        ]

    def fused(self, method: Method, bands: list[Band], context: Context) -> Fused:
        """Fuse the bands by a method as `charact fuse` does."""
        return fuse(bands, method=method.name, registered=self.registered)

    def scored(self, fused: Fused) -> Result:
        """Return the restoration error of the worst zone, percent of the truth's spread, with the
        picture's status.
        """
        planes = np.moveaxis(np.atleast_3d(np.asarray(fused.picture, float)), -1, 0)
        residual = fit_to_truth(planes, self.pair.truth) - self.pair.truth.picture
        error = 100.0 * max(restoration_errors(residual, self.pair.truth).values())
        status = fused.measurements[0]
        scored = make_measurement(
            "fusion_error", "%", error, None, (0.0, error), method=status.method, flags=status.flags
        )
        return Result(measurements=(scored,))


# Axis: unit, positions, first and last position inside the scope, and the change of a scene. A halo
# of another radius leaves a rim that is flagged from 2 px on; the blooming of floodlights of 6 and
# 12 px, a point source or a patch, is unknown.
AXES: Axes = {
    "misregistration": ("px", (0, 0.25, 0.5, 1, 2, 4), (0, 0.25), lambda x, _: {"shift_px": x}),
    "halo radius in the map less the true one": (
        "px, of 30",
        (-8, -4, -2, 0, 2, 4, 8),
        (0, 0),
        lambda x, _: {"halo_off_px": x},
    ),
    "gain": (
        "described over true, 0: unknown",
        (0, 0.25, 0.5, 0.8, 1, 1.25, 2, 4),
        (0.8, 1.25),
        lambda x, _: {"gain_ratio": x},
    ),
    "floodlights": (
        "px, radius of two",
        (0, 6, 12, 18, 26, 34),
        (18, 18),
        lambda x, s: _pair(s, flood_px=x),
    ),
    "NETD": (
        "K, of a spread of 0.2",
        (0.02, 0.05, 0.1, 0.2, 0.5, 1, 3),
        (0.05, 0.2),
        lambda x, s: _pair(s, netd_k=x),
    ),
    "contrast in common": (
        "correlation of both grounds",
        (-1, -0.5, 0, 0.5, 1),
        (-0.5, 1),
        lambda x, s: _pair(s, common=x),
    ),
    "further bands of noise": ("1", (0, 1, 2), (0, 2), lambda x, _: {"noise_bands": int(x)}),
}


def _pair(scene: FusionScene, **changes: Any) -> dict[str, Pair]:
    return {"pair": replace(scene.pair, **changes)}


def _case(at: AxisPosition, scene: FusionScene, rng: np.random.Generator) -> Case:
    return at.case(
        rng,
        kind="fusion",
        quantity="fusion_error",
        truth=0.0,
        draw=scene.bands_drawn,
        call=scene.fused,
        score=scene.scored,
    )


def pair_in_scope(rng: np.random.Generator, *, tuned: bool) -> Pair:
    """Return the pair that set the thresholds, of another seed, or one of other ground, light and
    contrast.
    """
    seed = int(rng.integers(1 << 31))
    if tuned:
        return Pair(seed=seed)
    coarse = float(rng.uniform(12.0, 30.0))
    return Pair(
        seed=seed,
        ground_pe=float(rng.uniform(5.0, 12.0)),
        gain_dn=float(rng.uniform(2.5, 5.0)),
        texture=float(rng.uniform(0.7, 1.4)),
        scales_px=(coarse, coarse / 4.0),
        buildings=float(rng.uniform(0.0, 1.5)),
        common=float(rng.uniform(-0.4, 0.8)),
        halo_px=float(rng.uniform(24.0, 34.0)),
        halo_fraction=float(rng.uniform(0.05, 0.15)),
        lamp_pe=float(rng.uniform(1.5e5, 4e5)),
        visible_pe=float(rng.uniform(1.5, 3.0)),
        thermal_k=float(rng.uniform(0.2, 0.4)),
        netd_k=float(rng.uniform(0.1, 0.25)),
        post_gain_px=float(rng.uniform(0.4, 0.8)),
    )


def chart_cases(seed: int, count: int) -> tuple[Case, ...]:
    """Registered pairs: half as those that set the thresholds, half of other grounds, cameras and
    contrasts.
    """
    rng = np.random.default_rng([seed, 48])

    def make_case(at: AxisPosition, number: int) -> Case:
        return _case(
            at, FusionScene(pair=pair_in_scope(rng, tuned=number % 2 == 0), registered=True), rng
        )

    return cases_in_scope(count, make_case)


def stability_cases(
    seed: int, repeats: int, axes: tuple[str, ...] = tuple(AXES)
) -> tuple[Case, ...]:
    """Every axis at every position, on pairs with walls that both bands see, so that a shift can be
    measured.
    """
    rng = np.random.default_rng([seed, 49])

    def make_case(at: AxisPosition, repeat: int) -> Case:
        base = FusionScene(pair=Pair(seed=int(rng.integers(1 << 31)), buildings=1.5))
        return _case(at, scene_at(AXES, at, base), rng)

    return cases_along_axes(AXES, axes, repeats, make_case)
