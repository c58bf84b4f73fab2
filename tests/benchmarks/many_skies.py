"""Do the intervals of a fit of twelve streams hold the masses of a Milky Way of another family?

    python tests/benchmarks/many_skies.py fit -o DIR --skies 40 --hosts nfw freer  # a minute a sky and host
    python tests/benchmarks/many_skies.py table -o DIR
    python tests/benchmarks/many_skies.py real -o DIR --run thirty_streams.toml --fits live mlcs

A sky has the twelve streams of examples/many_streams, at the longitudes and with the errors of their tables, in a host
that no fit has: its halo is triaxial and tilted, or contracted, or cored, or ends early, its disc is exponential, and
the Large Magellanic Cloud has another profile. The progenitors are live, or strip as those of the fit (`--truth mlcs`).
Each fit has the host of the run file, or one whose halo is of no family, and no extra errors. `--disc exponential_disc`
gives it a disc of that kind, with the mass of the run file's, in place of the one of Miyamoto and Nagai.

Posteriors are Gaussians by regressions (tests/support/gaussian_fit.py), in place of samples: a certified fit takes an
hour, this one a minute. The progenitors begin at their true places. With `sample` in place of `fit` the posterior is
sampled by `emulator`, to compare. `real` fits the tables of a run file of examples/many_streams as they are, with its
extra errors, and `run` does so by the run file's sampler, in the directories HOST-FITS of DIR, or goes on there.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

import streamkit as sk
from streamkit.stream import Array

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
import gaussian_fit
from gaussian_fit import coverage, quantiles

FOLDER = Path(__file__).parents[2] / "examples" / "many_streams"
RUN = FOLDER / "many_streams.toml"
FAMILIES = "tilted", "contracted", "cored", "short"
EXTRA = "phi2_extra_error", "pm_phi1_cosphi2_extra_error", "pm_phi2_extra_error", "extra_error_length"
STRIPPINGS = "live", "mlcs"
LIVE = {"kind": "restricted_nbody"}
MIYAMOTO_NAGAI, EXPONENTIAL = DISCS = "miyamoto_nagai", "exponential_disc"
EXPONENTIAL_DISC = {"kind": EXPONENTIAL, "rd": {"uniform": [2.0, 3.2]}, "height": 0.3}
FREE = "free"
CLUSTERS = {"radius": {"log_uniform": ["8 pc", "30 pc"]}, "mass": {"log_uniform": ["1e4 Msun", "1e5 Msun"]}}
KINDS = "host", "disc", "fitted", "stripped", "by"
RADII = 10.0, 20.0, 50.0
MASSES = "M10", "M20", "M50"
CLOUD_RADIUS = 30.0  # kpc, inside which the cloud is weighed
LOST = 0.5  # a datum whose noise in the true stream exceeds this part of its error is left out: no debris is near it
TRUE = 20_000  # particles of a true stream
NONPARAMETRIC = {
    "kind": "nonparametric",
    "r": [2.0, 6.0, 15.0, 40.0, 120.0],
    "slope": {"truncated_normal": [-1.22, 0.4, -2, 0]},
    "bend": [{"normal": [-0.324, 0.31]}, {"normal": [-0.422, 0.29]}, {"normal": [-0.461, 0.30]},
             {"normal": [-0.336, 0.31]}],
    "mass_inside": {"log_uniform": [0.3e11, 4e11]},
    "q": [{"uniform": [0.6, 1.4]}, {"uniform": [0.6, 1.4]}],
    "r_q": [10.0, 40.0],
}  # fmt: skip


def fits_of(
    streams: Sequence[str], particles: int, disc: str = MIYAMOTO_NAGAI, run: Path = RUN
) -> dict[tuple[str, str], dict[str, Any]]:
    """Return the run files of the fits by host and stripping."""
    document = tomllib.loads(run.read_text())
    shared = document["stream_defaults"]
    if disc == EXPONENTIAL:
        document["potential"]["disc"] = EXPONENTIAL_DISC | {"mass": document["potential"]["disc"]["mass"]}
    document["stream"] = {name: document["stream"][name] for name in streams or document["stream"]}
    freer = document["potential"] | {"halo": NONPARAMETRIC}
    found = {}
    for stripping in STRIPPINGS:
        given = document | {
            "stream_defaults": shared | {"stripping": stripped(shared, stripping, particles)},
            "stream": {name: stripped_by(one, stripping) for name, one in document["stream"].items()},
        }
        found["nfw", stripping], found["freer", stripping] = given, given | {"potential": freer}
    return found


def exact(document: dict[str, Any]) -> dict[str, Any]:
    """Return a run file without extra errors: those of mock data are known."""
    shared = document["stream_defaults"]
    observable = {key: value for key, value in shared["observable"].items() if key not in EXTRA}
    return document | {"stream_defaults": shared | {"observable": observable}}


def stripped(shared: dict[str, Any], stripping: str, particles: int) -> dict[str, Any]:
    """Return the stripping of all streams."""
    return (LIVE if stripping == "live" else shared["stripping"]) | {"particles": particles}


def stripped_by(section: dict[str, Any], stripping: str) -> dict[str, Any]:
    """Return the section of a stream: what it has of its own for mLCS is not for live progenitors."""
    return {key: value for key, value in section.items() if key != "stripping" or stripping == "mlcs"}


def with_radius(document: dict[str, Any], radius: str) -> dict[str, Any]:
    """Return a run file whose clusters have that radius, or mass and radius with priors if it is `FREE`."""
    shared = document["stream_defaults"]
    given = CLUSTERS if radius == FREE else {"radius": radius}
    return document | {"stream_defaults": shared | {"progenitor": shared["progenitor"] | given}}


def potential(fields: dict[str, Any]) -> sk.Potential:
    """Return one potential of a run file."""
    place = {"x": 9, "y": 0, "z": 0, "vx": 0, "vy": 200, "vz": 0, "lookback": 1}
    progenitor = {"kind": "plummer", "mass": 1, "radius": 1} | place
    return sk.load({"potential": fields, "progenitor": progenitor, "stripping": {"kind": "mlcs"}}).host()["potential"]


def true_host(rng: np.random.Generator, family: str) -> dict[str, Any]:
    """Return the potential and the body of a host: a halo of 1.0 to 1.45 x 10^11 Msun inside 20 kpc, and the cloud."""
    a, p, q, gamma, inside = rng.uniform(size=5).tolist()
    halo: dict[str, Any] = {
        "tilted": {"kind": "nfw_ellipsoidal", "rs": 12 + 10 * a, "p": 0.75 + 0.25 * p, "q": 0.7 + 0.3 * q,
                   "orientation": rng.uniform(0, 180, 3).tolist()},
        "contracted": {"kind": "spheroid", "a": 14 + 10 * a, "gamma": 1.1 + 0.4 * gamma},
        "cored": {"kind": "spheroid", "a": 8 + 6 * a, "gamma": 0.5 * gamma},
        "short": {"kind": "spheroid", "a": 25 + 15 * a, "beta": 4.5, "gamma": 0.8 + 0.4 * gamma},
    }[family]  # fmt: skip
    of_one = sk.Host({"halo": potential(halo | {"mass": 1e11})}).mass_inside(20)
    halo["mass"] = 1e11 * (1e11 + 0.45e11 * inside) / float(of_one)
    disc, rd, cloud = rng.uniform(size=3).tolist()
    lmc = {"kind": "nfw_truncated", "mass": 5e10 * 4**cloud}

    def too_fast(rs: float) -> float:
        alone = sk.Host({"cloud": potential(lmc | {"rs": rs, "rt": 4 * rs})})
        return float(alone.circular_velocity(8.7)) - 91.7

    rs = float(brentq(too_fast, 0.5, 80.0, xtol=1e-3))
    today = tomllib.loads(RUN.read_text())["body"]["lmc"]
    place = {key: value for key, value in today.items() if key not in ("kind", "mass")}
    return {
        "potential": {
            "bulge": {"kind": "power_cutoff", "mass": 5e9, "alpha": 1.8, "rc": 1.9},
            "disc": {"kind": "exponential_disc", "mass": 4e10 + 2e10 * disc, "rd": 2.2 + 0.8 * rd, "height": 0.3},
            "halo": halo,
        },
        "body": {"lmc": place | lmc | {"rs": rs, "rt": 4 * rs}},
    }


def numbers_of(spec: sk.Spec, theta: Array | None = None) -> dict[str, float]:
    """Return what a host is compared by: masses in Msun, v_c at 8 kpc in km/s, q at 20 kpc, the cloud's mass."""
    bound = spec.bind_all(theta)
    host, cloud = sk.Host(bound.potentials), sk.Host({"lmc": bound.bodies["lmc"].potential})
    found = {f"M{r:g}": float(m) for r, m in zip(RADII, host.mass_inside(RADII), strict=True)}
    height = 20.0 / np.sqrt(2)
    found["q"] = float(host.flattening(height, height))
    found["v_c"] = float(host.circular_velocity(8))
    return found | {"cloud": float(cloud.mass_inside(CLOUD_RADIUS))}


