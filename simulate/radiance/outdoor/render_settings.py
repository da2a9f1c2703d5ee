"""How much of a scene's light a sensor would notice: the bands, rays, bounces and sources that a picture needs.

A trial of few places keeps every source, with all that its light does, and every bounce apart. What a part
changes, over the grain of a pixel there (`RenderSensor.grain`), root mean square over the sixteenth of the picture where that is
most, is its influence; parts whose influences stay together below a share of the tolerance are left out. Bands are
chosen to change no source by more than another share; the rest is left to chance, by which the whole picture may be off
in its root mean square. Influences are found at the trial's places, so they are estimates and no bounds: something
small that the trial missed may have more.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.effect_selection import EffectSelection, OptionalEffect, select_effects
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.adaptive_sampling import SamplingSettings
from simulate.radiance.integrator.integrator_settings import IntegratorSettings
from simulate.radiance.integrator.outgoing_radiance import radiance_along
from simulate.radiance.integrator.render_sensor import KNOWN, RenderSensor
from simulate.radiance.integrator.shading_request import bounce_order
from simulate.radiance.integrator.spectral_scene import SpectralScene
from simulate.radiance.outdoor.built_scene import BuiltScene

# Places of the trial, rays of each and by which each gathers; bounces that it tells apart, and follows in all.
TRIAL_PIXELS, TRIAL_RAYS, TRIAL_GATHERED, TRIAL_BOUNCES, TRIAL_LAST = 1600, 2, 4, 4, 24
# Parts of the picture, down and across, in each of which influences are found by themselves.
REGIONS = 4
# Tolerance, as a share of the grain, below which shadows narrower than two pixels are worth twice the time.
FINE_BELOW = 0.1
# Shares of the tolerance: for what is left out, for bands, and for chance, which adds by its square.
SHARE, BANDS, CHANCE = 0.4, 0.2, 0.6
# Spectral error allowed of any source's signal, at least and at most, and that of the trial.
FINEST, COARSEST = 0.0005, 0.005
# Most rays of a pixel; with nothing left out: the same, what chance may change, bounces before paths go on by chance
# only, and bounces at most.
MOST, EXACT_MOST, EXACT_CHANCE, EXACT_ROULETTE, EXACT_BOUNCES = 4096, 32768, 0.05, 3, 200
# Where few bounces are followed, what comes by the last is little: chance ends paths at once, for a fifth of the time.
EARLY_ROULETTE = 1
LAST_BOUNCE = f"bounce {TRIAL_BOUNCES} and further"
# Brightest pixels, per cent, that saturate any sensor: they do not decide how fine the bands are.
BRIGHTEST = 0.5
# Rays of a picture at most, where its pixels do not need more at least: a minute or so on two cores.
RAYS_IN_ALL = 3_000_000
# Shorter side of the least picture whose pixels share light, px: twice the widest window (`field.WIDTHS`).
SHARED_FROM_PX = 64
# Seconds for a million rays and ten bands, as measured on one core: what a part costs.
SOURCE_S, BOUNCE_S = 0.25, 1.5


@dataclass(frozen=True, kw_only=True)
class MonteCarloTolerance:
    """The variance by chance that pixels may have in the mean, by their signal.

    Parameters
    ----------
    eye
        Who looks.
    of_grain
        Share of the grain that is the standard deviation of chance, root mean square over the picture.
    """

    eye: RenderSensor
    of_grain: float

    def __call__(self, signal: NDArray[np.floating]) -> NDArray[np.floating]:
        return (self.of_grain * self.eye.grain(signal)) ** 2


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """What a picture is made with.

    Parameters
    ----------
    wavelength_nm
        Bands, shape (band,), nm.
    spectral_error
        What bands may change of any source's signal, relative.
    rays, effort
        How many rays, and how far light is followed.
    plan
        Parts that are kept and left out, influences in units of a pixel's grain.
    sees
        Whose noise that is.
    exact
        Whether nothing was to be left out.
    """

    wavelength_nm: NDArray[np.float64]
    spectral_error: float
    rays: SamplingSettings
    effort: IntegratorSettings
    plan: EffectSelection
    sees: str
    exact: bool = False

    @property
    def chance(self) -> float:
        """Share of the grain that is the standard deviation of chance, root mean square over the picture."""
        return self.rays.allowed.of_grain if isinstance(self.rays.allowed, MonteCarloTolerance) else 0.0

    def text(self) -> str:
        """Return the plan for people."""
        few, most, chance = self.rays.fewest, self.rays.most, self.chance
        follows = self.effort
        bounces = "to the end, by chance" if follows.bounces >= EXACT_BOUNCES else f"{follows.bounces}"
        return "\n".join(
            (
                f"light, by what {self.sees} would notice of it:",
                self.plan.text("rms where it is most"),
                f"{len(self.wavelength_nm)} bands from {self.wavelength_nm[0]:.0f} to {self.wavelength_nm[-1]:.0f} nm, "
                f"which change no source's signal by more than {100.0 * self.spectral_error:.2g} %",
                f"{few} to {most} rays a pixel, so that chance adds {100.0 * chance:.2g} % of the "
                f"noise (or {100.0 * KNOWN * chance:.2g} % of the signal, where that is more), root mean square",
                f"bounces followed: {bounces}",
            )
        )

    def document(self) -> dict:
        """Return the plan as plain values, for a file."""
        return {
            **self.plan.document(),
            "wavelength_nm": self.wavelength_nm.tolist(),
            "spectral_error": self.spectral_error,
            "bounces": self.effort.bounces,
            "bounces_by_chance_from": self.effort.roulette_from,
            "rays": {name: getattr(self.rays, name) for name in ("fewest", "edge", "most", "gathered", "shared")},
            "exact": self.exact,
        }


@dataclass(frozen=True)
class PilotEstimate:
    """Parts of the light at a few places of a picture.

    Parameters
    ----------
    signal
        Signal of each place, or of each pixel where these hold several, shape (place,).
    parts
        Signal of each part there by each ray, shape (place, ray), by name. What bounces of a lamp's or a disc's light,
        or lacks in bounces by hidden sky, is part of the bounce and of the source: who leaves out either lacks it.
    shape
        Places (down, across).
    """

    signal: NDArray[np.floating]
    parts: dict[str, NDArray[np.floating]]
    shape: tuple[int, int]


def choose_render_settings(
    site: BuiltScene, view: Viewpoint, eye: RenderSensor, tolerance: float, seed: int
) -> tuple[RenderSettings, SpectralScene]:
    """Choose what a picture for an eye is made with, and return the scene on the bands chosen.

    Parameters
    ----------
    site, view
        The scene and the camera.
    eye
        The sensor's response and noise.
    tolerance
        What leaving out and chance may change together, as a share of a pixel's grain, root mean square.
    seed
        Seed of the trial.
    """
    stage = site.on(site.bands(eye.response_nm, eye.response, COARSEST))
    tried = trial(stage, view, eye, seed)
    chosen = select_effects(_effects(tried, eye, view, stage.bands), SHARE * tolerance)
    bright = float(np.percentile(tried.signal, 100.0 - BRIGHTEST)) if len(tried.signal) else 0.0
    error = float(
        np.clip(BANDS * tolerance * float(eye.grain(bright, smooth=True)) / max(bright, 1e-30), FINEST, COARSEST)
    )
    if error < COARSEST:
        stage = site.on(site.bands(eye.response_nm, eye.response, error))
    plan = EffectSelection(tolerance=tolerance, kept=chosen.kept, left_out=chosen.left_out)
    return RenderSettings(
        wavelength_nm=stage.bsdfs.wavelength_nm,
        spectral_error=error,
        rays=SamplingSettings(
            most=MOST,
            in_all=RAYS_IN_ALL,
            shared=_n_cache_rays(view),
            fine=tolerance < FINE_BELOW,
            allowed=MonteCarloTolerance(eye=eye, of_grain=CHANCE * tolerance),
        ),
        effort=_effort(plan),
        plan=plan,
        sees=eye.name,
    ), stage


def _n_cache_rays(view: Viewpoint) -> int | None:
    """Rays of a node of shared light; None where the picture is no larger than the windows over which it is evened."""
    return SamplingSettings().shared if min(view.shape) >= SHARED_FROM_PX else None


def exact(site: BuiltScene, view: Viewpoint, eye: RenderSensor, seed: int) -> tuple[RenderSettings, SpectralScene]:
    """Return the plan that leaves nothing out, and the scene on its bands: for reference, and slow."""
    stage = site.on(site.bands(eye.response_nm, eye.response, FINEST))
    effects = _effects(trial(stage, view, eye, seed), eye, view, stage.bands)
    return RenderSettings(
        wavelength_nm=stage.bsdfs.wavelength_nm,
        spectral_error=FINEST,
        rays=SamplingSettings(
            fewest=4, edge=64, most=EXACT_MOST, shared=None, allowed=MonteCarloTolerance(eye=eye, of_grain=EXACT_CHANCE)
        ),
        effort=IntegratorSettings(bounces=EXACT_BOUNCES, roulette_from=EXACT_ROULETTE),
        plan=EffectSelection(tolerance=0.0, kept=tuple(effects), left_out=()),
        sees=eye.name,
        exact=True,
    ), stage


def trial(stage: SpectralScene, view: Viewpoint, eye: RenderSensor, seed: int) -> PilotEstimate:
    """Return the parts of the light at places spread over a picture."""
    rng = np.random.default_rng([seed, 2])
    place = _Places.over(view)
    row, col = place.drawn(rng)
    origin, towards = view.rays(row, col)
    weight = eye.weight(stage.bsdfs.wavelength_nm)
    found = radiance_along(
        stage,
        origin,
        towards,
        IntegratorSettings(bounces=TRIAL_LAST, roulette_from=TRIAL_BOUNCES),
        rng,
        gathered=TRIAL_GATHERED,
        split=True,
    ).found
    by_name = {name: place.means(light @ weight) for name, light in found.items()}
    signal = np.asarray(sum(by_name.values(), start=np.zeros((int(np.prod(place.shape)), TRIAL_RAYS)))).mean(axis=1)
    parts: dict[str, NDArray[np.floating]] = {}
    for name, light in by_name.items():
        for part in _parts_of(name, (*stage.lighting.names, "hidden sky")):
            parts[part] = parts.get(part, 0.0) + light
    if stage.air.absorbs and stage.lighting.lamps:
        between = _air_between(stage, origin, towards, seed) @ weight
        parts["air before surfaces"] = place.means(between)
    return PilotEstimate(signal, parts, place.shape)


@dataclass(frozen=True)
class _Places:
    """Places spread evenly over a picture, shape (place,); where pixels hold several, a pixel's count as one."""

    row: NDArray[np.floating]
    col: NDArray[np.floating]
    spread: tuple[float, float]
    pixel: NDArray[np.int64]
    shape: tuple[int, int]

    @classmethod
    def over(cls, view: Viewpoint) -> "_Places":
        rows, columns = view.shape
        across = np.sqrt(TRIAL_PIXELS * columns / rows)
        many = (max(1, int(across * rows / columns)), max(1, int(across)))
        row, col = (
            axis.ravel()
            for axis in np.meshgrid(
                *((np.arange(n) + 0.5) * side / n for n, side in zip(many, view.shape, strict=True)), indexing="ij"
            )
        )
        spread = min(1.0, rows / many[0]), min(1.0, columns / many[1])
        if min(many[0] / rows, many[1] / columns) < 1.0:
            return cls(row, col, spread, np.arange(len(row)), many)
        return cls(row, col, spread, row.astype(np.int64) * columns + col.astype(np.int64), view.shape)

    def drawn(self, rng: np.random.Generator) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Draw rows and columns of `TRIAL_RAYS` rays around each place, (place and ray,)."""
        jitter = rng.random((2, len(self.row) * TRIAL_RAYS)) - 0.5
        row, col = (
            np.repeat(axis, TRIAL_RAYS) + apart * spread
            for axis, apart, spread in zip((self.row, self.col), jitter, self.spread, strict=True)
        )
        return row, col

    def means(self, signal: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return signals of rays as means of each place that counts, by first and second rays, shape (place, ray)."""
        each = signal.reshape(-1, TRIAL_RAYS).astype(float)
        count = np.bincount(self.pixel, minlength=int(np.prod(self.shape)))
        total = [np.bincount(self.pixel, ray, minlength=len(count)) for ray in each.T]
        return np.stack(total, axis=1) / count[:, None]


