"""How much of a scene's light a sensor would notice: the bands, rays, bounces and sources that a picture needs.

A trial picture of few pixels keeps every source and every bounce apart. What a part adds at most, over the noise of a
pixel there in one frame, is its influence; parts whose influences stay below half of the tolerance together are left
out. The other half is left to chance: a pixel gets as many rays as bring its own error below that. Influences are found
at the trial's places, so they are estimates and no bounds: something small that the trial missed may have more.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.economy import Effect, Plan, plan_of
from simulate.radiance.transport.eye import Eye
from simulate.radiance.transport.gather import Effort, Stage
from simulate.radiance.transport.picture import Rays, along
from simulate.radiance.world.site import Site
from simulate.radiance.world.viewpoint import Viewpoint

# Pixels of the trial, rays of each and by which each gathers, and bounces that it follows.
TRIAL_PIXELS, TRIAL_RAYS, TRIAL_GATHERED, TRIAL_BOUNCES = 1500, 2, 4, 4
# Share of the tolerance for what is left out; the rest is for chance.
SHARE = 0.5
# Spectral error allowed of any source's signal, at least and at most, and that of the trial.
FINEST, COARSEST = 0.0005, 0.02
# With nothing left out: error by chance as a share of the noise or of the signal, the larger counts; bounces before
# paths go on by chance only, and at most.
EXACT_NOISE, EXACT_SIGNAL, EXACT_ROULETTE, EXACT_BOUNCES = 0.01, 0.002, 3, 200
# Brightest pixels, per cent, that saturate any sensor: they do not decide how fine the bands are.
BRIGHTEST = 0.5
# Seconds for a million rays and ten bands, as measured on one core: what a part costs.
SOURCE_S, BOUNCE_S = 0.25, 1.5


@dataclass(frozen=True, kw_only=True)
class Chance:
    """The variance by chance that a pixel may have: a share of its noise's, or of its signal squared if that is more.

    Parameters
    ----------
    eye
        Who looks.
    of_noise, of_signal
        Shares of the standard deviation and of the signal.
    """

    eye: Eye
    of_noise: float
    of_signal: float = 0.0

    def __call__(self, signal: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.maximum(self.of_noise * self.eye.noise(signal), self.of_signal * np.abs(signal)) ** 2


@dataclass(frozen=True, kw_only=True)
class LightPlan:
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
        Parts that are kept and left out, influences in units of a pixel's noise.
    sees
        Whose noise that is.
    exact
        Whether nothing was to be left out.
    """

    wavelength_nm: NDArray[np.float64]
    spectral_error: float
    rays: Rays
    effort: Effort
    plan: Plan
    sees: str
    exact: bool = False

    def text(self) -> str:
        """Return the plan for people."""
        chance = "as little as the exact mode asks" if self.exact else f"{SHARE * self.plan.tolerance:.3g} of the noise"
        return "\n".join(
            (
                f"light, by what {self.sees} would notice of it:",
                self.plan.text(),
                f"{len(self.wavelength_nm)} bands from {self.wavelength_nm[0]:.0f} to {self.wavelength_nm[-1]:.0f} nm, "
                f"which change no source's signal by more than {100.0 * self.spectral_error:.2g} %",
                f"{self.rays.fewest} to {self.rays.most} rays a pixel, {self.rays.edge} or more at edges, so that "
                f"chance adds {chance}; bounces followed: {self.effort.bounces}",
            )
        )

    def document(self) -> dict:
        """Return the plan as plain values, for a file."""
        return {
            **self.plan.document(),
            "wavelength_nm": self.wavelength_nm.tolist(),
            "spectral_error": self.spectral_error,
            "bounces": self.effort.bounces,
            "rays": {name: getattr(self.rays, name) for name in ("fewest", "edge", "most", "gathered")},
            "exact": self.exact,
        }


@dataclass(frozen=True)
class Trial:
    """Parts of the light at a few places of a picture.

    Parameters
    ----------
    signal
        Signal of each place, shape (place,).
    parts
        Signal of each part there, by name.
    shape
        Places (down, across).
    """

    signal: NDArray[np.floating]
    parts: dict[str, NDArray[np.floating]]
    shape: tuple[int, int]


def planned(site: Site, view: Viewpoint, eye: Eye, tolerance: float, seed: int) -> tuple[LightPlan, Stage]:
    """Choose what a picture for an eye is made with, and return the scene on the bands chosen.

    Parameters
    ----------
    site, view
        The scene and the camera.
    eye
        The sensor's response and noise.
    tolerance
        What leaving out and chance may change together, as a share of a pixel's noise in one frame.
    seed
        Seed of the trial.
    """
    stage = site.on(site.bands(eye.response_nm, eye.response, COARSEST))
    tried = trial(stage, view, eye, seed)
    chosen = plan_of(_effects(tried, eye, view, len(stage.coats.wavelength_nm)), SHARE * tolerance)
    bright = float(np.percentile(tried.signal, 100.0 - BRIGHTEST)) if len(tried.signal) else 0.0
    noise = float(eye.noise(bright))
    error = float(np.clip(0.5 * SHARE * tolerance * noise / max(bright, 1e-30), FINEST, COARSEST))
    if error < COARSEST:
        stage = site.on(site.bands(eye.response_nm, eye.response, error))
    rays = Rays(allowed=Chance(eye=eye, of_noise=(1.0 - SHARE) * tolerance))
    plan = Plan(tolerance=tolerance, kept=chosen.kept, left_out=chosen.left_out)
    effort = _effort(plan)
    return LightPlan(
        wavelength_nm=stage.coats.wavelength_nm,
        spectral_error=error,
        rays=rays,
        effort=effort,
        plan=plan,
        sees=eye.name,
    ), stage


