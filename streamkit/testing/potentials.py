"""Checks of a potential. Positions are random directions at radii spread evenly in the logarithm."""

from __future__ import annotations

import numpy as np

from streamkit import Array, G, Potential
from streamkit.engine import build_field
from streamkit.testing.common import Check, require
from streamkit.testing.dimensions import (
    enclosed_mass,
    has_dimensions,
    mass_agrees_with_force,
    time_is_not_converted_twice,
)
from streamkit.testing.reference import acceleration, divergence_and_curl, drag, gradient
from streamkit.testing.speed import potential_is_fast

COUNT = 200  # more than one batch of the compiled loop


def positions(low: float, high: float, count: int = COUNT) -> Array:
    """(3, count) points in random directions at radii from low to high kpc."""
    rng = np.random.default_rng(20140601)
    directions = rng.standard_normal((3, count))
    return np.asarray(directions / np.sqrt((directions**2).sum(axis=0)) * np.geomspace(low, high, count))


def times(count: int = COUNT) -> Array:
    """(count,) times of the past 5 kpc/(km/s)."""
    return np.linspace(-5.0, 0.0, count)


def _size(a: Array) -> Array:
    return np.asarray(np.sqrt((a**2).sum(axis=0)))


def _require_small(difference: Array, size: Array, limit: float, q: Array, what: str = "") -> None:
    """Check that differences (3, n) are at most ``limit`` in units of sizes (n,); else say where the largest is."""
    ratio = _size(difference) / size
    i = int(np.argmax(ratio))
    place = ", ".join(f"{x:.4g}" for x in q[:, i])
    require((_size(difference) <= limit * size).all(), f"{what}relative difference {ratio[i]:.1e} at ({place}) kpc")


def arrays_in_arrays_out(potential: Potential) -> None:
    """Check that arrays of one shape give three arrays of that shape and are left alone."""
    q, t = positions(1e-2, 1e3), times()
    x, y, z = q.copy()
    result = type(potential).acceleration(x, y, z, t.copy(), *potential.in_engine_units())
    require(isinstance(result, tuple) and len(result) == 3, "acceleration must return a tuple (ax, ay, az)")
    shapes = [np.shape(part) for part in result]
    require(shapes == [(COUNT,)] * 3, f"arrays of shape {(COUNT,)} gave shapes {shapes}")
    require(np.array_equal(np.stack([x, y, z]), q), "acceleration changes the positions it is given")


def floats_agree_with_arrays(potential: Potential) -> None:
    """Check that floats give what arrays give, to 1e-12 of |a|. Compiled bodies only."""
    if not potential.compiled:
        return
    q, t = positions(1e-2, 1e3), times()
    whole = acceleration([potential], t, q)
    values = potential.in_engine_units()
    single = np.array(
        [type(potential).acceleration(*map(float, point), *values) for point in zip(*q, t, strict=True)]
    ).T
    _require_small(single - whole, _size(whole), 1e-12, q)


def is_finite(potential: Potential) -> None:
    """Check that accelerations are finite from 0.01 to 1000 kpc, and on the axes."""
    axes = np.concatenate([radius * np.eye(3) for radius in (1e-2, 1.0, 1e3)], axis=1)
    for q in (positions(1e-2, 1e3), axes):
        a = acceleration([potential], np.zeros(q.shape[1]), q)
        bad = np.flatnonzero(~np.isfinite(a).all(axis=0))
        require(not len(bad), f"not finite at {len(bad)} points, the first {q[:, bad[:1]].ravel()} kpc")


def is_finite_at_the_centre(potential: Potential) -> None:
    """Check that a force which vanishes towards the centre is finite there, where a satellite has its own centre."""
    outer, inner = (_size(acceleration([potential], 0.0, np.full((3, 1), r)))[0] for r in (1e-3, 1e-6))
    if inner < 0.1 * outer:
        centre = acceleration([potential], 0.0, np.zeros((3, 1))).ravel()
        require(
            np.isfinite(centre).all(),
            f"the force falls to zero towards r = 0, and is {centre} there: write it without a division by r, or "
            "add 1e-300 to r^2",
        )


def pulls_inwards(potential: Potential) -> None:
    """Check that the force points inwards, seen over whole spheres from 10 to 300 kpc."""
    mass = enclosed_mass(potential, np.geomspace(10.0, 300.0, 8))
    require(
        (mass > 0).any() or not (mass < 0).any(),
        "the force points outwards everywhere: its sign is wrong, acceleration is -grad(potential)",
    )


