"""The apocentre of one arm: a Gaussian r(angle) about the maximum of the track, smooth in the particles.

There are no hard edges: angles are shared between the two nearest cells of a fine grid, the window about the
maximum has soft edges, and it is re-centred on the fitted maximum until both agree. Nothing jumps when a particle
moves a little, which is what a sampler needs.

`fit_arm` fits the mean of all particles, `fit_turning` the branch that turns round where several overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array

CELL = 1.0
"""Grid of angles, degrees."""
KERNEL = 4.0
"""Standard deviation of the smoothing kernel of the track, degrees."""
WINDOW, EDGE = 40.0, 5.0
"""Half width of the fitted window (Gibbons+ 2014) and the scale of its soft edges, degrees."""
REACH = 45.0
"""How far from the progenitor's own apocentre the first guess of the maximum is looked for, degrees."""
NEAR = 2 * REACH + WINDOW + 3 * EDGE
"""Particles farther than this from the progenitor's own apocentre cannot matter, degrees."""
FEWEST = 30
"""Fewest particles in the window (sum of weights)."""
BEYOND = (10.0, 60.0)
"""Where beyond the progenitor's own apocentre, in degrees, only debris that turns round there has come."""
FEWEST_BEYOND = 10
"""Fewest particles there (sum of weights)."""
START = 50.0
"""Width (standard deviation) of the Gaussian that the fit of that branch begins with, degrees."""
SPARSE = 0.2
"""Density along the arm, in units of its largest, below which angles begin to count less."""
COVERAGE = 0.05
"""Least share of the particles in the window on either side of the maximum: a Gaussian through debris that only rises,
or only falls, says where it ends."""
LOW = 4
"""Power of the mean height there, minus: a branch three times as high counts 1 % of the lower one."""
FLAT = 1e-9
"""Least eigenvalue of the ridge's curvature, its diagonal scaled to 1: below, the particles do not fix a Gaussian."""
BREADTH = 0.1
"""Standard deviation in radius of the kernel about that branch, in units of its apocentre."""

NO_GAUSSIAN = "no Gaussian fits the track near the progenitor's own apocentre"
NOT_YET = "the track does not come down beyond its maximum"
NO_RISE = "the track does not rise to its maximum"
TOO_FEW = "too few particles near the apocentre"


@dataclass(frozen=True)
class ArmFit:
    """The fitted apocentre: angle (degrees, progenitor at 0, leading positive) and radius (kpc).

    variance holds those of radius and angle from the finite number of particles; track and curve are (angle, r)
    for plots.
    """

    angle: float
    radius: float
    variance: tuple[float, float]
    track: tuple[Array, Array]
    curve: tuple[Array, Array]


def fit_arm(angle: Array, r: Array, number: Array, guide: float, coverage: float = COVERAGE) -> ArmFit | str:
    """Fit particles at angles (n,), radii r (n,), each standing for a number (n,), near the guiding angle.

    Or say why there is no apocentre: with less than a share ``coverage`` of them on either side there is none.
    """
    if len(angle) < FEWEST:
        return "too few particles"
    grid = np.arange(-180.0, 180.0 + CELL, CELL) + guide
    near = (angle > grid[0]) & (angle < grid[-1])
    angle, r, number = angle[near], r[near], number[near]
    count, total = _cells(angle, grid, number, number * r)
    density = _convolve(count)
    smooth = _convolve(total) / np.maximum(density, 1e-12)  # kernel-smoothed mean radius
    start = _first_guess(grid, smooth, density, guide)
    if start is None:
        return TOO_FEW
    p = _fit(grid, count, total, start, float(np.interp(start, grid, smooth)))
    if isinstance(p, str):
        return p
    if abs(p[1] - guide) > 2 * REACH:
        return NO_GAUSSIAN
    window = _window(grid - p[1])
    if reason := _one_sided(grid, window * count, p[1], coverage):
        return reason
    one, first, second = _cells(angle, grid, number**2, number**2 * r, (number * r) ** 2)
    variance = _variance(grid, count, one, first, second, window, p)
    return _found(p, variance, grid, smooth, count)