def exact(site: Site, view: Viewpoint, eye: Eye, seed: int) -> tuple[LightPlan, Stage]:
    """Return the plan that leaves nothing out, and the scene on its bands: for reference, and slow."""
    stage = site.on(site.bands(eye.response_nm, eye.response, FINEST))
    effects = _effects(trial(stage, view, eye, seed), eye, view, len(stage.coats.wavelength_nm))
    return LightPlan(
        wavelength_nm=stage.coats.wavelength_nm,
        spectral_error=FINEST,
        rays=Rays(
            fewest=4,
            edge=64,
            most=1024,
            gathered=4,
            allowed=Chance(eye=eye, of_noise=EXACT_NOISE, of_signal=EXACT_SIGNAL),
        ),
        effort=Effort(bounces=EXACT_BOUNCES, roulette_from=EXACT_ROULETTE),
        plan=Plan(tolerance=0.0, kept=tuple(effects), left_out=()),
        sees=eye.name,
        exact=True,
    ), stage


def trial(stage: Stage, view: Viewpoint, eye: Eye, seed: int) -> Trial:
    """Return the parts of the light at places spread over a picture."""
    rng = np.random.default_rng([seed, 2])
    rows, columns = view.shape
    across = np.sqrt(TRIAL_PIXELS * columns / rows)
    grid = np.meshgrid(
        np.linspace(0.0, rows, int(across * rows / columns) + 2)[1:-1],
        np.linspace(0.0, columns, int(across) + 2)[1:-1],
        indexing="ij",
    )
    row, col = (np.repeat(axis.ravel(), TRIAL_RAYS) for axis in grid)
    jitter = rng.random((2, len(row))) - 0.5
    origin, towards = view.rays(np.clip(row + jitter[0], 0, rows), np.clip(col + jitter[1], 0, columns))
    weight = eye.weight(stage.coats.wavelength_nm)
    found = along(
        stage,
        origin,
        towards,
        Effort(bounces=TRIAL_BOUNCES),
        rng,
        gathered=TRIAL_GATHERED,
        split=True,
    ).found
    parts = {name: _of_places(light @ weight) for name, light in found.items()}
    if stage.air.absorbs and stage.lighting.lamps:
        parts["air before surfaces"] = _of_places(_air_between(stage, origin, towards, seed) @ weight)
    return Trial(np.asarray(sum(parts[name] for name in found)), parts, grid[0].shape)


def _of_places(signal: NDArray[np.floating]) -> NDArray[np.floating]:
    return signal.reshape(-1, TRIAL_RAYS).mean(axis=1)


def _air_between(
    stage: Stage, origin: NDArray[np.floating], towards: NDArray[np.floating], seed: int
) -> NDArray[np.float32]:
    """Light of lamps that air takes before it reaches surfaces: the same rays with and without."""
    with_air, without = (
        along(
            stage,
            origin,
            towards,
            Effort(bounces=0, hidden_sky=False, air_between=between),
            np.random.default_rng([seed, 3]),
            gathered=1,
        ).total()
        for between in (True, False)
    )
    return without - with_air


def _effects(tried: Trial, eye: Eye, view: Viewpoint, bands: int) -> list[Effect]:
    """Turn parts into effects: their largest influence, and what they would cost."""
    noise = eye.noise(tried.signal)
    million = view.shape[0] * view.shape[1] * Rays().fewest * 1e-6 * bands / 10.0
    influence = {
        name: float(np.max(np.abs(_evened(part, tried.shape) if _gathered(name) else part) / noise, initial=0.0))
        for name, part in tried.parts.items()
        if name not in ("in view", "sky")
    }
    # A bounce cannot be followed without those before it.
    for order in range(TRIAL_BOUNCES - 1, 0, -1):
        further = influence.get(f"bounce {order + 1}", 0.0)
        influence[f"bounce {order}"] = max(influence.get(f"bounce {order}", 0.0), further)
    return [Effect(name=name, influence=amount, setup_s=million * _cost(name)) for name, amount in influence.items()]


def _gathered(name: str) -> bool:
    return name.startswith("bounce") or name == "hidden sky"


def _evened(part: NDArray[np.floating], shape: tuple[int, int]) -> NDArray[np.floating]:
    """Average each place with its neighbours: what is gathered is smooth, and the largest of noisy numbers is not."""
    from scipy.ndimage import uniform_filter

    return uniform_filter(part.reshape(shape), 3).ravel()


def _cost(name: str) -> float:
    return BOUNCE_S if _gathered(name) else SOURCE_S


def _effort(plan: Plan) -> Effort:
    orders = [int(effect.name.split()[1]) for effect in plan.kept if effect.name.startswith("bounce ")]
    out = plan.names
    return Effort(
        bounces=max(orders, default=0),
        hidden_sky="hidden sky" not in out,
        air_between="air before surfaces" not in out,
        left_out=frozenset(out),
    )