def _parts_of(name: str, sources: tuple[str, ...]) -> tuple[str, ...]:
    """Parts to which light belongs: the order of its bounce, and its source, if it is one that a plan may leave out."""
    order, source = bounce_order(name)
    if order == 0:
        return (name,)
    last = LAST_BOUNCE if order >= TRIAL_BOUNCES else f"bounce {order}"
    return (last, source) if source in sources else (last,)


def _air_between(
    stage: SpectralScene, origin: NDArray[np.floating], towards: NDArray[np.floating], seed: int
) -> NDArray[np.float32]:
    """Light of lamps that air takes before it reaches surfaces: the same rays with and without."""
    with_air, without = (
        radiance_along(
            stage,
            origin,
            towards,
            IntegratorSettings(bounces=0, hidden_sky=False, air_between=between),
            np.random.default_rng([seed, 3]),
            gathered=1,
        ).total()
        for between in (True, False)
    )
    return without - with_air


def _effects(tried: PilotEstimate, eye: RenderSensor, view: Viewpoint, bands: int) -> list[OptionalEffect]:
    """Turn parts into effects: their influence, and what they would cost."""
    grain = eye.grain(tried.signal, smooth=True)[:, None]
    million = view.shape[0] * view.shape[1] * SamplingSettings().fewest * 1e-6 * bands / 10.0
    influence = {
        name: _influence(part / grain, tried.shape)
        for name, part in tried.parts.items()
        if name not in ("in view", "sky")
    }
    # A bounce cannot be followed without those before it.
    orders = [f"bounce {order}" for order in range(1, TRIAL_BOUNCES)] + [LAST_BOUNCE]
    for order, further in zip(orders[-2::-1], orders[:0:-1], strict=True):
        if further in influence:
            influence[order] = max(influence.get(order, 0.0), influence[further])
    return [
        OptionalEffect(name=name, influence=amount, setup_s=million * _cost(name)) for name, amount in influence.items()
    ]


