"""Checks that a fit with a component ends: seconds per stream, and what a fit then takes."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from streamkit import GYR, Integrator, Observable, Potential, Stripping
from streamkit.engine import build_field
from streamkit.testing.common import require
from streamkit.testing.hosts import MASS, Isochrone, progenitor_orbit, swarm
from streamkit.testing.reference import acceleration
from streamkit.testing.streams import example_stream

STREAMS = 32 * 5000  # streams of a fit with the sampler's defaults
MONTH = 30 * 86400.0
ALONE, TOGETHER, BATCH = 11_000, 17_000, 64  # calls of an uncompiled force per stream: with one position, and with many
EVALUATIONS = 2_000_000  # positions at which a stream of 10 000 particles asks for a compiled force


def seconds(call: Callable[[], object], budget: float = 0.2) -> float:
    """Return the seconds of one call, the shortest of a few within a budget, after a first one."""
    call()
    begin, best = time.perf_counter(), np.inf
    while time.perf_counter() - begin < budget:
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return float(best)


def _judge(cost: float, advice: str) -> None:
    fit = cost * STREAMS
    require(
        fit < MONTH,
        f"costs {cost:.3g} s per stream of 10 000 particles: a fit of {STREAMS} streams would take {fit / 86400:.0f} "
        f"days of CPU time. {advice}",
    )


def potential_is_fast(potential: Potential) -> None:
    """Check that a fit takes less than a month."""
    if potential.compiled:
        field, q = build_field([potential]), swarm(2000)[0]
        cost = EVALUATIONS / 2000 * seconds(lambda: field.acceleration(np.zeros(2000), q))
    else:
        one, many = swarm(1)[0], swarm(BATCH)[0]
        cost = ALONE * seconds(lambda: acceleration([potential], 0.0, one))
        cost += TOGETHER * seconds(lambda: acceleration([potential], 0.0, many))
    advice = "Do what does not depend on the position once: in a constant of the module, or in prepare()."
    if not potential.compiled:
        advice += " Let it compile if you can: without `compiled = False` it costs a hundredth."
    _judge(cost, advice)


def stripping_is_fast(scheme: Stripping) -> None:
    """Check that a fit takes less than a month."""
    orbit = progenitor_orbit(-3.0).at(np.linspace(-3.0, 0.0, 10_000, endpoint=False) * GYR)
    tail = np.where(np.arange(10_000) % 2, 1, -1)
    normals = np.random.default_rng(7).standard_normal((scheme.draws, 10_000))
    cost = seconds(lambda: scheme.release(orbit, tail, MASS, normals))
    _judge(cost, "Work on whole arrays, without a loop over particles.")


def integrator_is_fast(integrator: Integrator) -> None:
    """Check that a fit takes less than a month, from one block of 20 Myr for particles released over 3 Gyr."""
    field, (q, v) = build_field([Isochrone()]), swarm(5000)
    start, block = np.zeros(5000), 0.02
    cost = 3.0 / block * seconds(lambda: integrator.advance(field, q.copy(), v.copy(), start, block * GYR))
    _judge(cost, "Use split_step or adaptive_step of streamkit.engine, or longer steps.")


def observable_is_fast(observable: Observable) -> None:
    """Check that a fit takes less than a month."""
    stream = example_stream()
    cost = 10_000 / len(stream) * seconds(lambda: observable.predict(stream))
    _judge(cost, "Work on whole arrays, without a loop over particles.")