def engine_agrees_with_numpy(potential: Potential) -> None:
    """Check that the force in the engine's loop is the NumPy one to 1e-12 of |a|."""
    q, t = positions(1e-2, 1e3), times()
    plain = acceleration([potential], t, q)
    engine = build_field([potential], exact=True).acceleration(t, q)
    _require_small(engine - plain, _size(plain), 1e-12, q)


def engine_adds(potential: Potential) -> None:
    """Check that two of the same give twice the force: the kernel adds to what is there."""
    q, t = positions(1e-1, 1e2), times()
    one = build_field([potential], exact=True).acceleration(t, q)
    two = build_field([potential, potential], exact=True).acceleration(t, q)
    _require_small(two - 2 * one, _size(two), 1e-14, q)


def expansion_meets_its_tolerance(potential: Potential) -> None:
    """Check that a potential that asks for it can be expanded."""
    potential.expanded()


def is_curl_free(potential: Potential) -> None:
    """Check that the force has a potential: its curl vanishes to 1e-6 of |a| / r."""
    q, t = positions(1e-1, 3e2), times()
    _, curl = divergence_and_curl(potential, t, q)
    _require_small(curl * _size(q), _size(acceleration([potential], t, q)), 1e-6, q, "curl: ")


def energy_matches_force(potential: Potential) -> None:
    """Check that minus the gradient of `potential`, if defined, is the acceleration to 1e-6."""
    if not potential.has_energy():
        return
    q, t = positions(1e-1, 3e2), times()
    a = acceleration([potential], t, q)
    _require_small(a + gradient(potential, t, q), _size(a), 1e-6, q, "-grad(potential): ")


def density_is_positive(potential: Potential) -> None:
    """Check that Poisson's equation gives a density of zero or more, unless opted out."""
    q, t = positions(1e-1, 3e2), times()
    divergence, _ = divergence_and_curl(potential, t, q)
    density = -divergence / (4 * np.pi * G)
    mean = _size(acceleration([potential], t, q)) / _size(q) / (4 * np.pi * G)
    i = int(np.argmin(density / mean))
    place = ", ".join(f"{x:.4g}" for x in q[:, i])
    require(
        density[i] >= -1e-6 * mean[i],
        f"-div a / (4 pi G) = {density[i]:.3g} Msun/kpc^3 at ({place}) kpc "
        "(if that is meant, call check(..., negative_density=True))",
    )


def drag_is_a_drag(potential: Potential) -> None:
    """Check that `drag`, if defined, is three finite arrays for arrays, at rest too, and depends on the velocity.

    Floats and machine code must give the same, to 1e-12 of it and of the acceleration.
    """
    if not potential.has_drag():
        return
    q, t = positions(1e-1, 3e2), times()
    v = 150.0 * np.random.default_rng(7).standard_normal(q.shape)
    values = potential.in_engine_units()
    result = type(potential).drag(*q.copy(), *v.copy(), t.copy(), *values)
    require(isinstance(result, tuple) and len(result) == 3, "drag must return a tuple (ax, ay, az)")
    numpy_drag, at_rest = drag([potential], t, q, v), drag([potential], t, q, 0 * v)
    for moving, what in ((numpy_drag, "at 150 km/s"), (at_rest, "at rest: do not divide by the speed alone")):
        require(np.isfinite(moving).all(), f"drag is not finite {what}")
    require((numpy_drag != at_rest).any(), "drag does not depend on the velocity: it belongs into acceleration")
    scale = _size(numpy_drag) + _size(acceleration([potential], t, q))
    field = build_field([potential])
    engine = field.acceleration(t, q, v) - field.acceleration(t, q)
    _require_small(engine - numpy_drag, scale, 1e-12, q, "in the loop, drag: ")
    if potential.compiled:
        points = zip(*q, *v, t, strict=True)
        single = np.array([type(potential).drag(*map(float, point), *values) for point in points]).T
        _require_small(single - numpy_drag, scale, 1e-12, q, "floats, drag: ")


def checks(negative_density: bool) -> tuple[Check, ...]:
    """Return the checks of a potential."""
    always: tuple[Check, ...] = (
        arrays_in_arrays_out,
        floats_agree_with_arrays,
        is_finite,
        is_finite_at_the_centre,
        engine_agrees_with_numpy,
        engine_adds,
        expansion_meets_its_tolerance,
        is_curl_free,
        energy_matches_force,
        drag_is_a_drag,
        mass_agrees_with_force,
        has_dimensions,
        time_is_not_converted_twice,
        potential_is_fast,
    )
    return always if negative_density else (*always, pulls_inwards, density_is_positive)