@dataclass(frozen=True)
class Sky:
    """The mock tables of all streams by name, the true numbers, and the quantiles of the progenitors' numbers."""

    family: str
    tables: dict[str, dict[str, Any]]
    truth: dict[str, float]
    places: dict[str, float]


def sky(index: int, document: dict[str, Any], stripping: str) -> Sky:
    """Return a mock sky: progenitors within a quarter of their priors about the middle, errors as in the tables.

    A stream that cannot be measured at seven tenths of its longitudes gets another place.
    """
    rng = np.random.default_rng([40, index])
    family = FAMILIES[index % len(FAMILIES)]
    host, fit = true_host(rng, family), sk.Model(document)
    measured = {one.stream: one for one in fit.measured(fit.spec.bind_all())}
    priors = dict(zip(fit.spec.names, fit.spec.priors, strict=True))
    own = {name: prior for name, prior in priors.items() if name.startswith("stream.")}
    shared = document["stream_defaults"]
    places, tables = dict[str, float](), dict[str, dict[str, Any]]()
    for _ in range(20):
        left = {name: section for name, section in document["stream"].items() if name not in tables}
        drawn = {key: float(rng.uniform(0.375, 0.625)) for key in own if key.split(".")[1] in left}
        streams = {name: stripped_by(section, stripping) for name, section in left.items()}
        for key, u in drawn.items():
            _, name, _, field = key.split(".")
            at = {field: float(own[key].ppf(np.array([u]))[0])}
            streams[name] = streams[name] | {"progenitor": streams[name]["progenitor"] | at}
        model = sk.Model({"version": 1, "seed": 1000 + index, "sun": document["sun"], **host, "stream": streams,
                          "stream_defaults": shared | {"stripping": stripped(shared, stripping, TRUE)}})  # fmt: skip
        bound = model.spec.bind_all()
        for name in left:
            try:
                prediction = model.observe(bound.streams[name])[1]
            except sk.OutOfDomain:
                continue
            if prediction is None or prediction.why_not:
                continue
            error = np.asarray(measured[name].measurement.scatter(prediction))
            wanted = np.isfinite(measured[name].data.values)
            seen = wanted & (prediction.variance < (LOST * error) ** 2)
            if seen.sum() > 0.7 * wanted.sum():
                seen_mean = np.where(seen, prediction.mean, np.nan)
                tables[name] = measured[name].measurement.mock(replace(prediction, mean=seen_mean), rng)
                places |= {key: u for key, u in drawn.items() if key.split(".")[1] == name}
        truth = numbers_of(model.spec)
        if len(tables) == len(document["stream"]):
            return Sky(family, tables, truth, places)
    raise SystemExit(f"sky {index}: no place for {', '.join(left)}")


