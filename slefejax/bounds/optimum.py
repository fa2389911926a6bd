"""The narrowest piecewise-linear enclosure that exists, by linear programming: the yardstick for all others.

Continuous functions lower <= p <= upper, linear between equal breakpoints (bilinear on equal tiles), whose largest
distance is as small as can be. Each condition at a parameter value is linear in the breakpoint values; the conditions
that matter are found one after the other: solve, look where p pierces the bounds most, add those places, solve again.
Each bound is moved outwards by what is left at the end, so that it holds, and the width is optimal to that.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, hstack, vstack

from slefejax.geometry.bezier import derivative, evaluate_curve, evaluate_patch, restrict
from slefejax.late import one_at_a_time

CURVE_ACCURACY = 1e-9  # relative to the largest coefficient after the chord is taken off
PATCH_ACCURACY = 1e-5
_ROUNDS = 40
_TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}

Places = np.ndarray  # (n,) or (n, 2)


def optimal_curve(coefficients: np.ndarray, pieces: int) -> tuple[np.ndarray, np.ndarray]:
    """(lower, upper) breakpoint values, ``(pieces + 1,)`` each, width optimal to CURVE_ACCURACY."""
    chord = np.linspace(coefficients[0], coefficients[-1], len(coefficients))
    bend, scale = _normalised(coefficients - chord)
    base = np.linspace(coefficients[0], coefficients[-1], pieces + 1)

    def piercing(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        bounds = [(i, bound) for bound in (lower, upper) for i in range(pieces)]
        return np.concatenate([_extrema(bend, i, pieces, bound) for i, bound in bounds])

    lower, upper = _cutting_planes(
        np.linspace(0.0, 1.0, 4 * pieces + 1),
        lambda t: np.asarray(evaluate_curve(bend, t)),
        lambda t: _hat_weights(t, pieces),
        piercing,
        CURVE_ACCURACY,
    )
    return base + scale * lower, base + scale * upper


def _normalised(bend: np.ndarray) -> tuple[np.ndarray, float]:
    """What is left after a linear part, scaled to size 1: the program's tolerances are absolute."""
    scale = float(np.max(np.abs(bend)))
    return (bend / scale, scale) if scale > 0 else (bend, 1.0)


