"""Checks of an integrator, against the oracle in ``reference.py``."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cache

import numpy as np

from streamkit import GYR, Array, Integrator, Potential
from streamkit.engine import Field, build_field
from streamkit.testing import reference
from streamkit.testing.common import Check, example_of, require
from streamkit.testing.hosts import TODAY, Isochrone, Satellite, Viscous, progenitor_orbit, swarm
from streamkit.testing.speed import integrator_is_fast

SPAN = 0.4  # gyr: a good part of a radial period
COUNT = 5
STEPS = (0.008, 0.004, 0.002, 0.001, 0.0005)  # Gyr
BLOCKS = (0.002, 0.001, 0.0005)  # gyr: so short that an integrator which chooses its own steps takes one in each
FLOOR = 1e-10  # relative error below which rounding, the track's interpolation and the oracle's own error show


@cache
def _problem(name: str) -> tuple[Field, Array, Array, Array, Array]:
    """Return a field, a start q, v (3, COUNT) at t = 0, and the oracle's state at SPAN."""
    q, v = swarm(COUNT)
    start = np.zeros(COUNT)
    host: Sequence[Potential] = [Isochrone(swing=0.5 if name == "time-dependent" else 0.0)]
    if name == "drag":
        host = [Viscous()]
    field = build_field(host)
    if name != "moving progenitor":
        return field, q, v, *reference.advance(host, q, v, start, SPAN * GYR)
    orbit = progenitor_orbit(0.0, SPAN, max_step=0.0005)
    field = field.with_moving(build_field([Satellite()]), orbit)
    return field, q, v, *reference.advance(host, q, v, start, SPAN * GYR, [Satellite()], (*TODAY, 0.0))


PROBLEMS = ("fixed", "time-dependent", "moving progenitor")


def _problems(cls: type[Integrator]) -> tuple[str, ...]:
    """Return the problems that an integrator must solve: one with drag, if it says that it can."""
    return (*PROBLEMS, "drag") if cls.drag else PROBLEMS


def _run(integrator: Integrator, field: Field, q: Array, v: Array, t0: Array, t1: float) -> Array:
    """(6, n) states after one call, from copies."""
    q, v = q.copy(), v.copy()
    integrator.advance(field, q, v, t0, t1)
    return np.concatenate([q, v])


def _error(state: Array, q: Array, v: Array) -> float:
    """Largest relative error of position or velocity."""
    dq, dv = np.abs(state[:3] - q).max(axis=0), np.abs(state[3:] - v).max(axis=0)
    return float(max((dq / np.sqrt((q**2).sum(axis=0))).max(), (dv / np.sqrt((v**2).sum(axis=0))).max()))


def has_step(cls: type[Integrator]) -> bool:
    """Return whether an integrator has a longest step that the checks can vary: a field called ``step``."""
    return "step" in cls.parameters()


def _in_blocks(integrator: Integrator, problem: str, block: float) -> float:
    """Error of a problem that is handed over in blocks of about ``block`` Gyr, as the model does."""
    field, q, v, *end = _problem(problem)
    state = np.concatenate([q, v])
    for begin, stop in itertools.pairwise(np.linspace(0.0, SPAN * GYR, round(SPAN / block) + 1)):
        state = _run(integrator, field, state[:3], state[3:], np.full(COUNT, begin), stop)
    return _error(state, *end)


def reaches_its_order(integrator: Integrator) -> None:
    """Check that the error falls as h^(order - 0.3); h is the field ``step`` or else the length of a block.

    Without a field ``step``, an error below 1e-8 in blocks of 20 Myr is proof enough.
    """
    cls, fixed = type(integrator), has_step(type(integrator))
    for name in _problems(cls):
        if not fixed and _in_blocks(integrator, name, 0.02) < 1e-8:
            continue
        h = np.array(STEPS if fixed else BLOCKS)
        if fixed:
            errors = np.array([_in_blocks(example_of(cls, step=step), name, SPAN) for step in h])
        else:
            errors = np.array([_in_blocks(integrator, name, block) for block in h])
            if (errors < 1e-8).all():
                continue
        use = (errors > FLOOR) & (errors < 0.1)
        require(use.sum() >= 2, f"{name}: errors {errors} for h = {h} Gyr leave no range to measure in")
        slope = np.polyfit(np.log(h[use]), np.log(errors[use]), 1)[0]
        require(
            slope >= integrator.order - 0.3,
            f"{name}: declared order {integrator.order}, measured {slope:.2f} (errors {errors})",
        )