def with_data(document: dict[str, Any], mock: Sky) -> dict[str, Any]:
    """Return the run file of a fit of mock data."""
    streams = dict[str, Any]()
    for name, section in document["stream"].items():
        given = mock.tables[name]
        columns = section.get("observable", {}) | {key: value for key, value in given.items() if key != "table"}
        streams[name] = section | {"observable": columns} | ({"table": given["table"]} if "table" in given else {})
    return document | {"stream": streams}


def fit(document: dict[str, Any], mock: Sky, seed: int) -> dict[str, Any]:
    """Return the Gaussian's quantiles of what hosts are compared by, and what it took."""
    model = sk.Model(with_data(document, mock))
    return gaussian_fit.fit(model, mock.places, seed, lambda theta: numbers_of(model.spec, theta))


def real(document: dict[str, Any], seed: int) -> dict[str, Any]:
    """Return the same of the run file's own data. Progenitors begin in the middle of their priors."""
    model = sk.Model(document)
    return gaussian_fit.fit(model, {}, seed, lambda theta: numbers_of(model.spec, theta))


def sample(document: dict[str, Any], mock: Sky, seed: int) -> dict[str, Any]:
    """Return the same of a fit by the sampler `emulator`, and what its certificate lacks."""
    begin, sampler = time.process_time(), {"kind": "emulator", "max_calls": 1500}
    results = sk.run(with_data(document, mock) | {"seed": seed, "sampler": sampler}, progress=False)
    found = quantiles([numbers_of(results.spec, theta) for theta in results.some(400)])
    lacks, spent = str(results.draws.lacks or ""), round(time.process_time() - begin)
    return {**found, "settled": not lacks, "lacks": lacks, "calls": results.calls, "cpu": spent}