def fit_turning(angle: Array, r: Array, number: Array, guide: float, coverage: float = COVERAGE) -> ArmFit | str:
    """Fit, as `fit_arm`, the branch that turns round, among others that pass through the same angles.

    The Gaussian r(angle) is the ridge of the particles and not their mean: each counts by a Gaussian kernel of its
    distance in radius (modal regression; Yao & Li 2014, Scand. J. Statist. 41, 656). All angles count alike, many
    particles or few, which leaves the stripping rate out. The fit begins with what is beyond the apocentre, where the
    debris on its way out has hardly come.
    """
    near = np.abs(angle - guide) < NEAR
    angle, r, number = angle[near], r[near], number[near]
    if len(angle) < FEWEST:
        return TOO_FEW
    number = _alike(angle, number, guide)
    q = _from_beyond(angle, r, number, guide)
    if not isinstance(q, str):
        q = _ridge(angle, r, number, q)
    if isinstance(q, str):
        return q
    if abs(q[1] - guide) > 2 * REACH:
        return NO_GAUSSIAN
    centre = float(q[1])
    slope, rest, share = _shares(angle, r, number, q)
    if reason := _one_sided(angle, share, centre, coverage):
        return reason
    curvature = (slope * (share * (1 - (rest / (BREADTH * q[0])) ** 2))) @ slope.T
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    if not np.linalg.eigvalsh(curvature / np.outer(scale, scale))[0] > FLAT:
        return "the ridge about the apocentre is flat"
    bread = np.linalg.inv(curvature)
    covariance = bread @ ((slope * (share * rest) ** 2) @ slope.T) @ bread
    grid = centre + np.arange(-WINDOW, WINDOW + CELL, CELL)
    inside = np.abs(angle - centre) < WINDOW
    count, total = map(_convolve, _cells(angle[inside], grid, share[inside], (share * r)[inside]))
    variance = float(covariance[0, 0]), float(covariance[1, 1])
    return _found(q, variance, grid, total / np.maximum(count, 1e-12), count)


def _found(q: Array, variance: tuple[float, float], grid: Array, track: Array, count: Array) -> ArmFit:
    """Return the fit q = (A, m, ln s), and for plots the track where there are particles, and the curve."""
    shown = count > 0.2
    curve = q[1] + np.linspace(-WINDOW, WINDOW, 81)
    return ArmFit(
        angle=float(q[1]),
        radius=float(q[0]),
        variance=variance,
        track=(grid[shown], track[shown]),
        curve=(curve, _gaussian(curve, q)[0]),
    )


def _alike(angle: Array, number: Array, guide: float) -> Array:
    """Numbers (n,) of the same sum that make all angles count alike, but for those with hardly any particle."""
    grid = np.arange(-NEAR - CELL, NEAR + 2 * CELL, CELL) + guide
    (count,) = _cells(angle, grid, number)
    density = _convolve(count)
    even = number / (np.interp(angle, grid, density) + SPARSE * density.max())
    return np.asarray(even * number.sum() / even.sum())


def _from_beyond(angle: Array, r: Array, number: Array, guide: float) -> Array | str:
    """A Gaussian at the guide through the particles beyond it, the lower ones where the others have come too."""
    x = (angle - guide) * np.sign(guide)
    weight = _between(x, *BEYOND) * number
    if weight.sum() < FEWEST_BEYOND:
        return "too few particles beyond the apocentre"
    height = r * np.exp(0.5 * (x / START) ** 2)
    return np.array([((weight * height**-LOW).sum() / weight.sum()) ** (-1 / LOW), guide, np.log(START)])


def _ridge(angle: Array, r: Array, number: Array, q: Array) -> Array | str:
    """Climb to the ridge from q = (A, m, ln s): least squares with the particles' shares, until neither moves."""
    gain, last = 1.0, np.zeros(3)
    for _ in range(300):
        slope, rest, share = _shares(angle, r, number, q)
        if share.sum() < FEWEST / 2:
            return TOO_FEW
        normal = (slope * share) @ slope.T
        normal[np.diag_indices(3)] *= 1 + 1e-9
        limit = np.array([0.1 * q[0], 8.0, 0.3])
        step = np.clip(np.linalg.solve(normal, slope @ (share * rest)), -limit, limit)
        if (step / limit) @ last < 0:  # it went too far, as the window and the kernel move with it
            gain *= 0.5
        last = step / limit
        q = q + gain * step
        if not _sensible(q):
            return NO_GAUSSIAN
        if np.abs(step / (np.abs(q) + 1)).max() < 1e-7:
            return q
    return "the ridge about the apocentre does not settle"


def _shares(angle: Array, r: Array, number: Array, q: Array) -> tuple[Array, Array, Array]:
    """Slopes (3, n), residuals (n,), and what each particle counts (n,): its number by the window and by the kernel."""
    model, slope = _gaussian(angle, q)
    rest = r - model
    share = number * _window(angle - q[1]) * np.exp(-0.5 * (rest / (BREADTH * q[0])) ** 2)
    return slope, rest, share


