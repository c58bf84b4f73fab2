"""Do the intervals of a fit of twelve streams hold the masses of a Milky Way of another family?

    python tests/benchmarks/many_skies.py fit -o DIR --skies 40 --hosts nfw freer   # some minutes a sky and host
    python tests/benchmarks/many_skies.py table -o DIR

A sky has the twelve streams of examples/many_streams, at the longitudes and with the errors of their tables, in a host
that no fit has: its halo is triaxial and tilted, or contracted, or cored, or ends early, its disc is exponential, and
the Large Magellanic Cloud has another profile. The progenitors are live, or strip as those of the fit (`--truth mlcs`).
Each fit has the host of the run file, or one whose halo is of no family, and no extra errors.

Posteriors are Gaussians here, in place of samples: a certified fit takes an hour, this one some minutes. Predictions
are linear in the normal quantiles of all priors, by a regression on draws of the last Gaussian. What the lines leave,
with the noise of the particles, is part of the error of each datum. The slopes' own noise would be information: its
mean is taken away. The Gaussian follows from data and priors, until it stays. The progenitors begin at their true
places, so that no other mode is found. `sample` in place of `fit` samples by `emulator`, to compare the Gaussian with.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

import streamkit as sk
from streamkit.model import Host
from streamkit.stream import Array

RUN = Path(__file__).parents[2] / "examples" / "many_streams" / "many_streams.toml"
FAMILIES = "tilted", "contracted", "cored", "short"
EXTRA = "phi2_extra_error", "pm_phi1_cosphi2_extra_error", "pm_phi2_extra_error", "extra_error_length"
RADII = 10.0, 20.0, 50.0
CLOUD_RADIUS = 30.0  # kpc, inside which the cloud is weighed
LOST = 0.5  # a datum whose noise in the true stream exceeds this part of its error is left out: no debris is near it
DRAWS, LAST = 64, 128  # draws of a regression, and of the last ones
ROUNDS, SETTLED = 20, 0.3  # the most regressions; the largest move, in standard deviations, of a Gaussian that stays
WIDER = 2.0  # factor on the standard deviations of the last Gaussian, within which its lines are trusted
LEVELS = 0.025, 0.16, 0.5, 0.84, 0.975
TRUE = 20_000  # particles of a true stream
FIRST = 0.3, 0.05  # standard deviations of the first draws, in normal quantiles: of the host, and of the progenitors
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


def fits_of(streams: Sequence[str], particles: int) -> dict[str, dict[str, Any]]:
    """Return the run files of the fits by the names of their hosts, without extra errors."""
    document = tomllib.loads(RUN.read_text())
    shared = document["stream_defaults"]
    observable = {key: value for key, value in shared["observable"].items() if key not in EXTRA}
    stripping = shared["stripping"] | {"particles": particles}
    document["stream_defaults"] = shared | {"observable": observable, "stripping": stripping}
    document["stream"] = {name: document["stream"][name] for name in streams or document["stream"]}
    freer = document["potential"] | {"halo": NONPARAMETRIC}
    return {"nfw": document, "freer": document | {"potential": freer}}


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
    of_one = sk.Host({"halo": potential(halo | {"mass": 1e11})}).mass_inside(np.array([20.0]))[0]
    halo["mass"] = 1e11 * (1e11 + 0.45e11 * inside) / float(of_one)
    disc, rd, cloud = rng.uniform(size=3).tolist()
    lmc = {"kind": "nfw_truncated", "mass": 5e10 * 4**cloud}

    def too_fast(rs: float) -> float:
        alone = sk.Host({"cloud": potential(lmc | {"rs": rs, "rt": 4 * rs})})
        return float(alone.circular_velocity(np.array([8.7]))[0]) - 91.7

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
    found = {f"M{r:g}": float(m) for r, m in zip(RADII, host.mass_inside(np.array(RADII)), strict=True)}
    height = np.array([20.0 / np.sqrt(2)])
    found["q"] = float(host.flattening(height, height)[0])
    found["v_c"] = float(host.circular_velocity(np.array([8.0]))[0])
    return found | {"cloud": float(cloud.mass_inside(np.array([CLOUD_RADIUS]))[0])}


@dataclass(frozen=True)
class Sky:
    """The mock tables of all streams by name, the true numbers, and the quantiles of the progenitors' numbers."""

    family: str
    tables: dict[str, dict[str, Any]]
    truth: dict[str, float]
    places: dict[str, float]


