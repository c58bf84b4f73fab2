"""What rigid hosts make of streams in a Milky Way that deforms, and what a free amplitude of the deformation does.

    python tests/benchmarks/deforming_host.py simulate -o DIR          # half an hour: a live halo, a live Cloud
    python tests/benchmarks/deforming_host.py fit -o DIR --skies 12    # minutes a sky: rigid, and with the response
    python tests/benchmarks/deforming_host.py table -o DIR

`simulate` follows a halo of 100 000 particles and a satellite like the Large Magellanic Cloud by the tree of
streamkit-nbody, and expands both by streamkit-hosts: `response.ecsv` is the halo's dipole and quadrupole. Each sky has
two streams on orbits drawn anew, made in that host, with errors of 0.2 deg, 5 % in distance, 0.1 mas/yr and 5 km/s at
eight longitudes. Fitted are a flattened NFW halo, the satellite's mass and four numbers of each progenitor, by the
sampler `emulator`, in four hosts (`--hosts`): without and with the amplitude of the response, each with the path of the
satellite integrated from today, or the true one ("path"). The table has the shift of the masses, the shape and the
satellite's mass in standard deviations of each fit.
"""

from __future__ import annotations

import argparse
import json
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


def stream_in(model: sk.Model, rng: np.random.Generator) -> dict[str, Any]:
    """Return the sections of a stream as it is fitted, with mock data wherever it has stars."""
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
        for name, width in (
            ("distance", 0.25 * free["distance"]),
            ("pm_ra_cosdec", 0.5),
            ("pm_dec", 0.5),
            ("v_los", 40),
        ):
            middle = free[name] + width * rng.uniform(-0.4, 0.4)  # the truth is not in the middle of its prior
            free[name] = {"uniform": [middle - width, middle + width]}
        document = {"progenitor": CLUSTER | free, "stripping": {"kind": "mlcs", "particles": 4000}}
        measured = sk.load({"potential": HALO, **document, "observable": observable}).bind().observable
        prediction = measured.predict(stream)
        if not prediction.why_not:
            return {**document, "observable": observable | measured.mock(prediction, rng)}
    raise SystemExit(f"none of {TRIES} orbits has a stream that can be measured")


def sky(out: Path, model: sk.Model, index: int) -> dict[str, sk.Spec]:
    """Return the fits of a mock sky: of rigid hosts and with the response, with a path of the Cloud or integrated."""
    today = json.loads((out / "today.json").read_text())
    rng = np.random.default_rng([11, index])
    streams = {name: stream_in(model, rng) for name in "ab"}
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
    return {
        name: sk.load(document)
        for name, document in {
            "rigid": integrated | {"potential": {"halo": halo}},
            "response": integrated | {"potential": {"halo": halo, "response": response}},
            "rigid, path": rest | {"potential": {"halo": halo | mw, **given}},
            "response, path": rest | {"potential": {"halo": halo | mw, "response": response | mw, **given}},
        }.items()
    }


def fit(out: Path, indices: range, wanted: Sequence[str]) -> None:
    """Fit the skies that have no result, and write a line for each fit."""
    file = out / "fits.jsonl"
    done = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    finished = {(row["sky"], row["host"]) for row in done}
    model = sk.Model(truth_of(out))
    for index in [i for i in indices if not {(i, name) for name in HOSTS} <= finished]:
        for name, spec in sky(out, model, index).items():
            if (index, name) in finished or name not in wanted:
                continue
            begin = time.process_time()
            results = sk.run(spec, progress=False)
            line = {"sky": index, "host": name, **summary(results), "cpu": round(time.process_time() - begin)}
            with file.open("a") as output:
                output.write(json.dumps(line) + "\n")
            print(line, flush=True)


def summary(results: sk.Results) -> dict[str, Any]:
    """Return the quantiles of what is compared, the calls, and what the sampler lacks for its certificate."""
    parts = [results.spec.host(theta) for theta in results.some(1000)]
    hosts = [sk.Host({name: part for name, part in each.items() if name != "cloud"}) for each in parts]
    height = np.array([20.0 / np.sqrt(2)])
    masses = np.array([one.mass_inside(np.array(RADII)) for one in hosts])
    numbers = {f"M{r:g}": m for r, m in zip(RADII, masses.T, strict=True)}
    numbers["q"] = np.array([one.flattening(height, height)[0] for one in hosts])
    columns = dict(zip(results.spec.names, results.samples.T, strict=True))
    of_cloud = columns["body.lmc.mass" if "body.lmc.mass" in columns else "potential.cloud.mass"]
    numbers["cloud"] = of_cloud * (INSIDE / (INSIDE + CLOUD["a"])) ** 2
    if "potential.response.amplitude" in columns:
        numbers["amplitude"] = columns["potential.response.amplitude"]
    quantiles = {name: np.quantile(x, [0.025, 0.16, 0.5, 0.84, 0.975]).tolist() for name, x in numbers.items()}
    return {**quantiles, "calls": results.calls, "lacks": str(results.draws.lacks or "")}


def table(out: Path) -> str:
    """Return the shifts, in standard deviations of each fit, and how many 68 % intervals hold the truth."""
    today = json.loads((out / "today.json").read_text())
    true = {"M20": today["mw"][0], "M50": today["mw"][1], "q": 1.0, "cloud": today["lmc"][2], "amplitude": 1.0}
    rows = [json.loads(line) for line in (out / "fits.jsonl").read_text().splitlines()]
    lines = []
    for name in HOSTS:
        ours = [row for row in rows if row["host"] == name]
        lines.append(f"{name}: {sum(not row['lacks'] for row in ours)} of {len(ours)} certified")
        for number, value in true.items():
            found = np.array([row[number] for row in ours if number in row])
            if not len(found):
                continue
            shift = (found[:, 2] - value) / (0.5 * (found[:, 3] - found[:, 1]))
            held = (found[:, 1] < value) & (value < found[:, 3])
            error = shift.std(ddof=1) / np.sqrt(len(shift)) if len(shift) > 1 else np.nan
            lines.append(
                f"  {number:9s} {np.mean(found[:, 2] / value):.3f} of the truth; {shift.mean():+.2f} +- {error:.2f} "
                f"sd, rms {np.sqrt((shift**2).mean()):.2f}; {held.sum()} of {len(held)} in 68 %"
            )
    return "\n".join(lines)


def main() -> None:
    """Do one of the three."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["simulate", "host", "fit", "table"])
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
    if given.what == "fit":
        fit(out, range(given.first, given.first + given.skies), given.hosts)
    if given.what == "table":
        print(table(out))


if __name__ == "__main__":
    main()