def _influence(part: NDArray[np.floating], shape: tuple[int, int]) -> float:
    """Root mean square of a part (place, ray) over the region where that is largest.

    Notes
    -----
    The mean square is that of the product of two rays of the same place, which chance does not enlarge as it would the
    square of their mean: specks of one ray find no like in the other.
    """
    square = (part[:, 0] * part[:, 1]).reshape(shape)
    regions = [
        region.mean() for rows in np.array_split(square, REGIONS) for region in np.array_split(rows, REGIONS, axis=1)
        if region.size
    ]  # fmt: skip
    return float(np.sqrt(max(0.0, *regions)))


def _is_gathered(name: str) -> bool:
    return name.startswith("bounce") or name == "hidden sky"


def _cost(name: str) -> float:
    return BOUNCE_S if _is_gathered(name) else SOURCE_S


def _effort(plan: EffectSelection) -> IntegratorSettings:
    orders = [int(effect.name.split()[1]) for effect in plan.kept if effect.name.startswith("bounce ")]
    out = plan.names
    followed = max(orders, default=0)
    to_the_end = followed >= TRIAL_BOUNCES
    return IntegratorSettings(
        bounces=EXACT_BOUNCES if to_the_end else followed,
        hidden_sky="hidden sky" not in out,
        air_between="air before surfaces" not in out,
        left_out=frozenset(out),
        roulette_from=EXACT_ROULETTE if to_the_end else EARLY_ROULETTE,
    )
