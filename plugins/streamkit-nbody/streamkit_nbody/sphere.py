"""The satellite at the start: a sphere of particles in equilibrium."""

from __future__ import annotations

import numpy as np

from streamkit import Array
from streamkit.model import Equilibrium
from streamkit.runfile import StreamInputs
from streamkit_nbody import plummer


def size_of(inputs: StreamInputs) -> float:
    """Return ``G M / |Phi(0)|`` in kpc, the scale radius of a Plummer or Hernquist sphere.

    Raises OutOfDomain if the progenitor is no sphere, or its mass is infinite.
    """
    if _closed(inputs):
        return float(inputs.satellite.radius)  # type: ignore[attr-defined]
    return Equilibrium(inputs.satellite).scale


def mass_of(inputs: StreamInputs) -> float:
    """Return the mass in Msun of all particles: the mass inside 20 scale radii; a Plummer sphere's whole mass."""
    return inputs.mass if _closed(inputs) else Equilibrium(inputs.satellite).mass


def sample(n: int, inputs: StreamInputs) -> tuple[Array, Array]:
    """Draw n particles from the isotropic distribution function, in closed form or by Eddington's formula.

    Returns q (3, n) in kpc and v (3, n) in km/s, with the means subtracted. Raises OutOfDomain if there is no such
    function.
    """
    rng = np.random.default_rng(inputs.seed)
    if _closed(inputs):
        return plummer.sample(n, inputs.mass, size_of(inputs), rng)
    q, v = Equilibrium(inputs.satellite).sample(rng.uniform(size=(6, n)))
    return q - q.mean(axis=1, keepdims=True), v - v.mean(axis=1, keepdims=True)


def _closed(inputs: StreamInputs) -> bool:
    """Whether this plugin samples the sphere by a closed form."""
    return inputs.satellite.kind == "plummer"
