"""What the MTF of an edge costs: the most probable form, its whole posterior, a frame of twenty
edges.

Held against what one would write with SciPy and emcee: a Gaussian edge fitted to the pixels, and a
chain on them.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks.row import Row, best_seconds

if TYPE_CHECKING:
    from charact.estimators.mtf.edge.fit.model_selection import EvidenceWeightedModels
    from labdata import FrameStack

Array = NDArray[np.float64]
ROWS, COLS, TILT = 256, 64, np.tan(np.radians(5.0))
NOISE_DN = 5.0
POINT_S, FULL_S, FRAME_S = 0.010, 2.0, 5.0
# A chain as its handbook has it: walkers, steps.
WALKERS, STEPS = 32, 500
# Edges of squares, five by four to a frame of the case study's size: height and width of a square's
# place, px.
FRAME, PLACE = (493, 768), (98, 192)
EDGES = 20


def rows() -> Iterator[Row]:
    """The three promises, each beside its plain way."""
    from charact.estimators.mtf import measure_all
    from charact.estimators.mtf.edge.parametric import edge_parametric
    from charact.method import Context
    from labdata import FrameStack

    edge = plain_edge(np.random.default_rng(1))
    stack = FrameStack(data=edge[None], full_scale_dn=1e9)
    fitted_s = best_seconds(lambda: plain_fit(edge))
    yield Row(
        name="edge 256 x 64, most probable form",
        seconds=best_seconds(lambda: most_probable_form(stack), 20),
        peer="curve_fit of a Gaussian edge",
        peer_seconds=fitted_s,
        limit_seconds=POINT_S,
    )
    yield Row(
        name="edge 256 x 64, full posterior",
        seconds=best_seconds(lambda: edge_parametric(stack, context=Context(quick=False))),
        peer=f"emcee on its pixels, {WALKERS} x {STEPS}",
        peer_seconds=best_seconds(lambda: plain_chain(edge), 1),
        limit_seconds=FULL_S,
    )
    frame = FrameStack(data=frame_of_edges(np.random.default_rng(2))[None], full_scale_dn=1e9)
    found = measure_all("edge", frame, max_targets=EDGES, context=Context(quick=True)).find("mtf50")
    if len(found) != EDGES or any(one.value is None for one in found):
        raise AssertionError(
            f"{EDGES} edges must be measured, got {sum(one.value is not None for one in found)}"
        )
    yield Row(
        name=f"frame 768 x 493, {EDGES} edges, --quick",
        seconds=best_seconds(
            lambda: measure_all("edge", frame, max_targets=EDGES, context=Context(quick=True)), 3
        ),
        peer=f"{EDGES} such fits, places known",
        peer_seconds=EDGES * fitted_s,
        limit_seconds=FRAME_S,
    )


def most_probable_form(stack: "FrameStack") -> "EvidenceWeightedModels":
    """Find an edge and the form that it asks for, which is the point estimate of
    `edge-parametric`.
    """
    from charact.estimators.mtf.edge.parametric import fit_edge_models
    from charact.estimators.mtf.edge.pixels.prepare_edge import EdgeRefusal, prepare_edge
    from charact.estimators.mtf.known_transfer import known_transfer
    from charact.method import Context

    context = Context(quick=True)
    edge = prepare_edge(stack, None, context, quickly=True, fields_apart=True)
    if isinstance(edge, EdgeRefusal):
        raise AssertionError(edge.reason)
    return fit_edge_models(
        edge, known_transfer(edge.picture, edge.profile.angle_rad, context), context
    )[1][0]


def plain_edge(rng: np.random.Generator) -> Array:
    """An edge at 5 degrees, 150 DN high, Gaussian of 0.8 px, in white noise, shape (row, col),
    DN.
    """
    return _edge((0.3, 1100.0, 150.0, 0.8, TILT)) + NOISE_DN * rng.standard_normal((ROWS, COLS))


def _edge(parameters: tuple[float, ...] | Array) -> Array:
    from scipy.special import ndtr

    place_px, dark_dn, step_dn, sigma_px, tilt = parameters
    row, col = np.mgrid[:ROWS, :COLS]
    distance = (col - COLS / 2 - place_px + tilt * (row - ROWS / 2)) / np.hypot(1.0, tilt)
    return dark_dn + step_dn * ndtr(distance / sigma_px)


def plain_fit(edge: Array) -> Array:
    """Place, levels, width and tilt by least squares on all pixels."""
    from scipy.optimize import curve_fit

    start = (0.0, float(edge.min()), float(np.ptp(edge)), 1.0, TILT)
    return curve_fit(
        lambda _, *parameters: _edge(parameters).ravel(), np.arange(edge.size), edge.ravel(), start
    )[0]


def plain_chain(edge: Array) -> Array:
    """Draws of the same parameters, shape (draw, parameter)."""
    import emcee

    def log_probability(parameters: Array) -> float:
        if parameters[3] <= 0.0:
            return -np.inf
        return -0.5 * float(np.sum(((edge - _edge(parameters)) / NOISE_DN) ** 2))

    best = plain_fit(edge)
    start = best + 1e-3 * np.random.default_rng(3).standard_normal((WALKERS, best.size))
    sampler = emcee.EnsembleSampler(WALKERS, best.size, log_probability)
    sampler.run_mcmc(start, STEPS)
    return sampler.get_chain(discard=STEPS // 5, flat=True)


def frame_of_edges(rng: np.random.Generator) -> Array:
    """Bright tilted squares on dark ground, two long edges of each, blurred by 0.8 px, in white
    noise, DN.
    """
    import cv2

    over = 8
    fine = np.zeros((FRAME[0] * over, FRAME[1] * over), np.float32)
    for top in range(5):
        for left in range(4):
            middle = ((left + 0.5) * PLACE[1] * over, (top + 0.5) * PLACE[0] * over)
            corners = cv2.boxPoints((middle, (70.0 * over, 60.0 * over), 5.0))
            cv2.fillConvexPoly(fine, np.rint(corners).astype(np.int32), 150.0)
    fine = cv2.GaussianBlur(fine, (0, 0), 0.8 * over)
    frame = cv2.resize(fine, FRAME[::-1], interpolation=cv2.INTER_AREA)
    return 1100.0 + frame + NOISE_DN * rng.standard_normal(FRAME)
