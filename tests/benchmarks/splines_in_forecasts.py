"""What splines through few particles do to a forecast: the bounds of Bonaca & Hogg 2018 (arXiv:1804.06854) for GD-1.

    python tests/benchmarks/splines_in_forecasts.py [--particles 400 20000] [--knots 25 8] [--sigma 0 0.3] [--seeds 4]

They draw a cubic spline through 400 particles of a streakline, in each observable, and take the slopes of a parameter
from the splines of two streams. The stream here is their GD-1 as far as their code has it: their host and Sun, a
cluster of 10^4 Msun that dissolves in 1.6 Gyr, the place and velocity with which their search begins. Data are every
0.5 deg, with the errors of their fiducial survey. Place and velocity are free without priors; bulge and disc have the
priors of their matrices: 10 % of a length, and of the logarithm of a mass, which is a factor of ten.

The lines give the bounds of the halo's scale velocity and radius and of its axis ratios along the Galaxy's x and z: by
one set of random numbers, and by products of the slopes of two halves of all sets, which have no bias by noise (none
where noise leaves no information). Without a velocity dispersion no random number matters, so that there is one set.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import astropy.coordinates as coord
import astropy.units as u
import numpy as np
from scipy.interpolate import make_lsq_spline

import streamkit as sk
from streamkit.units import G

PLACE = coord.SkyCoord(154.377 * u.deg, 41.5309 * u.deg, 8.2 * u.kpc)
VELOCITY = (-90.0, -250.0, -120.0)  # km/s
V_H, R_H = 430.0, 30.0  # km/s, kpc
DEX = np.log(10)
# Value, step to either side, and the standard deviation of the prior, of each number of the host.
HOST = {
    "bulge.mass": (5e9, 0.005 * 5e9, 0.97 * DEX * 5e9),
    "bulge.a": (0.7, 0.03, 0.07),
    "disc.mass": (6.8e10, 0.005 * 6.8e10, 1.083 * DEX * 6.8e10),
    "disc.a": (3.0, 0.03, 0.3),
    "disc.b": (0.28, 0.015, 0.028),
    "halo.mass": (V_H, 1.5, np.inf),  # its scale velocity in km/s: the scale mass is the square times R_h / G
    "halo.rs": (R_H, 0.3, np.inf),
    "halo.p": (1.0, 0.006, np.inf),
    "halo.q": (1.0, 0.006, np.inf),
}
STEPS = (3e-3, 3e-3, 3e-3, 0.06, 0.06, 0.06)  # kpc and km/s, of the place and velocity
ERRORS = (0.1, 2.0, 5.0, 0.1, 0.1)  # deg, kpc, km/s, mas/yr
APART = 0.5  # deg


HALO = [f"potential.halo.{name}" for name in ("mass", "rs", "p", "q")]


def numbers() -> dict[str, tuple[float, float, float]]:
    """Return value, step and prior sd of the fifteen parameters."""
    galaxy = coord.Galactocentric(galcen_distance=8.3 * u.kpc, z_sun=27 * u.pc)
    at = PLACE.transform_to(galaxy)
    places = zip(("x", "y", "z", "vx", "vy", "vz"), (at.x.value, at.y.value, at.z.value, *VELOCITY), STEPS, strict=True)
    found = {f"progenitor.{name}": (float(x), h, np.inf) for name, x, h in places}
    return found | {f"potential.{name}": each for name, each in HOST.items()}


def model(particles: int, sigma: float, seed: int) -> sk.Model:
    """Return the model of the stream in the host."""
    document: dict[str, Any] = {
        "seed": seed,
        "sun": {"r0": 8.3, "z": 0.027, "v_circ": 237.8, "u": 11.1, "v": 12.2, "w": 7.3},
        "potential": {
            "bulge": {"kind": "hernquist"},
            "disc": {"kind": "miyamoto_nagai"},
            "halo": {"kind": "nfw_triaxial", "phi": "90 deg"},
        },
        "progenitor": {"kind": "plummer", "mass": 1e4, "radius": 0.02, "lookback": 1.6},
        "stripping": {"kind": "streakline", "particles": particles, "sigma": sigma, "mass_loss": 0.99},
    }  # fmt: skip  by its angle the halo has p along x
    for name in numbers():
        *sections, last = name.split(".")
        inner = document
        for section in sections:
            inner = inner[section]
        inner[last] = {"uniform": [-1e3, 1e3] if sections == ["progenitor"] else [1e-3, 1e13]}
    return sk.Model(document)


def seen(model: sk.Model, values: dict[str, float]) -> sk.Array:
    """(6, n) Return what is seen of a stream: phi1, phi2, distance, radial velocity and the proper motions."""
    mass = values[HALO[0]] ** 2 * values[HALO[1]] / G
    sky = model.stream(values | {HALO[0]: mass}).seen("GD1Koposov10")
    return np.array([sky.lon, sky.lat, sky.distance, sky.radial_velocity, sky.pm_lon_coslat, sky.pm_lat])


def lines(stream: sk.Array, at: sk.Array, knots: int) -> sk.Array:
    """(5, m) Return the values at longitudes of a spline through all particles, with so many knots inside."""
    phi1, *columns = stream[:, np.argsort(stream[0])]
    inside = np.linspace(np.percentile(phi1, 10), np.percentile(phi1, 90), knots)
    t = np.concatenate([np.repeat(phi1[0], 4), inside, np.repeat(phi1[-1], 4)])
    return np.array([make_lsq_spline(phi1, each, t)(at) for each in columns])


def slopes(model: sk.Model, at: sk.Array, knots: Sequence[int]) -> sk.Array:
    """(len(knots), 15, data) Return the slopes of each parameter, in units of the errors of the data."""
    given = numbers()
    centre, found = {name: value for name, (value, _, _) in given.items()}, []
    for name, (value, h, _) in given.items():
        down, up = (seen(model, centre | {name: value + sign * h}) for sign in (-1, 1))
        found.append([(lines(up, at, k) - lines(down, at, k)) / (2 * h) / np.array(ERRORS)[:, None] for k in knots])
    return np.array(found).swapaxes(0, 1).reshape(len(knots), len(given), -1)


def bounds(first: sk.Array, second: sk.Array) -> str:
    """Say the bounds of the halo's parameters, by the slopes (15, data) of one set or of two."""
    given = numbers()
    information = 0.5 * (first @ second.T + second @ first.T)
    information[np.diag_indices(len(given))] += [sd**-2 for _, _, sd in given.values()]
    scale = np.sqrt(np.abs(np.diag(information)))
    variance = np.diag(np.linalg.inv(information / np.outer(scale, scale))) / scale**2
    halo = variance[[list(given).index(name) for name in HALO]]
    return "".join(f"{np.sqrt(each):10.3f}" if each > 0 else "      none" for each in halo)


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--particles", type=int, nargs="+", default=[400, 20000])
    options.add_argument("--knots", type=int, nargs="+", default=[25, 8])
    options.add_argument("--sigma", type=float, nargs="+", default=[0.0, 0.3], help="km/s")
    options.add_argument("--seeds", type=int, default=4)
    given = options.parse_args()
    centre = {name: value for name, (value, _, _) in numbers().items()}
    print("particles  sigma, km/s  knots   V_h, km/s  R_h, kpc  q_x       q_z")
    for particles, sigma in ((n, s) for s in given.sigma for n in given.particles):
        models = [model(particles, sigma, seed) for seed in range(1, 1 + (given.seeds if sigma else 1))]
        first, last = np.percentile(seen(models[0], centre)[0], [1, 99])
        found = [slopes(each, np.arange(first, last, APART), given.knots) for each in models]
        for knots, sets in zip(given.knots, zip(*found, strict=True), strict=True):
            row = f"{particles:9d} {sigma:12.1f} {knots:6d} "
            print(f"{row}{bounds(sets[0], sets[0])}  one set", flush=True)
            if len(sets) > 1:
                halves = [np.mean(sets[i::2], axis=0) for i in range(2)]
                print(f"{row}{bounds(*halves)}  two halves", flush=True)


if __name__ == "__main__":
    main()