def sky(index: int, document: dict[str, Any], scheme: str) -> Sky:
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
    stripping = {"kind": "restricted_nbody"} if scheme == "live" else shared["stripping"]
    places, tables = dict[str, float](), dict[str, dict[str, Any]]()
    for _ in range(20):
        left = {name: section for name, section in document["stream"].items() if name not in tables}
        drawn = {key: float(rng.uniform(0.375, 0.625)) for key in own if key.split(".")[1] in left}
        streams = {name: {k: v for k, v in section.items() if k != "stripping"} for name, section in left.items()}
        for key, u in drawn.items():
            _, name, _, field = key.split(".")
            at = {field: float(own[key].ppf(np.array([u]))[0])}
            streams[name] = streams[name] | {"progenitor": streams[name]["progenitor"] | at}
        model = sk.Model({"version": 1, "seed": 1000 + index, "sun": document["sun"], **host, "stream": streams,
                          "stream_defaults": shared | {"stripping": stripping | {"particles": TRUE}}})  # fmt: skip
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


class Fit:
    """A Gaussian posterior of normal quantiles z of the priors: its mean and covariance."""

    def __init__(self, document: dict[str, Any], mock: Sky, seed: int) -> None:
        self.model = sk.Model(with_data(document, mock))
        self.spec, self.names = self.model.spec, list(self.model.spec.names)
        self.shared = [i for i, name in enumerate(self.names) if not name.startswith("stream.")]
        self.own = {
            stream: [i for i, name in enumerate(self.names) if name.startswith(f"stream.{stream}.")]
            for stream in mock.tables
        }
        self.measured = {one.stream: one for one in self.model.measured(self.spec.bind_all())}
        self.mean = np.array([ndtri(mock.places.get(name, 0.5)) for name in self.names])
        sd = np.where([name in mock.places for name in self.names], FIRST[1], FIRST[0])
        self.covariance = np.diag(sd**2)
        self.points = qmc.Sobol(len(self.names), seed=seed)
        self.calls = 0

    def theta(self, z: Array) -> Array:
        """(d,) Return the parameters at quantiles."""
        u = ndtr(z)
        return np.array([prior.ppf(u[i : i + 1])[0] for i, prior in enumerate(self.spec.priors)])

    def draws(self, n: int) -> tuple[Array, dict[str, Array], dict[str, Array]]:
        """Return n draws (n, d), and by stream the predictions and their variances (n, m): NaN where there is none."""
        root = np.linalg.cholesky(self.covariance)
        z = self.mean + ndtri(np.clip(self.points.random(n), 1e-6, 1 - 1e-6)) @ root.T
        empty = {name: np.full((n, len(one.data.values)), np.nan) for name, one in self.measured.items()}
        means, variances = empty, {name: one.copy() for name, one in empty.items()}
        for i in range(n):
            bound = self.spec.bind_all(self.theta(z[i]))
            host = Host(bound.potentials, bound.bodies, numbers=bound.numbers)
            for name in self.measured:
                self.calls += 1
                try:
                    prediction = self.model.observe(bound.streams[name], host)[1]
                except sk.OutOfDomain:
                    continue
                if prediction is not None and not prediction.why_not:
                    means[name][i] = prediction.mean
                    variances[name][i] = np.asarray(self.measured[name].measurement.scatter(prediction)) ** 2
        return z, means, variances

    def renew(self, n: int, last: bool = False) -> tuple[float, float]:
        """Renew the Gaussian by n draws; return how far it moved in standard deviations, and chi^2 of a datum.

        The Gaussian of before, `WIDER`, is a prior of the next one unless that is the last: lines hold near its draws.
        """
        z, means, variances = self.draws(n)
        d = len(self.names)
        information, pull, chi2, count = np.eye(d), np.zeros(d), 0.0, 0
        for name, one in self.measured.items():
            which, data = self.shared + self.own[name], one.data.values
            fine = np.isfinite(means[name]).all(axis=1)
            x = np.column_stack([np.ones(fine.sum()), z[fine][:, which] - self.mean[which]])
            if len(x) < len(which) + 8:
                raise SystemExit(f"{name}: too few draws have a stream")
            inverse = np.linalg.inv(x.T @ x)
            slopes = inverse @ x.T @ means[name][fine]
            left = means[name][fine] - x @ slopes
            spread = (left**2).sum(axis=0) / (len(x) - x.shape[1])
            s2 = np.median(variances[name][fine], axis=0) + spread
            used = np.isfinite(data)
            j, s2, residual = slopes[1:, used].T, s2[used], (data - slopes[0])[used]
            here = j.T @ (j / s2[:, None]) - (spread[used] / s2).sum() * inverse[1:, 1:]
            value, vector = np.linalg.eigh(here)
            information[np.ix_(which, which)] += (vector * np.maximum(value, 0)) @ vector.T
            pull[which] += j.T @ (residual / s2)
            chi2, count = chi2 + (residual**2 / s2).sum(), count + used.sum()
        pull -= self.mean  # of the prior, a normal of mean 0 and variance 1
        trusted = information if last else information + np.linalg.inv(WIDER**2 * self.covariance)
        self.covariance = np.linalg.inv(trusted)
        move = self.covariance @ pull
        self.mean = self.mean + move
        return float(np.abs(move / np.sqrt(np.diag(self.covariance))).max()), float(chi2 / count)

    def quantiles(self, seed: int) -> dict[str, list[float]]:
        """Return quantiles of the numbers of the host, by draws of the Gaussian."""
        z = np.random.default_rng(seed).multivariate_normal(self.mean, self.covariance, 400, method="cholesky")
        each = [numbers_of(self.spec, self.theta(one)) for one in z]
        return {key: np.quantile([one[key] for one in each], LEVELS).tolist() for key in each[0]}


