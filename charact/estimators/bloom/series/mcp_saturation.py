"""MCP saturation in a point series: cores lose gain while the halo stays linear."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from charact.estimators.bloom.series.halo_models import FREQUENCIES, HaloModel, pixel_of
from charact.estimators.bloom.series.likelihood import ModelParts, SeriesLikelihood
from charact.estimators.bloom.series.optimum import BoundedOptimum, optimise
from charact.estimators.bloom.source_view import clipped_mean
from charact.transfer import spreads
from charact.transfer.form import Parameter
from labdata import Array, Camera, has_tube

# Reciprocal signal density at half gain, px/DN: from no saturation to saturation at a few DN.
PLATE_LOAD = Parameter(name="plate_load", unit="px/DN", low=0.0, high=0.05, start=0.0)
# Fraction of the core's blur after the gain, without a sensor description.
POST_GAIN_SHARE = Parameter(name="post_gain_share", unit="1", low=0.0, high=1.0, mean=0.5, sd=0.3)


@dataclass(frozen=True, kw_only=True)
class SaturatingHaloModel(HaloModel):
    """Halo model with a saturating MCP."""

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the order of a point's coordinates."""
        post_gain_share = POST_GAIN_SHARE
        if has_tube(self.sensor):
            post_gain_share = replace(
                post_gain_share, mean=float(self.sensor.tube.post_gain_share), sd=0.15
            )
        return (*super().parameters, PLATE_LOAD, post_gain_share)

    def behind(self, points: Array) -> Array:
        """Transfer function of the blur after the gain, pixel included, shape (draw, frequency)."""
        post_gain_share = self.at(points)["post_gain_share"][:, None]
        return self.blur_transform(points) ** post_gain_share * pixel_of(self.pitch_ratio)

    def before(self, points: Array) -> Array:
        """Transfer function of the light at the MCP, halo and wing included, shape (draw,
        frequency).
        """
        post_gain_share = self.at(points)["post_gain_share"][:, None]
        return self.add_wing(
            self.blur_transform(points) ** (1.0 - post_gain_share), points
        ) * self.halo_factor(points)

    @property
    def neighbourhood_px(self) -> float:
        """Range of the channel load, column pitches; 0 without a sensor description."""
        return neighbourhood_px(self.sensor)


def neighbourhood_px(sensor: Camera | None) -> float:
    """Range over which the MCP load is averaged, column pitches; 0 without a sensor description."""
    if not has_tube(sensor):
        return 0.0
    pitch_um = float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification)
    return float(sensor.microchannel_plate.saturation_blur_um) / pitch_um


