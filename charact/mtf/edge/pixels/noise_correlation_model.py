"""A smooth form of the correlation of noise: what a blur behind the gain leaves, four numbers in place of hundreds."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Lags that tell the form, px; further ones hold next to nothing but noise.
TELLING_PX = 6
# Lengths along columns and rows, and the exponent of exp(-(r/L)^p): a Gaussian blur leaves 2, tails of tubes less.
LENGTH_PX, EXPONENT = (0.35, 6.0), (0.7, 2.3)
EXPONENT_PRIOR = (1.8, 0.3)
STARTS_PX = (0.7, 1.2, 2.4)
# Chi squared that a correlation must be worth, with four numbers of its own.
WORTH_CHI2 = 25.0
# Width of the bins that take most of the noise along the edge with them, px.
STRIP_PX = 1.0
ITERATIONS = 30
# Gain in chi squared that ends the fit, and damping of its steps: least, most and by how much it changes (Levenberg
# 1944, doi 10.1090/qam/10666).
MIN_GAIN, MIN_DAMPING, MAX_DAMPING, DAMPING_STEP = 0.1, 1e-3, 100.0, 10.0


def fit_correlation_model(
    correlation: Array, pairs: Array, across: Array, between: NDArray[np.bool_] | None = None
) -> tuple[Array, Array]:
    """Fit the form to a correlation and return it, and what the removal of bin means took from it.

    Parameters
    ----------
    correlation
        At lags of rows and columns, shape (2 R + 1, 2 C + 1), 1 in the middle.
    pairs
        Pairs of pixels behind each lag.
    across
        Distance across the edge that each lag makes, px.
    between
        Which lags lead from one field to the other, whose exposures share less of the noise or none; None: there are
        no fields.

    Returns
    -------
    form, taken
        Same shape; the form is 1 in the middle and 0 elsewhere where neighbours share nothing.

    Notes
    -----
    rho(l) = A exp(-(r(l))^p) - c t(l), c >= 0, for l other than 0: r^2 = (x/Lx)^2 + (y/Ly)^2, and t a triangle,
    because means of bins take along the same share of all pairs that lie in one bin. Gauss-Newton on Lx, Ly and p with
    A and c solved at each step.
    """
    rows, cols = (np.arange(size) - size // 2 for size in correlation.shape)
    y, x = np.meshgrid(rows, cols, indexing="ij")
    strip = np.maximum(1.0 - np.abs(across) / STRIP_PX, 0.0)
    # One of each pair of opposite lags, and not the pixel itself.
    half = (y > 0) | ((y == 0) & (x > 0))
    near = half & (np.abs(x) <= TELLING_PX) & (np.abs(y) <= TELLING_PX) & (pairs > 50)
    telling = near if between is None else near & ~between
    weight = np.sqrt(pairs[telling])
    lags = np.stack([x[telling], y[telling]]).astype(float)
    found = _fit(correlation[telling] * weight, lags, strip[telling], weight)
    middle = (x == 0) & (y == 0)
    if found is None:
        only = weight * strip[telling]
        taken = min(float(only @ (correlation[telling] * weight) / max(only @ only, 1e-300)), 0.0)
        return np.where(middle, 1.0, 0.0), np.where(middle, 0.0, taken * strip)
    theta, (share, taken) = found
    form = share * _shape(theta[None], np.stack([x.ravel(), y.ravel()]).astype(float)).reshape(x.shape)
    if between is not None:
        form = np.where(
            between, _fraction_across_fields(correlation - taken * strip, form, pairs, near & between) * form, form
        )
    return np.where(middle, 1.0, form), np.where(middle, 0.0, taken * strip)


def _fraction_across_fields(correlation: Array, form: Array, pairs: Array, lags: NDArray[np.bool_]) -> float:
    """Return how much of the form there is at some lags, from 0 to 1, by least squares."""
    weight = pairs[lags] * form[lags]
    return float(np.clip(weight @ correlation[lags] / max(weight @ form[lags], 1e-300), 0.0, 1.0))


@njit(cache=True)
def _shape(theta: Array, lags: Array) -> Array:
    """Return exp(-r^p), shape (n, 3) and (2, lag) -> (n, lag)."""
    out = np.empty((len(theta), lags.shape[1]))
    for i in range(len(theta)):
        across, along = np.exp(-2.0 * theta[i, 0]), np.exp(-2.0 * theta[i, 1])
        for k in range(lags.shape[1]):
            square = lags[0, k] ** 2 * across + lags[1, k] ** 2 * along
            out[i, k] = np.exp(-(square ** (0.5 * theta[i, 2])))
    return out


@njit(cache=True)
def _solve(theta: Array, data: Array, lags: Array, strip: Array, weight: Array) -> tuple[Array, Array]:
    """Return share and loss, shape (n, 2), and what is left, shape (n, lag + 1), the prior of the exponent last."""
    found, left = np.empty((len(theta), 2)), np.empty((len(theta), data.size + 1))
    other, stripped = max(np.dot(strip, strip), 1e-300), np.dot(strip, data)
    shapes = _shape(theta, lags)
    for i in range(len(theta)):
        shape = shapes[i] * weight
        both = np.dot(shape, strip)
        own = max(np.dot(shape, shape) - both**2 / other, 1e-300)
        share = min(max((np.dot(shape, data) - both * stripped / other) / own, 0.0), 1.0)
        # Means take away and never add.
        loss = min((stripped - share * both) / other, 0.0)
        found[i] = share, loss
        left[i, :-1] = data - share * shape - loss * strip
        left[i, -1] = (theta[i, 2] - EXPONENT_PRIOR[0]) / EXPONENT_PRIOR[1]
    return found, left


def _fit(data: Array, lags: Array, strip: Array, weight: Array) -> tuple[Array, Array] | None:
    """Return ln lengths and exponent, share and what bins took; None where the correlation is not worth it."""
    strip = strip * weight
    starts = np.array([[np.log(length), np.log(length), EXPONENT_PRIOR[0]] for length in STARTS_PX])
    start = starts[np.argmin(np.sum(_solve(starts, data, lags, strip, weight)[1] ** 2, axis=1))]
    theta, amplitude, left = _optimise(start, data, lags, strip, weight)
    without = data - strip * (strip @ data / max(strip @ strip, 1e-300))
    worth = float(np.sum(without**2) - np.sum(left**2))
    return (theta, amplitude) if worth > WORTH_CHI2 and amplitude[0] > 0 else None


def _optimise(theta: Array, data: Array, lags: Array, strip: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Return the peak near a start by damped Gauss-Newton steps: lengths and exponent, share and loss, what is left."""
    low = np.array([np.log(LENGTH_PX[0]), np.log(LENGTH_PX[0]), EXPONENT[0]])
    high = np.array([np.log(LENGTH_PX[1]), np.log(LENGTH_PX[1]), EXPONENT[1]])
    little = np.concatenate([np.zeros((1, 3)), 1e-4 * np.eye(3)])
    here, damping = _solve(theta + little, data, lags, strip, weight), MIN_DAMPING
    for _ in range(ITERATIONS):
        left = here[1]
        slopes = (left[1:] - left[0]) / 1e-4
        normal = slopes @ slopes.T
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(3), slopes @ left[0])
        trial = np.clip(theta + np.clip(step, -0.5, 0.5), low, high)
        there = _solve(trial + little, data, lags, strip, weight)
        gain = np.sum(left[0] ** 2) - np.sum(there[1][0] ** 2)
        if gain > 0.0:
            theta, here, damping = trial, there, max(damping / DAMPING_STEP, MIN_DAMPING)
            if gain < MIN_GAIN:
                break
        else:
            # Too far along a ridge of lengths and exponent: the next step is shorter and steeper.
            damping *= DAMPING_STEP
            if damping > MAX_DAMPING:
                break
    return theta, here[0][0], here[1][0]
