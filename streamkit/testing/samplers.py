"""Checks of a sampler: a correlated Gaussian whose moments and evidence are known in closed form."""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import Any

import numpy as np

from streamkit import Array, Sampler, Samples
from streamkit.testing import common
from streamkit.testing.common import Check, require

RHO, SD = 0.6, 0.4
INVERSE = np.linalg.inv(SD**2 * np.array([[1.0, RHO], [RHO, 1.0]]))
LN_NORM = -math.log(2 * math.pi * SD**2 * math.sqrt(1 - RHO**2))
# Of a normalised Gaussian far from the ends of a prior that is uniform between -5 and 5.
LN_EVIDENCE = -2 * math.log(10.0)


class Gaussian:
    """The Gaussian as a `streamkit.Target`, for one use of a sampler; a tenth of the prior has no stream."""

    def __init__(self, seed: int = 1) -> None:
        self.size, self.seed, self.workers, self.progress = 2, seed, 4, False
        self.calls: Counter[bytes] = Counter()
        self.walked = False

    def from_unit(self, u: Array) -> Array:
        """Return 10 u - 5."""
        return np.asarray(10.0 * np.asarray(u) - 5.0)

    def ln_prior(self, points: Array) -> Array:
        """Return -2 ln 10 inside."""
        return np.where((np.abs(points) <= 5).all(axis=1), LN_EVIDENCE, -np.inf)

    def evaluate(self, points: Array) -> Array:
        """Return the ln density."""
        points = np.atleast_2d(points)
        self.calls.update(point.tobytes() for point in np.ascontiguousarray(points, dtype=float))
        lnl = LN_NORM - 0.5 * np.einsum("ni,ij,nj->n", points, INVERSE, points)
        return np.where((points[:, 0] > 4) | ~np.isfinite(self.ln_prior(points)), -np.inf, lnl)

    def expect(self, calls: float) -> None:
        """Show nothing."""

    def time_left(self) -> float:
        """Return infinity."""
        return math.inf

    def ensemble(self, sampler: Any) -> None:
        """Note that streamkit's own ensemble was asked for."""
        self.walked = True


def sampled(component: Sampler, seed: int = 1) -> tuple[Gaussian, Samples | None]:
    """Return the target after its use and the last samples, None if streamkit's own ensemble was asked for."""
    target = Gaussian(seed)
    last = next(iter(deque(component.sample(target), maxlen=1)), None)
    require(last is not None or target.walked, "sample yields nothing: the last samples it yields are the result")
    return target, last


def samples_a_gaussian(component: Sampler) -> None:
    """Check shapes, weights, means, standard deviations, correlation and evidence."""
    target, found = sampled(component)
    if found is None:
        return
    n = len(found.points)
    require(found.points.shape == (n, 2) and found.ln_weights.shape == (n,), "points are (n, d) and ln_weights (n,)")
    known = all(point.tobytes() in target.calls for point in np.ascontiguousarray(found.points))
    require(known, "gives points that it never asked target.evaluate for")
    weights = np.exp(found.ln_weights - found.ln_weights.max())
    weights /= weights.sum()
    error = math.sqrt(float(np.sum(weights**2)))
    mean = weights @ found.points
    away = found.points - mean
    covariance = (away * weights[:, None]).T @ away
    require((np.abs(mean) < 5 * SD * error).all(), f"the means of a Gaussian at 0 with sd {SD} are {mean}")
    sd = np.sqrt(np.diag(covariance))
    require((np.abs(sd / SD - 1) < 5 * error).all(), f"standard deviations of {SD} are found as {sd}")
    rho = covariance[0, 1] / sd.prod()
    require(abs(rho - RHO) < 5 * error, f"a correlation of {RHO} is found as {rho:.3f}")
    if np.isfinite(found.ln_evidence):
        off = abs(found.ln_evidence - LN_EVIDENCE)
        told = f"ln evidence {found.ln_evidence:.3f} +- {found.ln_evidence_error:.3f}, and {LN_EVIDENCE:.3f} is right"
        require(off < max(5 * found.ln_evidence_error, 0.02), told)


def repeats_itself(component: Sampler) -> None:
    """Check that the same target gives the same samples, and another seed others: resuming rests on this."""
    (first, one), (again, two), (_, other) = (sampled(component, seed) for seed in (1, 1, 2))
    if one is None or two is None or other is None:
        return
    require(first.calls.keys() == again.calls.keys(), "the same target is asked for other points the second time")
    same = np.array_equal(one.points, two.points) and np.array_equal(one.ln_weights, two.ln_weights)
    require(same, "the same target gives other samples the second time: take all chance from target.seed")
    require(not np.array_equal(one.points, other.points), "another seed gives the same samples")


def fields_are_described(component: Sampler) -> None:
    """Check that each field has a description."""
    silent = [name for name, field in type(component).model_fields.items() if not field.description]
    require(not silent, f"no description: {', '.join(silent)} (write Field(description=...))")


CHECKS: tuple[Check, ...] = (
    *(check for check in common.COMMON if check is not common.fields_are_described),
    fields_are_described,
    samples_a_gaussian,
    repeats_itself,
)
