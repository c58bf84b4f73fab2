"""The apocentre of one arm from the ridge of its particles, where several branches of debris may overlap."""

from __future__ import annotations

import numpy as np

from streamkit import Array
from streamkit.builtin.observables.apocentres import track as arm

# Degrees beyond the progenitor's apocentre: all debris beyond this angle has passed its own apocentre.
BEYOND = (10.0, 60.0)
FEWEST_BEYOND = 10  # fewest particles beyond this angle (sum of weights)
START = 50.0  # initial width (standard deviation) of the Gaussian in the fit of the branch of this debris, degrees
SPARSE = 0.2  # density along the arm, in units of its maximum, below which the weight of an angle decreases
LOW = 4  # minus the power in the mean of the heights: a branch three times as high has 1 % of the lower one's weight
# Smallest eigenvalue of the ridge's curvature, with its diagonal scaled to 1, at which a Gaussian is determined.
FLAT = 1e-9
BREADTH = 0.1  # standard deviation in radius of the kernel about the branch, in units of its apocentre


def fit_turning(
    angle: Array, r: Array, number: Array, guide: float, coverage: float = arm.COVERAGE
) -> arm.ArmFit | str:
    """Fit, as `fit_arm`, the lower of the branches that turn round, among others at the same angles.

    The Gaussian r(angle) is the ridge of the particles and not their mean: each counts by a Gaussian kernel of its
    distance in radius (modal regression; Yao & Li 2014, Scand. J. Statist. 41, 656). All angles have the same weight,
    so that the stripping rate does not matter. The fit begins with the debris beyond the apocentre: there is hardly any
    debris of the last passage, which has its apocentre farther out.
    """
    chosen = np.abs(angle - guide) < arm.FARTHEST
    angle, r, number = angle[chosen], r[chosen], number[chosen]
    if len(angle) < arm.FEWEST:
        return arm.TOO_FEW
    number = _even_weights(angle, number, guide)
    q = _from_beyond(angle, r, number, guide)
    if not isinstance(q, str):
        q = _ridge(angle, r, number, q)
    if isinstance(q, str):
        return q
    if abs(q[1] - guide) > 2 * arm.REACH:
        return arm.NO_GAUSSIAN
    centre = float(q[1])
    slope, rest, share = _shares(angle, r, number, q)
    if reason := arm.one_sided(angle, share, centre, coverage):
        return reason
    curvature = (slope * (share * (1 - (rest / (BREADTH * q[0])) ** 2))) @ slope.T
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    if not np.linalg.eigvalsh(curvature / np.outer(scale, scale))[0] > FLAT:
        return "the ridge about the apocentre is flat"
    bread = np.linalg.inv(curvature)
    covariance = bread @ ((slope * (share * rest) ** 2) @ slope.T) @ bread
    grid = centre + np.arange(-arm.WINDOW, arm.WINDOW + arm.CELL, arm.CELL)
    inside = np.abs(angle - centre) < arm.WINDOW
    count, total = map(arm.convolve, arm.cells(angle[inside], grid, share[inside], (share * r)[inside]))
    variance = float(covariance[0, 0]), float(covariance[1, 1])
    return arm.arm_fit(q, variance, grid, total / np.maximum(count, 1e-12), count)


def _even_weights(angle: Array, number: Array, guide: float) -> Array:
    """Weights (n,) of the same sum that give all angles the same weight, except angles with hardly any particles."""
    grid = np.arange(-arm.FARTHEST - arm.CELL, arm.FARTHEST + 2 * arm.CELL, arm.CELL) + guide
    (count,) = arm.cells(angle, grid, number)
    density = arm.convolve(count)
    even = number / (np.interp(angle, grid, density) + SPARSE * density.max())
    return np.asarray(even * number.sum() / even.sum())


def _from_beyond(angle: Array, r: Array, number: Array, guide: float) -> Array | str:
    """A Gaussian at the guide through the particles beyond it: where branches overlap, through the lower one."""
    x = (angle - guide) * np.sign(guide)
    weight = arm.between(x, *BEYOND) * number
    if weight.sum() < FEWEST_BEYOND:
        return "too few particles beyond the apocentre"
    height = r * np.exp(0.5 * (x / START) ** 2)
    return np.array([((weight * height**-LOW).sum() / weight.sum()) ** (-1 / LOW), guide, np.log(START)])


def _ridge(angle: Array, r: Array, number: Array, q: Array) -> Array | str:
    """Climb to the ridge from q = (A, m, ln s): least squares with the particles' shares, until neither moves."""
    gain, last = 1.0, np.zeros(3)
    for _ in range(300):
        slope, rest, share = _shares(angle, r, number, q)
        if share.sum() < arm.FEWEST / 2:
            return arm.TOO_FEW
        normal = (slope * share) @ slope.T
        normal[np.diag_indices(3)] *= 1 + 1e-9
        limit = np.array([0.1 * q[0], 8.0, 0.3])
        step = np.clip(np.linalg.solve(normal, slope @ (share * rest)), -limit, limit)
        if (step / limit) @ last < 0:  # overshoot: the window and the kernel move with the fit
            gain *= 0.5
        last = step / limit
        q = q + gain * step
        if not arm.is_sensible(q):
            return arm.NO_GAUSSIAN
        if np.abs(step / (np.abs(q) + 1)).max() < 1e-7:
            return q
    return "the ridge about the apocentre does not settle"


def _shares(angle: Array, r: Array, number: Array, q: Array) -> tuple[Array, Array, Array]:
    """Slopes (3, n), residuals (n,), and what each particle counts (n,): its number by the window and by the kernel."""
    model, slope = arm.gaussian(angle, q)
    rest = r - model
    share = number * arm.window(angle - q[1]) * np.exp(-0.5 * (rest / (BREADTH * q[0])) ** 2)
    return slope, rest, share