def _cells(angle: Array, grid: Array, *values: Array) -> list[Array]:
    """Sums of values (n,) on the grid, each particle shared linearly between its two neighbours."""
    place = (angle - grid[0]) / CELL
    i = place.astype(np.int64)
    f = place - i

    return [
        np.asarray(np.bincount(i, (1 - f) * w, len(grid)) + np.bincount(i + 1, f * w, len(grid)), dtype=float)
        for w in values
    ]


def _convolve(cell: Array) -> Array:
    half = np.arange(-int(4 * KERNEL / CELL), int(4 * KERNEL / CELL) + 1) * CELL
    kernel = np.exp(-0.5 * (half / KERNEL) ** 2)
    return np.convolve(cell, kernel / kernel.sum(), mode="same")


def _first_guess(grid: Array, smooth: Array, density: Array, guide: float) -> float | None:
    """Where to begin: the maximum of the smoothed track nearest the guide, or its highest place if it has none."""
    near = (np.abs(grid - guide) <= REACH) & (density > 0.05 * density.max())
    inner = smooth[1:-1]
    peak = np.flatnonzero((inner >= smooth[:-2]) & (inner > smooth[2:]) & near[1:-1]) + 1
    if len(peak) == 0:
        return float(grid[near][np.argmax(smooth[near])]) if near.any() else None  # the fit says whether it is one
    high = peak[smooth[peak] > 0.9 * smooth[peak].max()]
    return float(grid[high[np.argmin(np.abs(grid[high] - guide))]])


def _window(x: Array) -> Array:
    return _between(x, -WINDOW, WINDOW)


def _between(x: Array, low: float, high: float) -> Array:
    """1 between low and high, 0 outside, with soft edges."""
    return np.asarray(0.5 * (np.tanh((x - low) / EDGE) - np.tanh((x - high) / EDGE)))


def _gaussian(x: Array, q: Array) -> tuple[Array, Array]:
    """A exp(-(x - m)^2 / 2 s^2) at x (n,) and its derivatives (3, n) by A, m and ln s; q = (A, m, ln s)."""
    u = (x - q[1]) * np.exp(-q[2])
    g = np.exp(-0.5 * u * u)
    model = q[0] * g
    return model, np.array([g, model * u * np.exp(-q[2]), model * u * u])


def _one_sided(angle: Array, share: Array, centre: float, coverage: float) -> str:
    """Say if too little of the shares (n,) at angles (n,) is beyond the maximum, or short of it."""
    beyond = share[np.abs(angle) > abs(centre)].sum() / share.sum()
    return NOT_YET if beyond < coverage else NO_RISE if beyond > 1 - coverage else ""


def _sensible(q: Array) -> bool:
    """Whether height and width of the Gaussian q = (A, m, ln s) are those of any apocentre."""
    return bool(0 < q[0] < 1e4 and np.log(5.0) < q[2] < np.log(1e3))


def _fit(grid: Array, count: Array, total: Array, centre: float, height: float) -> Array | str:
    """Least squares of the Gaussian (A, m, s) to the particles' radii, in the window centred on its own maximum.

    Every step is one of Gauss and Newton, in ln s so that s stays positive, damped where it would make the fit
    worse; the window follows the maximum, until neither moves.
    """
    mean = total / np.maximum(count, 1e-12)
    q = np.array([height, centre, np.log(60.0)])
    damping = 1e-3
    for _ in range(200):
        w = _window(grid - q[1]) * count
        if w.sum() < FEWEST:
            return TOO_FEW
        model, slope = _gaussian(grid, q)
        rest = mean - model
        normal = (slope * w) @ slope.T
        normal[np.diag_indices(3)] *= 1 + damping
        step = np.linalg.solve(normal, slope @ (w * rest))
        step = np.clip(step, (-0.3 * height, -10.0, -0.5), (0.3 * height, 10.0, 0.5))
        trial = q + step
        if not _sensible(trial):
            return NO_GAUSSIAN
        worse = (w * (mean - _gaussian(grid, trial)[0]) ** 2).sum() > (w * rest**2).sum() * (1 + 1e-9)
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
    model, slope = _gaussian(grid, p)
    n = np.maximum(count, 1e-12)
    scatter = np.maximum(second - 2 * model * first + model**2 * one, 0.0) / n**2  # of the cell's mean radius
    bread = np.linalg.inv((slope * w) @ slope.T)
    covariance = bread @ ((slope * (w * w * scatter)) @ slope.T) @ bread
    return float(covariance[0, 0]), float(covariance[1, 1])
