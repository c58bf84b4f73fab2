"""The apocentre of one arm: a Gaussian r(angle) about the maximum of its mean track, smooth in the particles.

The result is a continuous function of the particles, as samplers need. Each angle is shared between the two nearest
cells of a fine grid. The window about the maximum has soft edges, and is re-centred on the fitted maximum until both
agree.
"""

from __future__ import annotations

import numpy as np

from streamkit import Array
from streamkit.builtin.observables.apocentres import track as arm


def fit_arm(angle: Array, r: Array, number: Array, guide: float, coverage: float = arm.COVERAGE) -> arm.ArmFit | str:
    """Fit particles at angles (n,), radii r (n,), each standing for a number (n,), near the guiding angle.

    Returns the reason if there is no apocentre. There is none if less than the fraction ``coverage`` of the particles
    is on either side.
    """
    if len(angle) < arm.FEWEST:
        return arm.TOO_FEW
    grid = np.arange(-180.0, 180.0 + arm.CELL, arm.CELL) + guide
    chosen = (angle > grid[0]) & (angle < grid[-1])
    angle, r, number = angle[chosen], r[chosen], number[chosen]
    count, total = arm.cells(angle, grid, number, number * r)
    density = arm.convolve(count)
    smooth = arm.convolve(total) / np.maximum(density, 1e-12)  # kernel-smoothed mean radius
    start = _first_guess(grid, smooth, density, guide)
    if start is None:
        return arm.TOO_FEW
    p = _fit(grid, count, total, start, float(np.interp(start, grid, smooth)))
    if isinstance(p, str):
        return p
    if abs(p[1] - guide) > 2 * arm.REACH:
        return arm.NO_GAUSSIAN
    weight = arm.window(grid - p[1])
    if reason := arm.one_sided(grid, weight * count, p[1], coverage):
        return reason
    one, first, second = arm.cells(angle, grid, number**2, number**2 * r, (number * r) ** 2)
    variance = _variance(grid, count, one, first, second, weight, p)
    return arm.arm_fit(p, variance, grid, smooth, count)


def _first_guess(grid: Array, smooth: Array, density: Array, guide: float) -> float | None:
    """Return the maximum of the smoothed track nearest the guide, or its highest point if it has no maximum."""
    within = (np.abs(grid - guide) <= arm.REACH) & (density > 0.05 * density.max())
    inner = smooth[1:-1]
    peak = np.flatnonzero((inner >= smooth[:-2]) & (inner > smooth[2:]) & within[1:-1]) + 1
    if len(peak) == 0:
        return float(grid[within][np.argmax(smooth[within])]) if within.any() else None  # `_fit` decides if it is one
    high = peak[smooth[peak] > 0.9 * smooth[peak].max()]
    return float(grid[high[np.argmin(np.abs(grid[high] - guide))]])


def _fit(grid: Array, count: Array, total: Array, centre: float, height: float) -> Array | str:
    """Least squares of the Gaussian (A, m, s) to the particles' radii, in the window centred on its own maximum.

    The fit takes Gauss-Newton steps in ln s, so that s stays positive. A step that would make the fit worse is damped.
    The window follows the maximum until both have converged.
    """
    mean = total / np.maximum(count, 1e-12)
    q = np.array([height, centre, np.log(60.0)])
    damping = 1e-3
    for _ in range(200):
        w = arm.window(grid - q[1]) * count
        if w.sum() < arm.FEWEST:
            return arm.TOO_FEW
        model, slope = arm.gaussian(grid, q)
        rest = mean - model
        normal = (slope * w) @ slope.T
        normal[np.diag_indices(3)] *= 1 + damping
        step = np.linalg.solve(normal, slope @ (w * rest))
        step = np.clip(step, (-0.3 * height, -10.0, -0.5), (0.3 * height, 10.0, 0.5))
        trial = q + step
        if not arm.is_sensible(trial):
            return arm.NO_GAUSSIAN
        worse = (w * (mean - arm.gaussian(grid, trial)[0]) ** 2).sum() > (w * rest**2).sum() * (1 + 1e-9)
        if worse and damping < 1e6:
            damping = 10 * damping
            continue
        damping = max(0.1 * damping, 1e-12)
        q = trial
        if np.abs(step / (np.abs(q) + 1)).max() < 1e-8:
            return np.asarray(q)
    return "the window about the apocentre does not settle"


def _variance(
    grid: Array, count: Array, one: Array, first: Array, second: Array, weight: Array, p: Array
) -> tuple[float, float]:
    """Sandwich variance of A and m: scatter of the particles about the curve, whatever the shape of the track.

    one, first and second are the cells' sums of the squared numbers times 1, r and r^2.
    """
    w = weight * count
    model, slope = arm.gaussian(grid, p)
    n = np.maximum(count, 1e-12)
    scatter = np.maximum(second - 2 * model * first + model**2 * one, 0.0) / n**2  # of the cell's mean radius
    bread = np.linalg.inv((slope * w) @ slope.T)
    covariance = bread @ ((slope * (w * w * scatter)) @ slope.T) @ bread
    return float(covariance[0, 0]), float(covariance[1, 1])