@dataclass(frozen=True, kw_only=True)
class SaturatingSeriesLikelihood(SeriesLikelihood):
    """Likelihood of a series under a saturating model."""

    form: SaturatingHaloModel
    steps: int = 6

    @cached_property
    def _to_frequencies(self) -> Array:
        """Matrix from signal at the nodes to its transform, shape (frequency, node)."""
        from scipy.special import j0

        at = self.series.node_px
        weight = np.gradient(at)
        weight[[0, -1]] /= 2.0
        return j0(2.0 * np.pi * FREQUENCIES[:, None] * at) * (2.0 * np.pi * at * weight)

    def parts(self, points: Array) -> "SaturatingModelParts":
        """Return the model of unit signal at points."""
        behind, before = self.form.behind(points), self.form.before(points)
        load = before * spreads.gaussian(
            FREQUENCIES, np.full(len(points), self.form.neighbourhood_px**2)
        )
        recorded, arriving, loading = (
            (transform @ self.series.onto_nodes).T for transform in (before * behind, before, load)
        )
        return SaturatingModelParts(
            **self.unclipped_parts(recorded),
            arriving=arriving,
            loading=loading * self.form.at(points)["plate_load"],
            behind=behind.T,
        )

    def light(self, parts: ModelParts, amplitudes: Array) -> Array:
        """Signal at the nodes, shape (level, node, point), DN."""
        return super().light(parts, amplitudes) - self._light_loss(parts, amplitudes)[0]

    def lost(self, parts: ModelParts, amplitudes: Array) -> Array:
        """Clipped signal and its derivatives, shape (level, node, 1 + amplitude, point)."""
        linear_light, (loss, follows) = (
            super().light(parts, amplitudes),
            self._light_loss(parts, amplitudes),
        )
        sd = self.series.node_sd[..., None]
        read, slope = clipped_mean(linear_light - loss, sd, self.series.full_dn)
        return np.stack(
            [
                linear_light - read,
                parts.unclipped - slope * (parts.unclipped - follows),
                1.0 - slope,
            ],
            axis=2,
        )

    def _light_loss(self, parts: ModelParts, amplitudes: Array) -> tuple[Array, Array]:
        """Signal lost by saturation at the nodes, and its derivative by the source signal, (level,
        node, point).
        """
        assert isinstance(parts, SaturatingModelParts)
        source = amplitudes[:, :1]
        load = np.maximum(source * parts.loading, 0.0)
        lost, follows = (
            source * parts.arriving * load / (1.0 + load),
            parts.arriving * (1.0 - 1.0 / (1.0 + load) ** 2),
        )
        return self._blur_behind_gain(lost, parts.behind), self._blur_behind_gain(
            follows, parts.behind
        )

    def _blur_behind_gain(self, at_plate: Array, behind: Array) -> Array:
        """Apply the blur after the gain to signal at the nodes, shape (level, node, point)."""
        return self.series.onto_nodes.T @ (behind * (self._to_frequencies @ at_plate))

    def compression(self, points: Array) -> Array:
        """Output of the MCP over its unsaturated output, shape (level, point)."""
        parts = self.parts(points)
        source = self.solve_amplitudes_of(parts).amplitudes[:, :1]
        load = np.maximum(source * parts.loading, 0.0)
        light = parts.arriving * (self.series.node_px * np.gradient(self.series.node_px))[:, None]
        return (light / (1.0 + load)).sum(axis=1) / light.sum(axis=0)


@dataclass(frozen=True, kw_only=True)
class SaturatingModelParts(ModelParts):
    """Model parts with a saturating MCP.

    `arriving`, `loading`: signal at the MCP of a source of one DN px^2, and its load relative to
    that at half gain, shape (node, point); `behind`: transfer function of the blur after the gain,
    shape (frequency, point).
    """

    arriving: Array
    loading: Array
    behind: Array


def fit_mcp_saturation(
    problem: SeriesLikelihood, peak: BoundedOptimum
) -> tuple[SaturatingSeriesLikelihood, BoundedOptimum] | None:
    """Fit a saturating MCP from the optimum without saturation; None if the first step gains too
    little.
    """
    form = problem.form
    tiring = SaturatingSeriesLikelihood(
        series=problem.series,
        form=SaturatingHaloModel(
            core=form.core,
            halo=form.halo,
            reach_px=form.reach_px,
            pitch_ratio=form.pitch_ratio,
            sensor=form.sensor,
        ),
        misfit=problem.misfit,
    )
    post_gain_share = tiring.form.parameters[-1].mean
    starts = np.array([[*peak.point, load, post_gain_share] for load in (0.0, *(1e-5, 1e-4, 1e-3))])
    values = tiring.log_probability(starts)
    best = starts[int(np.argmax(values[1:])) + 1]
    first = optimise(tiring, best, iterations=5)
    if first.log_probability - float(values[0]) < 5.0:
        return None
    # Without load the model differs only in the position of the blur: it must improve on that as
    # well.
    unsaturated_log_probability = max(float(values[0]), peak.log_probability)
    refined = optimise(tiring, first.point, iterations=12)
    if refined.log_probability < unsaturated_log_probability:
        return None
    last = optimise(tiring, refined.point)
    # Minimum gain in log-probability of the two additional parameters.
    return None if last.log_probability - unsaturated_log_probability < 10.0 else (tiring, last)