def fit(document: dict[str, Any], mock: Sky, seed: int) -> dict[str, Any]:
    """Return quantiles, the last move, chi^2 of a datum, calls and CPU seconds of a fit."""
    begin, one = time.process_time(), Fit(document, mock, seed)
    for _ in range(ROUNDS):
        moved, chi2 = one.renew(DRAWS)
        print(f"    moved by {moved:.2f} sd, chi^2 of a datum {chi2:.2f}", flush=True)
        if moved < SETTLED:
            break
    for _ in range(3):
        moved, chi2 = one.renew(LAST, last=True)
        if moved < SETTLED:
            break
    return {**one.quantiles(seed), "settled": moved < SETTLED, "moved": moved, "chi2": chi2, "calls": one.calls,
            "cpu": round(time.process_time() - begin)}  # fmt: skip


def sample(document: dict[str, Any], mock: Sky, seed: int) -> dict[str, Any]:
    """Return the same of a fit by the sampler `emulator`, and what its certificate lacks."""
    begin, sampler = time.process_time(), {"kind": "emulator", "max_calls": 1500}
    results = sk.run(with_data(document, mock) | {"seed": seed, "sampler": sampler}, progress=False)
    each = [numbers_of(results.spec, theta) for theta in results.some(400)]
    found = {key: np.quantile([one[key] for one in each], LEVELS).tolist() for key in each[0]}
    lacks, spent = str(results.draws.lacks or ""), round(time.process_time() - begin)
    return {**found, "settled": not lacks, "lacks": lacks, "calls": results.calls, "cpu": spent}


def table(file: Path) -> str:
    """Return by fit and family how many intervals hold the truth, and the shifts in standard deviations."""
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    lines = []
    kinds = sorted({(row["host"], row["by"], row["scheme"]) for row in rows})
    for kind in kinds:
        for family in ("all", *FAMILIES):
            of = [row for row in rows if (row["host"], row["by"], row["scheme"]) == kind]
            ours = [row for row in of if family in ("all", row["family"])]
            if not ours:
                continue
            settled = sum(row["settled"] for row in ours)
            lines.append(f"{', '.join(kind)}, {family}: {len(ours)} skies, {settled} settled")
            for number in ours[0]["truth"]:
                found = np.array([row[number] for row in ours])
                true = np.array([row["truth"][number] for row in ours])
                shift = (found[:, 2] - true) / (0.5 * (found[:, 3] - found[:, 1]))
                held = [((found[:, k] < true) & (true < found[:, 4 - k])).sum() for k in (1, 0)]
                lines.append(
                    f"  {number:6s} 68 %: {held[0]}, 95 %: {held[1]}; {np.mean(found[:, 2] / true - 1):+.3f} of the "
                    f"truth, {shift.mean():+.2f} sd, rms {np.sqrt((shift**2).mean()):.2f}; half width "
                    f"{np.mean(0.5 * (found[:, 3] - found[:, 1]) / true):.3f}"
                )
    return "\n".join(lines)


def main() -> None:
    """Fit skies that have no result yet, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["fit", "sample", "table"])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--skies", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--hosts", nargs="+", choices=["nfw", "freer"], default=["nfw", "freer"])
    parser.add_argument("--truth", choices=["live", "mlcs"], default="live", help="how true progenitors are stripped")
    parser.add_argument("--streams", nargs="+", default=[], help="some of the twelve streams")
    parser.add_argument("--particles", type=int, default=2048)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    file = given.output.absolute() / "fits.jsonl"
    os.chdir(RUN.parent)  # the run file names its tables from there
    if given.what == "table":
        print(table(file))
        return
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    finished = {(row["sky"], row["host"], row["scheme"], row["by"]) for row in rows}
    documents = fits_of(given.streams, given.particles)
    for index in range(given.first, given.first + given.skies):
        wanted = [name for name in given.hosts if (index, name, given.truth, given.what) not in finished]
        if not wanted:
            continue
        mock = sky(index, documents["nfw"], given.truth)
        for name in wanted:
            print(f"sky {index}, {mock.family}, {name}", flush=True)
            line = {"sky": index, "host": name, "scheme": given.truth, "by": given.what, "family": mock.family}
            line["truth"] = mock.truth
            line |= (fit if given.what == "fit" else sample)(documents[name], mock, index)
            with file.open("a") as output:
                output.write(json.dumps(line) + "\n")
            print(line, flush=True)


if __name__ == "__main__":
    main()