def optimal_patch(coefficients: np.ndarray, pieces: int) -> tuple[np.ndarray, np.ndarray]:
    """(lower, upper) breakpoint values, ``((pieces + 1)^2,)`` each, width optimal to PATCH_ACCURACY.

    The places where p pierces a bound are looked for on a fine grid, and between its points around the worst of them.
    """
    ends = [np.stack([1.0 - s, s]) for s in (np.linspace(0.0, 1.0, n) for n in coefficients.shape)]
    bend, scale = _normalised(coefficients - ends[0].T @ coefficients[np.ix_([0, -1], [0, -1])] @ ends[1])
    side = np.linspace(0.0, 1.0, 16 * pieces + 1)
    grid = np.array(list(product(side, side)))

    def values(at: Places) -> np.ndarray:
        return np.asarray(evaluate_patch(bend, at[:, 0], at[:, 1]))

    def weights(at: Places) -> coo_matrix:
        u, v = (_hat_weights(at[:, k], pieces).toarray() for k in (0, 1))
        return coo_matrix((u[:, :, None] * v[:, None, :]).reshape(len(at), -1))

    on_grid, hats = values(grid), weights(grid)

    def piercing(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        found = []
        for bound, sign in ((lower, -1.0), (upper, 1.0)):
            excess = sign * (on_grid - hats @ bound)
            worst = grid[np.argsort(excess)[-4 * pieces * pieces :]]
            near = (worst[:, None] + _STAR / (64.0 * pieces)).reshape(-1, 2)
            found.append(np.clip(np.vstack([worst, near]), 0.0, 1.0))
        return np.vstack(found)

    start = np.array(list(product(np.linspace(0, 1, 3 * pieces + 1), repeat=2)))
    lower, upper = _cutting_planes(start, values, weights, piercing, PATCH_ACCURACY)
    s = np.linspace(0.0, 1.0, pieces + 1)
    corners = np.stack([1.0 - s, s], axis=1)
    base = (corners @ coefficients[np.ix_([0, -1], [0, -1])] @ corners.T).ravel()
    return base + scale * lower, base + scale * upper


_STAR = np.array([(a, b) for a, b in product((-2, -1, 0, 1, 2), repeat=2) if (a, b) != (0, 0)], float)


def _hat_weights(t: np.ndarray, pieces: int) -> coo_matrix:
    """Rows of the interpolation matrix: p.l. function with given breakpoint values, at t."""
    place = np.clip((t * pieces).astype(int), 0, pieces - 1)
    share = t * pieces - place
    rows = np.tile(np.arange(len(t)), 2)
    columns = np.concatenate([place, place + 1])
    return coo_matrix((np.concatenate([1.0 - share, share]), (rows, columns)), shape=(len(t), pieces + 1))


def _extrema(coefficients: np.ndarray, i: int, pieces: int, bound: np.ndarray) -> np.ndarray:
    """Parameters in piece i where p minus the bound is stationary, and the ends."""
    own = np.asarray(restrict(coefficients, i / pieces, (i + 1) / pieces))
    slope = derivative(own - np.linspace(bound[i], bound[i + 1], len(own)))
    s = np.concatenate([_roots(slope), [0.0, 1.0]])
    return (i + s) / pieces


def _roots(bernstein: np.ndarray) -> np.ndarray:
    """Real roots in (0, 1), as eigenvalues in the basis of Chebyshev polynomials on that interval."""
    degree = len(bernstein) - 1
    nodes = (np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1)) + 1.0) / 2.0
    series = np.polynomial.Chebyshev.fit(nodes, evaluate_curve(bernstein, nodes), degree, domain=(0.0, 1.0))
    roots = series.trim(1e-15 * float(np.max(np.abs(series.coef), initial=0.0))).roots()
    real = roots.real[np.abs(roots.imag) < 1e-6]
    return real[(real > 0.0) & (real < 1.0)]


def _cutting_planes(
    at: Places,
    values: Callable[[Places], np.ndarray],
    weights: Callable[[Places], coo_matrix],
    piercing: Callable[[np.ndarray, np.ndarray], Places],
    accuracy: float,
) -> tuple[np.ndarray, np.ndarray]:
    rounds = 0
    while True:
        lower, upper = _solve(weights(at), values(at))
        places = piercing(lower, upper)
        exact, hats = values(places), weights(places)
        below, above = hats @ lower - exact, exact - hats @ upper
        rounds += 1
        if max(below.max(), above.max()) <= accuracy or rounds == _ROUNDS:
            return lower - np.maximum(0.0, below.max()), upper + np.maximum(0.0, above.max())
        at = np.concatenate([at, places[(below > accuracy / 2) | (above > accuracy / 2)]])


def _solve(hats: coo_matrix, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Breakpoint values of the narrowest enclosure of samples: minimise w with upper - lower <= w."""
    samples, breakpoints = hats.toarray().shape
    one, none = coo_matrix(np.eye(breakpoints)), coo_matrix((samples, breakpoints))
    no_w, w = coo_matrix((samples, 1)), coo_matrix(-np.ones((breakpoints, 1)))
    conditions = vstack([hstack([hats, none, no_w]), hstack([none, -hats, no_w]), hstack([-one, one, w])])
    limits = np.concatenate([values, -values, np.zeros(breakpoints)])
    target = np.zeros(2 * breakpoints + 1)
    target[-1] = 1.0
    with one_at_a_time:
        from scipy.optimize import linprog  # slow to import

    found: Any = linprog(
        target, A_ub=conditions.tocsr(), b_ub=limits, bounds=(None, None), method="highs", options=_TIGHT
    )
    return found.x[:breakpoints], found.x[breakpoints:-1]