def table(file: Path) -> str:
    """Return by fit and family how many intervals hold the truth, and the shifts in standard deviations."""
    if not file.exists():
        raise SystemExit(f"{file.parent} has no fits yet")
    rows = rows_of(file)
    lines = [shown(row) for row in rows if "truth" not in row]
    rows = [row for row in rows if "truth" in row]
    for kind in sorted({tuple(row[key] for key in KINDS) for row in rows}):
        of = [row for row in rows if tuple(row[key] for key in KINDS) == kind]
        for family in ("all", *FAMILIES):
            ours = [row for row in of if family in ("all", row["family"])]
            if ours:
                settled = sum(row["settled"] for row in ours)
                lines += [f"{', '.join(kind)}, {family}: {len(ours)} skies, {settled} settled", *coverage(ours)]
    return "\n".join(lines)


def rows_of(file: Path) -> list[dict[str, Any]]:
    """Return the results of a file, if it exists."""
    lines = file.read_text().splitlines() if file.exists() else []
    return [{"disc": MIYAMOTO_NAGAI} | json.loads(line) for line in lines]  # the first results do not name it


def write(file: Path, line: dict[str, Any]) -> None:
    """Add the result of a fit to the file, and print it."""
    with file.open("a") as output:
        output.write(json.dumps(line) + "\n")
    print(line, flush=True)


def shown(row: dict[str, Any]) -> str:
    """Return the medians and 68 % intervals of a fit of real data, masses in 1e11 Msun."""
    numbers = {key: np.array(row[key]) / (1e11 if max(row[key]) > 1e6 else 1) for key in (*MASSES, "q", "v_c", "cloud")}
    found = [f"{key} {x[2]:.4g} ({x[1]:.4g}-{x[3]:.4g})" for key, x in numbers.items()]
    return ", ".join([row["sky"], *(row[key] for key in KINDS), *found])


def main() -> None:
    """Fit skies that have no result yet, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["fit", "sample", "real", "run", "table"])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--skies", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--hosts", nargs="+", choices=["nfw", "freer"], default=["nfw", "freer"])
    parser.add_argument("--disc", choices=DISCS, default=MIYAMOTO_NAGAI, help="disc of the fits' hosts")
    parser.add_argument("--fits", nargs="+", choices=STRIPPINGS, default=["live"], help="how progenitors are stripped")
    parser.add_argument("--truth", choices=STRIPPINGS, default="live", help="the same of the true ones")
    parser.add_argument("--streams", nargs="+", default=[], help="some of the twelve streams")
    parser.add_argument("--run", default=RUN.name, help="run file of `real` and `run`, in examples/many_streams")
    parser.add_argument("--radius", help="of the clusters, or free; the results of each need a DIR")
    parser.add_argument("--workers", type=int, default=2, help="of `run`")
    parser.add_argument("--particles", type=int, default=2048)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    file = given.output.absolute() / "fits.jsonl"
    os.chdir(FOLDER)  # the run file names its tables from there
    if given.what == "table":
        print(table(file))
        return
    finished = {(row["sky"], *(row[key] for key in KINDS)) for row in rows_of(file)}
    run = FOLDER / (given.run if given.what in ("real", "run") else RUN)
    documents = fits_of(given.streams, given.particles, given.disc, run)
    if given.radius:
        documents = {key: with_radius(document, given.radius) for key, document in documents.items()}
    if given.what in ("fit", "sample"):
        documents = {key: exact(document) for key, document in documents.items()}
    truth = "" if given.what == "real" else given.truth
    kinds = {
        (host, given.disc, fitted, truth, given.what): documents[host, fitted]
        for host in given.hosts
        for fitted in given.fits
    }
    if given.what == "run":
        for (host, _, fitted, *_), document in kinds.items():
            out = file.parent / f"{host}-{fitted}"
            results = sk.run(document, out=out, workers=given.workers, resume=out.exists())
            print(f"{out}: {results.draws.lacks or 'certified'}")
        return
    if given.what == "real":
        for kind in kinds:
            if (given.run, *kind) not in finished:
                print(f"{given.run}, {', '.join(kind)}", flush=True)
                write(file, {"sky": given.run, **dict(zip(KINDS, kind, strict=True)), **real(kinds[kind], 1)})
        return
    for index in range(given.first, given.first + given.skies):
        wanted = [kind for kind in kinds if (index, *kind) not in finished]
        if not wanted:
            continue
        mock = sky(index, documents["nfw", given.truth], given.truth)
        for kind in wanted:
            print(f"sky {index}, {mock.family}, {', '.join(kind)}", flush=True)
            line = {"sky": index, **dict(zip(KINDS, kind, strict=True)), "family": mock.family, "truth": mock.truth}
            line |= (fit if given.what == "fit" else sample)(kinds[kind], mock, index)
            write(file, line)


if __name__ == "__main__":
    main()
