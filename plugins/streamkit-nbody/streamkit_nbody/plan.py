"""The options of a user, and the plan that follows: softening, step, and number of steps."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from streamkit import GYR, G, Orbit
from streamkit.runfile import Spec, StreamInputs
from streamkit_nbody import sphere

RECORD = 0.01 * GYR  # longest time between two records of bound mass, energy and particles inside the tidal radius
TRAVEL = 0.5  # a particle of mean speed moves at most this many softening lengths in a step (Rodionov & Sotnikova 2005)
# Longest step in units of sqrt(r / acceleration) by the host on the satellite's orbit: 300 steps per revolution.
TURN = 0.02


@dataclass(frozen=True)
class Options:
    """The command's options; None means a choice that follows from the run."""

    particles: int = 20000  # number of particles
    softening: float | None = None  # Plummer-equivalent softening length in kpc
    theta: float = 0.7  # opening angle of the tree
    step: float | None = None  # longest step in Gyr


@dataclass(frozen=True)
class Plan:
    """The numbers of a run: kpc, Msun, times in kpc/(km/s)."""

    # As in `Options`, with all choices made.
    particles: int
    softening: float
    theta: float
    # Time from the start to today, length of a step, steps between records, number of records until today.
    span: float
    step: float
    steps: int
    records: int

    def time(self, record: int) -> float:
        """Return the time of a record since the start."""
        return self.span * record / self.records


def make_plan(inputs: StreamInputs, orbit: Orbit, options: Options) -> Plan:
    """Choose what the options leave open.

    Softening: the mean distance between particles at the centre, n0^(-1/3), with n0 = 3 N / (4 pi a^3). Step: the
    shorter one of `TRAVEL` softening lengths at the mean speed, sqrt(3 pi / 32 G M / a), and of `TURN` times the
    shortest dynamical time of the host along the orbit, rounded down to divide the time between records.

    References
    ----------
    Rodionov & Sotnikova 2005, Astron. Rep. 49, 470: softening 1.5 to 2 times below that distance and steps of less
    than half a softening length keep a Plummer sphere as it was. The longer softening here is that of a spline, whose
    force is exact beyond 2.8 of them, and halves the number of steps.
    """
    radius = sphere.size_of(inputs)
    n = options.particles
    softening = options.softening or radius * (4.0 * math.pi / (3.0 * n)) ** (1.0 / 3.0)
    if options.step is None:
        speed = math.sqrt(3.0 * math.pi / 32.0 * G * inputs.mass / radius)
        dynamical = np.sqrt(orbit.r / np.sqrt((orbit.a**2).sum(axis=0))).min()
        longest = min(TRAVEL * softening / speed, TURN * float(dynamical))
    else:
        longest = options.step * GYR
    span = inputs.lookback * GYR
    records = max(math.ceil(span / RECORD), 1)
    steps = max(math.ceil(span / records / longest - 1e-9), 1)
    return Plan(n, softening, options.theta, span, span / records / steps, steps, records)


def content(spec: Spec, inputs: StreamInputs, plan: Plan) -> dict[str, Any]:
    """Return all that determines the particles of a run, as JSON holds it; two runs are the same if it is."""
    host = {name: {"kind": p.kind, **p.model_dump(mode="json")} for name, p in inputs.potentials.items()}
    bodies = {
        name: {
            "kind": b.potential.kind,
            **b.potential.model_dump(mode="json"),
            "position": b.q.tolist(),
            "velocity": b.v.tolist(),
            "friction": b.friction,
            "reflex": b.reflex,
        }
        for name, b in inputs.bodies.items()
    }
    suppliers = {path: who for path, cls, who in spec.components() if cls.role == "potential"}
    return {
        "potential": host["potential"] if list(host) == ["potential"] else host,
        "progenitor": {
            "kind": inputs.satellite.kind,
            **inputs.satellite.model_dump(mode="json"),
            "position": inputs.q.tolist(),
            "velocity": inputs.v.tolist(),
            "lookback": inputs.lookback,
        },
        "seed": inputs.seed,
        "particles": plan.particles,
        "softening": plan.softening,
        "theta": plan.theta,
        "step": plan.step / GYR,
        "suppliers": suppliers,
    } | ({"bodies": bodies} if bodies else {})


def digest(document: dict[str, Any]) -> str:
    """Return the SHA-256 of a run's content."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