def reaches(accuracy: float) -> Check:
    """Return the check of integrators that choose their own steps: blocks of 20 Myr, to ``accuracy``."""

    def reaches_its_accuracy(integrator: Integrator) -> None:
        if has_step(type(integrator)):
            return
        for name in _problems(type(integrator)):
            error = _in_blocks(integrator, name, 0.02)
            require(error <= accuracy, f"{name}: relative error {error:.1e}, {accuracy:.0e} allowed")

    return reaches_its_accuracy


def comes_back(integrator: Integrator) -> None:
    """Check that forth, and back with reversed velocities, ends as near to the start as its error allows."""
    field, q, v, *end = _problem("fixed")
    start = np.zeros(COUNT)
    there = _run(integrator, field, q, v, start, SPAN * GYR)
    allowed = max(4 * _error(there, *end), 1e-9)
    back = _run(integrator, field, there[:3], -there[3:], start, SPAN * GYR)
    error = _error(np.concatenate([back[:3], -back[3:]]), q, v)
    require(error <= allowed, f"misses the start by a relative error of {error:.1e}, {allowed:.1e} allowed")


def takes_any_number(integrator: Integrator) -> None:
    """Check no particles, one, and a batch and a bit: each moves as if it were alone."""
    field = _problem("moving progenitor")[0]
    stop = 0.02 * GYR
    _run(integrator, field, np.empty((3, 0)), np.empty((3, 0)), np.empty(0), stop)
    q, v = swarm(131)
    together = _run(integrator, field, q, v, np.zeros(131), stop)
    for some in ([0], [130], list(range(0, 131, 7))):
        alone = _run(integrator, field, q[:, some], v[:, some], np.zeros(len(some)), stop)
        if has_step(type(integrator)):
            require(np.array_equal(alone, together[:, some]), "the result depends on the size of the batch")
        else:  # steps chosen for the whole set may differ in their rounding
            require(
                _error(alone, together[:3, some], together[3:, some]) <= 1e-9,
                "the result depends on the size of the batch, beyond 1e-9",
            )


def takes_releases_off_the_grid(integrator: Integrator) -> None:
    """Check that particles that start within the block, one at its very end, arrive where the oracle says."""
    field, q, v, *_ = _problem("moving progenitor")
    stop = 0.02 * GYR
    t0 = np.array([0.0, 0.3137, 0.5, 0.9999, 1.0]) * stop
    errors = []
    for start in (np.zeros(COUNT), t0):
        end = reference.advance([Isochrone()], q, v, start, stop, [Satellite()], (*TODAY, 0.0))
        errors.append(_error(_run(integrator, field, q, v, start, stop), *end))
    allowed = max(4 * errors[0], 1e-8)
    require(
        errors[1] <= allowed,
        f"relative error {errors[1]:.1e} for releases inside the block, {allowed:.1e} allowed",
    )


def ends_without_a_force(integrator: Integrator) -> None:
    """Check that particles whose force is NaN become NaN, in a short time: the model rejects them by that."""
    q, v = swarm(COUNT)
    nowhere = build_field([Isochrone.model_construct(mass=np.nan, b=3.0, swing=0.0)])
    state = _run(integrator, nowhere, q, v, np.zeros(COUNT), 0.02 * GYR)
    require(np.isnan(state).any(axis=0).all(), "the force is NaN, and the particles move: their states must be NaN")


def checks(accuracy: float) -> tuple[Check, ...]:
    """Return the checks of an integrator."""
    return (
        reaches_its_order,
        reaches(accuracy),
        comes_back,
        takes_any_number,
        takes_releases_off_the_grid,
        ends_without_a_force,
        integrator_is_fast,
    )
