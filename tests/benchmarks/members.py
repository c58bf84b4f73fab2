"""Widths and dispersions of streams from real members with velocities, on the model's track.

    python tests/benchmarks/members.py MEMBERS.ecsv [--stream GD-1] [--worst 6] [--fit DIR]

MEMBERS is a table of the members of streams by STREAMFINDER (Ibata et al. 2024, ApJ 967, 89) with the columns stream,
ra, dec, pmra, pmdec, gmag, v and v_error. No such table comes with streamkit. The proper motions have no errors there:
they are taken from the magnitude (Gaia DR3: 0.96 of the error of a parallax). Field stars are even in a box about the
stream, as the members were selected along it.

The progenitor is so light that its debris is narrower than the stream is, and the extra dispersions say how wide it is.
Its track is the likeliest one, found by simplexes in turn with the fractions and dispersions. Then emcee samples these,
at that track: the errors leave out that of the track. Each stream has a thin and a wide part on one track: GD-1's wide
part is its cocoon, those of the others hold stars of the field too. The last column has published numbers: DESI DR2
(arXiv:2604.20958) for GD-1, Kuzma et al. 2015 (MNRAS 446, 3297) for Palomar 5.

With `--fit` track, fractions and dispersions are all free in a run in DIR by the sampler `emulator`, so that the mass
has its error.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from astropy.table import Table
from scipy.optimize import minimize
from scipy.special import expit

import streamkit as sk


@dataclass(frozen=True)
class Stream:
    """A stream with the host of an example: its window, its run file, and where its track begins.

    ``track`` has a start and the size of the first simplex for each free number; ``published`` the last column.
    """

    frame: str
    phi1: tuple[float, float]
    phi2: tuple[float, float]
    host: dict[str, Any]
    progenitor: dict[str, Any]
    sigma: str
    kernel: float
    track: dict[str, tuple[float, float]]
    published: tuple[str, ...]  # share of the wide part; widths and dispersions of both


GALAXY = {
    "r0": "8.122 kpc", "z": "0.0208 kpc", "v_circ": "233.4 km/s", "u": "12.9 km/s", "v": "12.2 km/s", "w": "7.78 km/s",
}  # fmt: skip
STREAMS = {
    "GD-1": Stream(
        "GD1Koposov10", (-60.0, 0.0), (-3.0, 3.0),
        {"sun": GALAXY,
         "potential": {"preset": "bovy2014", "halo": {
            "kind": "nfw_triaxial", "mass": {"log_uniform": [1e11, 2e12]}, "rs": 16, "q": {"uniform": [0.6, 1.4]}}}},
        {"mass": "4e3 Msun", "radius": "15 pc", "phi1": "-30 deg", "phi2": {"uniform": [-1, 1]},
         "distance": {"uniform": [6.5, 10.5]}, "pm_phi1_cosphi2": {"uniform": [-16, -9]},
         "pm_phi2": {"uniform": [-6, 0]}, "v_los": {"uniform": [-130, -30]}, "lookback": "3 Gyr"},
        "0.3 km/s", 3.0,
        {"potential.halo.mass": (5e11, 6e10), "potential.halo.q": (0.9, 0.08), "progenitor.phi2": (0.05, 0.05),
         "progenitor.distance": (8.2, 0.2), "progenitor.pm_phi1_cosphi2": (-12.84, 0.1),
         "progenitor.pm_phi2": (-2.9, 0.1), "progenitor.v_los": (-80.0, 4.0)},
        ("0.30", "0.23", "2.18", "2.49 +- 0.28", "6.13 +- 0.75"),
    ),
    "Pal-5": Stream(
        "Pal5PriceWhelan18", (-20.0, 10.0), (-3.0, 4.0),
        {"sun": GALAXY, "potential": {"preset": "bovy2014", "halo": {
            "kind": "nfw_triaxial", "mass": {"log_uniform": [1e11, 2e12]}, "rs": 16, "q": {"uniform": [0.6, 1.4]}}}},
        {"mass": "4e3 Msun", "radius": "15 pc", "phi1": "0 deg", "phi2": "0 deg", "distance": {"uniform": [17, 26]},
         "pm_phi1_cosphi2": {"uniform": [3, 4.5]}, "pm_phi2": {"uniform": [0, 1.4]}, "v_los": {"uniform": [-65, -52]},
         "lookback": "4 Gyr"},
        "0.3 km/s", 1.5,
        {"potential.halo.mass": (4.2e11, 6e10), "potential.halo.q": (0.95, 0.08), "progenitor.distance": (20.8, 0.5),
         "progenitor.pm_phi1_cosphi2": (3.75, 0.04), "progenitor.pm_phi2": (0.70, 0.04),
         "progenitor.v_los": (-57.5, 1.0)},
        ("", "", "", "2.1 +- 0.4", ""),
    ),
    "Orphan": Stream(
        "OrphanKoposov19", (-70.0, 110.0), (-4.0, 8.0),
        {"sun": GALAXY,
         "potential": {"preset": "bovy2014", "halo": {"mass": {"log_uniform": [1e11, 2e12]}, "rs": 16}},
         "body": {"lmc": {
             "kind": "hernquist_vcirc", "mass": {"log_uniform": [2e10, 4e11]}, "ra": "78.77 deg", "dec": "-69.01 deg",
             "distance": "49.97 kpc", "pm_ra_cosdec": "1.91 mas/yr", "pm_dec": "0.27 mas/yr", "v_los": "262.2 km/s"}}},
        {"mass": "2e5 Msun", "radius": "50 pc", "phi1": "6.34 deg", "phi2": {"uniform": [-3, 3]},
         "distance": {"uniform": [14, 24]}, "pm_phi1_cosphi2": {"uniform": [3, 5.5]}, "pm_phi2": {"uniform": [1, 3]},
         "v_los": {"uniform": [40, 180]}, "lookback": "4 Gyr"},
        "1 km/s", 6.0,
        {"potential.halo.mass": (4.5e11, 5e10), "body.lmc.mass": (9e10, 2e10), "progenitor.phi2": (-0.4, 0.2),
         "progenitor.distance": (18.8, 0.5), "progenitor.pm_phi1_cosphi2": (4.2, 0.1),
         "progenitor.pm_phi2": (1.95, 0.1), "progenitor.v_los": (107.0, 5.0)},
        ("",) * 5,
    ),
}  # fmt: skip
LEAST = {  # the least and the most of each dispersion
    "phi2_dispersion": (0.01, 1.0), "cocoon_phi2_dispersion": (0.1, 5.0), "radial_velocity_dispersion": (0.1, 15.0),
    "cocoon_radial_velocity_dispersion": (0.3, 60.0), "pm_phi1_cosphi2_dispersion": (0.01, 1.0),
    "pm_phi2_dispersion": (0.01, 1.0), "cocoon_pm_phi1_cosphi2_dispersion": (0.02, 2.0),
    "cocoon_pm_phi2_dispersion": (0.02, 2.0),
}  # fmt: skip
BOX = 12.0 * 6.0 * 600.0  # (mas/yr)^2 km/s in which the field is even
LOW, HIGH = np.log(np.transpose(list(LEAST.values())))
TURNS, SIMPLEX, WALKERS, STEPS = 4, 160, 24, 700


def stars_of(name: str, table: Table, worst: float) -> dict[str, list[float]]:
    """Return the stars in the window whose velocities have an error below ``worst`` in km/s, as `stars` reads them."""
    rows = table[(table["stream"] == name) & (np.asarray(table["v_error"]) < worst)]
    stream = STREAMS[name]
    places = sk.sky_frame(stream.frame).from_icrs(*(np.asarray(rows[column], dtype=float) for column in ("ra", "dec")))
    (first, last), (low, high) = stream.phi1, stream.phi2
    inside = (places.phi1 > first) & (places.phi1 < last) & (places.phi2 > low) & (places.phi2 < high)
    rows = rows[inside]
    z = np.maximum(10 ** (0.4 * (13 - 15)), 10 ** (0.4 * (np.asarray(rows["gmag"], dtype=float) - 15)))
    motion = 0.96e-3 * np.sqrt(40 + 800 * z + 30 * z**2)  # mas/yr
    columns = {
        "ra": rows["ra"], "dec": rows["dec"], "pm_ra_cosdec": rows["pmra"], "pm_dec": rows["pmdec"],
        "pm_ra_cosdec_error": motion, "pm_dec_error": motion, "radial_velocity": rows["v"],
        "radial_velocity_error": np.maximum(rows["v_error"], 1.0),
        "background_density": np.full(len(rows), 1 / ((high - low) * BOX)),
    }  # fmt: skip
    return {key: np.asarray(column, dtype=float).tolist() for key, column in columns.items()}


def run_file(stream: Stream, stars: dict[str, list[float]]) -> sk.Spec:
    """Return the run file."""
    first = {name: float(np.exp(np.mean(np.log(ends)))) for name, ends in LEAST.items()}
    window = {"phi1": list(stream.phi1), "phi2": list(stream.phi2)}
    return sk.load({
        "seed": 1, **stream.host,
        "progenitor": {"kind": "plummer", "frame": stream.frame, **stream.progenitor},
        "stripping": {"kind": "mlcs", "particles": 3000, "sigma": stream.sigma},
        "observable": {"kind": "stars", "frame": stream.frame, "stars": stars, "window": window,
                       "kernel": stream.kernel, "knots": 15, "fraction": 0.9, "cocoon_fraction": 0.2, **first},
    })  # fmt: skip


class Fit:
    """The stars with fractions and dispersions u (10,): two logits, and logarithms of dispersions; and their ln L."""

    def __init__(self, stream: Stream, spec: sk.Spec) -> None:
        self.model, self.stars, self.spec = sk.Model(spec), spec.bind(spec.centre()).observable, spec
        self.first = np.array([stream.track[name] for name in spec.names])

    def predict(self, theta: sk.Array) -> sk.Prediction:
        """Return the prediction at a track."""
        return self.stars.predict(self.model.stream(theta))

    def of(self, u: sk.Array) -> Any:
        """Return the observable."""
        changes = {"fraction": float(expit(u[0])), "cocoon_fraction": float(expit(u[1]))}
        return self.stars.model_copy(update=changes | dict(zip(LEAST, np.exp(u[2:]).tolist(), strict=True)))

    def ln_p(self, u: sk.Array, prediction: sk.Prediction, noise: bool = False) -> float:
        """Return ln L with a prior even in the fractions and in the logarithms; a large negative number outside it."""
        if (np.abs(u[:2]) > 8).any() or (u[2:] < LOW).any() or (u[2:] > HIGH).any():
            return -1e9
        jacobian = float(np.sum(np.log(expit(u[:2]) * expit(-u[:2]))))
        return float(self.of(u).ln_likelihood(prediction, noise)) + jacobian


def likeliest(fit: Fit) -> tuple[sk.Array, sk.Array]:
    """Return the track, and fractions and dispersions, of the highest ln L that the simplexes find."""
    u, (theta, step) = np.concatenate([[2.0, -1.0], 0.5 * (LOW + HIGH)]), fit.first.T

    def off(x: sk.Array, about: sk.Array) -> float:
        try:
            return -fit.ln_p(u, fit.predict(about + x * step), True)
        except sk.OutOfDomain:
            return 1e9

    for _ in range(TURNS):
        prediction = fit.predict(theta)
        u = minimize(lambda x, p=prediction: -fit.ln_p(x, p), u, method="Nelder-Mead", options={"maxfev": 2000}).x
        simplex = np.vstack([np.zeros(len(step)), np.eye(len(step))])
        options = {"maxfev": SIMPLEX, "initial_simplex": simplex}
        theta = theta + step * minimize(off, simplex[0], (theta,), method="Nelder-Mead", options=options).x
    return theta, u


def fit_all(spec: sk.Spec, out: Path) -> None:
    """Run a fit in which the fractions and dispersions are free too, and print what it finds."""
    free = {name: {"log_uniform": list(ends)} for name, ends in LEAST.items()}
    free |= {name: {"uniform": [0.0, 1.0]} for name in ("fraction", "cocoon_fraction")}
    changes = {f"observable.{name}": prior for name, prior in free.items()}
    results = sk.run(spec.with_values({**changes, "sampler.kind": "emulator"}), out)
    masses = results.profiles(np.array([20.0]))[0][:, 0] / 1e11
    print(f"{results.calls} calls. {results.note()}")
    for name, values in (*((name, np.asarray(results[name])) for name in results.spec.names), ("M(<20), 1e11", masses)):
        low, middle, high = np.percentile(values, [16, 50, 84])
        print(f"{name:46s} {middle:.3g} ({low:.3g}-{high:.3g})")


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("members")
    options.add_argument("--stream", choices=list(STREAMS), default="GD-1")
    options.add_argument("--worst", type=float, default=6.0, help="largest error of a velocity in km/s")
    options.add_argument("--fit", type=Path, metavar="DIR", help="make a fit in which all is free, in this directory")
    given = options.parse_args()
    stars = stars_of(given.stream, Table.read(given.members, format="ascii.ecsv"), given.worst)
    stream = STREAMS[given.stream]
    spec = run_file(stream, stars)
    if given.fit:
        fit_all(spec, given.fit)
        return
    fit = Fit(stream, spec)
    theta, u = likeliest(fit)
    prediction = fit.predict(theta)
    sampler = emcee.EnsembleSampler(WALKERS, len(u), fit.ln_p, args=(prediction,))
    rng = np.random.default_rng(1)
    sampler.random_state = np.random.RandomState(1).get_state()  # emcee knows no other
    start = np.clip(u + 0.05 * rng.standard_normal((WALKERS, len(u))), [-8, -8, *LOW], [8, 8, *HIGH])
    sampler.run_mcmc(start, STEPS)
    chain = sampler.get_chain(discard=STEPS // 3, flat=True)
    rows, e2 = fit.stars.quantities(), dict(zip(LEAST, np.exp(2 * chain[:, 2:]).T, strict=True))
    own = {name: float(np.median(prediction.mean[rows[f"{name}_spread"]])) for name in ("phi2", "radial_velocity")}
    mass = sk.Host(spec.bind(theta).potentials).mass_inside(np.array([20.0]))[0]
    print(f"{len(stars['ra'])} stars; track: {dict(zip(spec.names, theta.round(3).tolist(), strict=True))}")
    print(f"M(<20 kpc) of the likeliest track: {mass / 1e11:.2f}e11 Msun")
    thin = {name: own[name] ** 2 + e2[f"{name}_dispersion"] for name in own}
    wide = {name: thin[name] + e2[f"cocoon_{name}_dispersion"] for name in own}
    shown = (
        ("stars of the stream", expit(chain[:, 0])),
        ("of these in the wide part", expit(chain[:, 1])),
        ("thin: width, deg", np.sqrt(thin["phi2"])),
        ("wide: width, deg", np.sqrt(wide["phi2"])),
        ("thin: dispersion, km/s", np.sqrt(thin["radial_velocity"])),
        ("wide: dispersion, km/s", np.sqrt(wide["radial_velocity"])),
    )
    for (name, values), published in zip(shown, ("", *stream.published), strict=True):
        low, middle, high = np.percentile(values, [16, 50, 84])
        print(f"{name:26s} {middle:.2f} ({low:.2f}-{high:.2f})   {published}")


if __name__ == "__main__":
    main()
