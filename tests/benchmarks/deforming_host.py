"""What rigid hosts make of streams in a Milky Way that deforms, and what a free amplitude of the deformation does.

    python tests/benchmarks/deforming_host.py simulate -o DIR          # half an hour: a live halo, a live Cloud
    python tests/benchmarks/deforming_host.py fit -o DIR --skies 20    # minutes a sky: rigid, and with the response
    python tests/benchmarks/deforming_host.py table -o DIR

`simulate` follows a halo of 100 000 particles and a satellite like the Large Magellanic Cloud by the tree of
streamkit-nbody, and expands both by streamkit-hosts: `response.ecsv` is the halo's dipole and quadrupole. Each sky has
two streams on orbits drawn anew, made in that host, with errors of 0.2 deg, 5 % in distance, 0.1 mas/yr and 5 km/s at
eight longitudes. Fitted are a flattened NFW halo, the satellite's mass and four numbers of each progenitor. The fits
(`--hosts`) are without and with the amplitude of the response, each with the satellite's path integrated from today, or
the true one ("path"). Posteriors are Gaussians by regressions (tests/support/gaussian_fit.py), which begin at the true
progenitors; `sample` in place of `fit` samples by `emulator`, in five minutes a sky and host. The table has the errors
of the masses, the shape and the satellite's mass, and how many intervals hold the truth.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import astropy.coordinates as coord
import astropy.units as u
import h5py
import numpy as np
from astropy.table import QTable
from streamkit_hosts.series import densest, expand
from streamkit_hosts.snapshot import read
from streamkit_nbody.gravity import Gravity
from streamkit_nbody.snapshot import UNITS

import streamkit as sk
from streamkit import GYR, Array
from streamkit.model import Equilibrium
from streamkit.report import save_table

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
import gaussian_fit
from gaussian_fit import coverage, quantiles

LMC = Path(__file__).parents[2] / "examples" / "lmc" / "truth_lmc.toml"  # where it is today, and the Sun
HALO = {"kind": "nfw_truncated", "mass": 1.15e12, "rs": 15.0, "rt": 200.0}
CLOUD = {"kind": "hernquist", "mass": 1.6e11, "a": 14.0}
SPAN, STEP, EVERY = 2.4, 0.004, 15  # Gyr, Gyr, steps between snapshots
SOFTENING, OPENING = 0.7, 0.8  # kpc, and of the tree
INSIDE = 30.0  # kpc: the satellite's mass is compared inside
LOOKBACK = 2.0  # Gyr
CLUSTER = {"kind": "plummer", "mass": 3e5, "radius": 0.02, "lookback": LOOKBACK}
ERRORS = {
    "phi2": "0.2 deg",
    "distance": 0.05,
    "pm_phi1_cosphi2": "0.1 mas/yr",
    "pm_phi2": "0.1 mas/yr",
    "radial_velocity": "5 km/s",
}  # fmt: skip  of the distance a fraction
POINTS, REACH = 8, 45.0  # longitudes with data, within so many degrees of the progenitor
SHORTEST, TRIES = 25.0, 100  # degrees of a stream, and orbits that are tried for one
RADII = (20.0, 50.0)
HOSTS = ("rigid", "response", "rigid, path", "response, path")


def simulate(out: Path, particles: int) -> None:
    """Write snapshots from `SPAN` ago until today, in which the Cloud begins where its orbit in rigid hosts was."""
    document = sk.load(LMC).document
    document |= {"potential": HALO, "body": {"lmc": {**document["body"]["lmc"], **CLOUD}}}
    orbit = sk.Host.at(document).paths(-SPAN * GYR).bodies["lmc"]
    first = np.argmin(orbit.t)
    rng = np.random.default_rng(7)
    count = round(particles * CLOUD["mass"] / HALO["mass"])
    q, v = np.zeros((3, 0)), np.zeros((3, 0))
    for sphere, n, at in ((HALO, particles, np.zeros((2, 3))), (CLOUD, count, (orbit.q[:, first], orbit.v[:, first]))):
        (potential,) = sk.Host.at({**document, "potential": sphere, "body": {}}).potentials.values()
        drawn = Equilibrium(potential).sample(rng.uniform(size=(6, n)))
        centred = [a - a.mean(axis=1, keepdims=True) + place[:, None] for a, place in zip(drawn, at, strict=True)]
        q, v = np.hstack([q, centred[0]]), np.hstack([v, centred[1]])
    v -= v.mean(axis=1, keepdims=True)
    gravity, h = Gravity(HALO["mass"] / particles, SOFTENING, OPENING), STEP * GYR
    a = gravity.forces(q)
    for step in range(round(SPAN / STEP) + 1):
        if step:
            v += 0.5 * h * a
            q += h * v
            a = gravity.forces(q)
            v += 0.5 * h * a
        if step % EVERY == 0:
            write(out / f"snapshot_{step // EVERY:03d}.hdf5", step * h, gravity.mass, (q, v), particles)
            print(f"{step * STEP:.2f} Gyr of {SPAN}", flush=True)


def write(path: Path, now: float, mass: float, state: tuple[Array, Array], particles: int) -> None:
    """Write the halo as PartType1 and the Cloud as PartType2."""
    with h5py.File(path, "w") as file:
        file.create_group("Header").attrs.update(UNITS | {"Time": now, "MassTable": [0.0, mass, mass]})
        for kind, part in (("PartType1", slice(0, particles)), ("PartType2", slice(particles, None))):
            for name, values in zip(("Coordinates", "Velocities"), state, strict=True):
                file[f"{kind}/{name}"] = values[:, part].T.astype(np.float32)


def core(path: Path, kind: int, size: float) -> tuple[float, Array, Array]:
    """Return the time in Gyr, the densest place (3,) of one galaxy, and the mean velocity (3,) about it."""
    particles = read(path, [kind])
    centre = densest(particles)
    near = ((particles.q - centre[:, None]) ** 2).sum(axis=0) < size**2
    with h5py.File(path) as file:
        return particles.time, centre, file[f"PartType{kind}/Velocities"][near].mean(axis=0)


def host(out: Path) -> None:
    """Write the tables of the host, its response, and `today.json` with the true numbers."""
    files = sorted(out.glob("snapshot_*.hdf5"))
    paths = {}
    for name, kind, size in (("mw", 1, 5.0), ("lmc", 2, 7.0)):
        times, q, v = (np.array(a) for a in zip(*(core(file, kind, size) for file in files), strict=True))
        paths[name] = times - times[-1], q, v
        made = expand(files, types=[kind], l_max=2, radii=15)
        save_table(out / f"{name}.ecsv", made.table)
    _, origin, drift = (a[-1] for a in paths["mw"])
    for name, (t, q, v) in paths.items():
        place, speed = q - origin - np.outer(t * GYR, drift), v - drift
        columns = {"t": t * u.Gyr} | {n: c * u.kpc for n, c in zip("xyz", place.T, strict=True)}
        columns |= {n: c * u.km / u.s for n, c in zip(("vx", "vy", "vz"), speed.T, strict=True)}
        save_table(out / f"{name}_centre.ecsv", QTable(columns))
    response = expand(files[::-2], types=[1], l_max=2, radii=15, response=True)
    print(f"the response's noise is {response.noise:.0%} of it", *response.warnings())
    save_table(out / "response.ecsv", response.table)
    at = dict(zip(("q", "v"), (paths["lmc"][1][-1] - origin, paths["lmc"][2][-1] - drift), strict=True))
    inside = {name: mass_inside(files[-1], kind, (*RADII, INSIDE)) for name, kind in (("mw", 1), ("lmc", 2))}
    truth = {"lmc_q": at["q"].tolist(), "lmc_v": at["v"].tolist(), **inside}
    (out / "today.json").write_text(json.dumps(truth))


def mass_inside(path: Path, kind: int, radii: tuple[float, ...]) -> list[float]:
    """Return the mass in Msun of one galaxy inside radii about its centre."""
    particles = read(path, [kind])
    r = np.sqrt(((particles.q - densest(particles)[:, None]) ** 2).sum(axis=0))
    return [float(particles.mass[r < radius].sum()) for radius in radii]


PLACE = ("ra", "dec", "distance", "pm_ra_cosdec", "pm_dec", "v_los")


def truth_of(out: Path) -> sk.Spec:
    """Return the deforming host, with a cluster of 3e5 Msun whose place today is free."""
    deforming = {
        name: {"kind": "multipole", "table": str(out / f"{name}.ecsv"), "centre": str(out / f"{name}_centre.ecsv"),
               "tolerance": 1e-2} for name in ("mw", "lmc")
    }  # fmt: skip
    ends = ((0, 360), (-90, 90), (1, 100), (-20, 20), (-20, 20), (-600, 600))
    free = {name: {"uniform": list(pair)} for name, pair in zip(PLACE, ends, strict=True)}
    return sk.load({
        "sun": sk.load(LMC).document["sun"], "potential": deforming, "progenitor": CLUSTER | free,
        "stripping": {"kind": "mlcs", "particles": 8000},
    })  # fmt: skip


def place_today(rng: np.random.Generator, sun: dict[str, Any]) -> dict[str, float]:
    """Return a place on an orbit between some 12 and 60 kpc, by what is seen of it."""
    direction, along, _ = np.linalg.qr(rng.standard_normal((3, 3)))[0].T
    q = rng.uniform(18.0, 38.0) * direction
    v = rng.uniform(120.0, 190.0) * along + rng.uniform(-70.0, 70.0) * direction
    radial, round_, peculiar, up = (u.Quantity(sun[name]) for name in ("u", "v_circ", "v", "w"))
    speed = u.Quantity([radial, round_ + peculiar, up])
    galaxy = coord.Galactocentric(galcen_distance=u.Quantity(sun["r0"]), z_sun=u.Quantity(sun["z"]), galcen_v_sun=speed)
    motion = coord.CartesianDifferential(*(v * u.km / u.s))
    seen = coord.CartesianRepresentation(*(q * u.kpc), differentials=motion)
    place = coord.SkyCoord(galaxy.realize_frame(seen)).icrs
    motions = place.pm_ra_cosdec.value, place.pm_dec.value, place.radial_velocity.value
    values = place.ra.deg, place.dec.deg, place.distance.kpc, *motions
    return {name: float(value) for name, value in zip(PLACE, values, strict=True)}


def columns_at(longitudes: Array, distance: float) -> dict[str, Any]:
    """Return tables without values yet: the longitudes and the errors."""
    columns: dict[str, Any] = {}
    for name, error in ERRORS.items():
        size = error * distance if isinstance(error, float) else u.Quantity(error).value
        columns[name] = {"phi1": longitudes.tolist(), name: [1.0] * POINTS, "error": [size] * POINTS}
    return columns


def stream_in(model: sk.Model, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, float]]:
    """Return the sections of a stream as it is fitted, with mock data, and the true quantiles of its progenitor."""
    for _ in range(TRIES):
        place = place_today(rng, model.spec.document["sun"])
        try:
            stream = model.stream({f"progenitor.{name}": value for name, value in place.items()})
        except sk.OutOfDomain:  # no tidal radius somewhere on the orbit
            continue
        everywhere = stream.seen("icrs")
        centre, stars = (coord.SkyCoord(*a, unit="deg") for a in ((place["ra"], place["dec"]), everywhere[:2]))
        near = stars.separation(centre).deg < REACH
        try:
            frame = sk.sky_frame(stars=stars[near], origin=[place["ra"], place["dec"]])
        except ValueError:  # no great circle
            continue
        seen = stream.seen(frame)
        ends = np.percentile(seen.lon[near], [5, 95])
        if np.ptp(ends) < SHORTEST or np.abs(seen.lat[near]).max() > 15:
            continue
        tables = columns_at(np.linspace(*ends, POINTS), place["distance"])
        observable = {"kind": "track", "frame": frame.matrix.tolist(), "kernel": "4 deg", **tables}
        free: dict[str, Any] = dict(place)
        true = {}
        for name, width in (
            ("distance", 0.25 * free["distance"]),
            ("pm_ra_cosdec", 0.5),
            ("pm_dec", 0.5),
            ("v_los", 40),
        ):
            shift = rng.uniform(-0.4, 0.4)  # the truth is not in the middle of its prior
            middle, true[f"progenitor.{name}"] = free[name] + width * shift, 0.5 - 0.5 * shift
            free[name] = {"uniform": [middle - width, middle + width]}
        document = {"progenitor": CLUSTER | free, "stripping": {"kind": "mlcs", "particles": 4000}}
        measured = sk.load({"potential": HALO, **document, "observable": observable}).bind().observable
        prediction = measured.predict(stream)
        if not prediction.why_not:
            return {**document, "observable": observable | measured.mock(prediction, rng)}, true
    raise SystemExit(f"none of {TRIES} orbits has a stream that can be measured")


def sky(out: Path, model: sk.Model, index: int) -> tuple[dict[str, sk.Spec], dict[str, float]]:
    """Return the fits of a mock sky by their hosts, and the true quantiles of the progenitors."""
    today = json.loads((out / "today.json").read_text())
    rng = np.random.default_rng([11, index])
    drawn = {name: stream_in(model, rng) for name in "ab"}
    streams = {name: sections for name, (sections, _) in drawn.items()}
    true = {f"stream.{name}.{key}": x for name, (_, places) in drawn.items() for key, x in places.items()}
    halo: dict[str, Any] = {"kind": "nfw_triaxial", "mass": {"log_uniform": [2e11, 2e12]},
                            "rs": {"log_uniform": [5, 40]}, "q": {"uniform": [0.7, 1.3]}}  # fmt: skip
    response = {"kind": "response", "table": str(out / "response.ecsv"), "amplitude": {"uniform": [-1, 3]},
                "tolerance": 5e-2}  # fmt: skip
    cloud = {"kind": "hernquist", "mass": {"log_uniform": [3e10, 5e11]}, "a": CLOUD["a"]}
    place = dict(zip(("x", "y", "z", "vx", "vy", "vz"), today["lmc_q"] + today["lmc_v"], strict=True))
    rest = {"sun": model.spec.document["sun"], "stream": streams, "seed": index}
    rest |= {"sampler": {"kind": "emulator", "max_calls": 800}}
    mw, lmc = ({"centre": str(out / f"{name}_centre.ecsv")} for name in ("mw", "lmc"))
    integrated, given = rest | {"body": {"lmc": cloud | place}}, {"cloud": cloud | lmc}
    specs = {
        name: sk.load(document)
        for name, document in {
            "rigid": integrated | {"potential": {"halo": halo}},
            "response": integrated | {"potential": {"halo": halo, "response": response}},
            "rigid, path": rest | {"potential": {"halo": halo | mw, **given}},
            "response, path": rest | {"potential": {"halo": halo | mw, "response": response | mw, **given}},
        }.items()
    }
    return specs, true


def fit(out: Path, indices: range, wanted: Sequence[str], by: str) -> None:
    """Fit the skies that have no result, and write a line for each fit."""
    file = out / "fits.jsonl"
    done = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    finished = {(row["sky"], row["host"], row["by"]) for row in done}
    model = sk.Model(truth_of(out))
    today = json.loads((out / "today.json").read_text())
    truth = {"M20": today["mw"][0], "M50": today["mw"][1], "q": 1.0, "cloud": today["lmc"][2], "amplitude": 1.0}
    for index in indices:
        names = [name for name in wanted if (index, name, by) not in finished]
        if not names:
            continue
        specs, places = sky(out, model, index)
        for name in names:
            line = {"sky": index, "host": name, "by": by, "truth": truth}
            line |= gaussian(specs[name], places, index) if by == "fit" else sampled(specs[name])
            with file.open("a") as output:
                output.write(json.dumps(line) + "\n")
            print(line, flush=True)


def gaussian(spec: sk.Spec, places: dict[str, float], seed: int) -> dict[str, Any]:
    """Return the quantiles of what is compared, and what a Gaussian took."""
    return gaussian_fit.fit(sk.Model(spec), places, seed, lambda theta: numbers_of(spec, theta))


def sampled(spec: sk.Spec) -> dict[str, Any]:
    """Return the same of a fit by the sampler `emulator`, and what its certificate lacks."""
    begin, results = time.process_time(), sk.run(spec, progress=False)
    found = quantiles([numbers_of(spec, theta) for theta in results.some(400)])
    lacks, spent = str(results.draws.lacks or ""), round(time.process_time() - begin)
    return {**found, "settled": not lacks, "lacks": lacks, "calls": results.calls, "cpu": spent}


def numbers_of(spec: sk.Spec, theta: Array) -> dict[str, float]:
    """Return what is compared of parameters (d,)."""
    host = sk.Host({name: part for name, part in spec.host(theta).items() if name != "cloud"})
    found = {f"M{r:g}": float(m) for r, m in zip(RADII, host.mass_inside(RADII), strict=True)}
    height = 20.0 / np.sqrt(2)
    found["q"] = float(host.flattening(height, height))
    of = dict(zip(spec.names, theta, strict=True))
    mass = of["body.lmc.mass" if "body.lmc.mass" in of else "potential.cloud.mass"]
    found["cloud"] = float(mass) * (INSIDE / (INSIDE + CLOUD["a"])) ** 2
    if "potential.response.amplitude" in of:
        found["amplitude"] = float(of["potential.response.amplitude"])
    return found


def table(out: Path) -> str:
    """Return the errors by host, and how many intervals hold the truth."""
    rows = [json.loads(line) for line in (out / "fits.jsonl").read_text().splitlines()]
    lines = []
    for name, by in sorted({(row["host"], row["by"]) for row in rows}):
        ours = [row for row in rows if (row["host"], row["by"]) == (name, by)]
        settled = sum(row["settled"] for row in ours)
        lines += [f"{name}, {by}: {len(ours)} skies, {settled} settled", *coverage(ours)]
    return "\n".join(lines)


def main() -> None:
    """Do one of the three."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["simulate", "host", "fit", "sample", "table"])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--particles", type=int, default=100_000)
    parser.add_argument("--skies", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--hosts", nargs="+", choices=HOSTS, default=HOSTS)
    given = parser.parse_args()
    out = given.output.absolute()
    out.mkdir(parents=True, exist_ok=True)
    if given.what == "simulate":
        simulate(out, given.particles)
    if given.what in ("simulate", "host"):
        host(out)
    if given.what in ("fit", "sample"):
        fit(out, range(given.first, given.first + given.skies), given.hosts, given.what)
    if given.what == "table":
        print(table(out))


if __name__ == "__main__":
    main()
