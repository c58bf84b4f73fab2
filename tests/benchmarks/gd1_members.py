"""Widths and dispersions of GD-1 from real members with velocities: a thin stream and a cocoon on the model's track.

    python tests/benchmarks/gd1_members.py MEMBERS.ecsv [--worst 6]

MEMBERS is a table of the members of streams by STREAMFINDER (Ibata et al. 2024, ApJ 967, 89) with the columns stream,
ra, dec, pmra, pmdec, gmag, v and v_error. No such table comes with streamkit. The proper motions have no errors there:
they are taken from the magnitude (Gaia DR3: 0.96 of the error of a parallax). Field stars are even in a box about the
stream, as the members were selected along it.

The stream is that of a light cluster, so that its debris is narrower than GD-1 is and the extra dispersions say how
wide it is. Its track is the likeliest one, found by simplexes in turn with the fractions and dispersions. Then emcee
samples these, at that track: the errors leave out that of the track. The last column has the numbers of DESI DR2
(arXiv:2604.20958).
"""

from __future__ import annotations

import argparse
from typing import Any

import emcee
import numpy as np
from astropy.table import Table
from scipy.optimize import minimize
from scipy.special import expit

import streamkit as sk

FRAME, PHI1, PHI2 = "GD1Koposov10", (-60.0, 0.0), (-3.0, 3.0)
BOX = (PHI2[1] - PHI2[0]) * 12.0 * 6.0 * 600.0  # deg (mas/yr)^2 km/s
TRACK = {  # a start, and the size of the first simplex
    "potential.v0": (216.0, 10.0), "potential.q": (0.914, 0.04), "progenitor.phi2": (0.05, 0.05),
    "progenitor.distance": (8.2, 0.2), "progenitor.pm_phi1_cosphi2": (-12.84, 0.1), "progenitor.pm_phi2": (-2.9, 0.1),
    "progenitor.v_los": (-80.0, 4.0),
}  # fmt: skip
LEAST = {  # the least and the most of each dispersion
    "phi2_dispersion": (0.01, 1.0), "cocoon_phi2_dispersion": (0.1, 5.0), "radial_velocity_dispersion": (0.1, 15.0),
    "cocoon_radial_velocity_dispersion": (0.3, 60.0), "pm_phi1_cosphi2_dispersion": (0.01, 1.0),
    "pm_phi2_dispersion": (0.01, 1.0),
}  # fmt: skip
LOW, HIGH = np.log(np.transpose(list(LEAST.values())))
TURNS, SIMPLEX, WALKERS, STEPS = 4, 160, 24, 700


def stars_of(table: Table, worst: float) -> dict[str, list[float]]:
    """Return the stars in the window whose velocities have an error below ``worst`` in km/s, as `stars` reads them."""
    rows = table[(table["stream"] == "GD-1") & (np.asarray(table["v_error"]) < worst)]
    places = sk.sky_frame(FRAME).from_icrs(np.asarray(rows["ra"], dtype=float), np.asarray(rows["dec"], dtype=float))
    inside = (places.phi1 > PHI1[0]) & (places.phi1 < PHI1[1]) & (np.abs(places.phi2) < PHI2[1])
    rows = rows[inside]
    z = np.maximum(10 ** (0.4 * (13 - 15)), 10 ** (0.4 * (np.asarray(rows["gmag"], dtype=float) - 15)))
    motion = 0.96e-3 * np.sqrt(40 + 800 * z + 30 * z**2)  # mas/yr
    columns = {
        "ra": rows["ra"], "dec": rows["dec"], "pm_ra_cosdec": rows["pmra"], "pm_dec": rows["pmdec"],
        "pm_ra_cosdec_error": motion, "pm_dec_error": motion, "radial_velocity": rows["v"],
        "radial_velocity_error": np.maximum(rows["v_error"], 1.0), "background_density": np.full(len(rows), 1 / BOX),
    }  # fmt: skip
    return {name: np.asarray(column, dtype=float).tolist() for name, column in columns.items()}


def run_file(stars: dict[str, list[float]]) -> sk.Spec:
    """Return the run file; the priors are those of examples/gd1."""
    first = {name: float(np.exp(np.mean(np.log(ends)))) for name, ends in LEAST.items()}
    document: dict[str, Any] = {
        "seed": 1,
        "sun": {"r0": "8 kpc", "v_circ": "host", "u": "11.1 km/s", "v": "12.24 km/s", "w": "7.25 km/s"},
        "potential": {"kind": "logarithmic_halo", "v0": {"uniform": [150, 300]}, "q": {"uniform": [0.6, 1.3]}},
        "progenitor": {
            "kind": "plummer", "mass": "4e3 Msun", "radius": "15 pc", "frame": FRAME, "phi1": "-30 deg",
            "phi2": {"uniform": [-1, 1]}, "distance": {"uniform": [6.5, 10.5]},
            "pm_phi1_cosphi2": {"uniform": [-16, -9]}, "pm_phi2": {"uniform": [-6, 0]},
            "v_los": {"uniform": [-130, -30]}, "lookback": "3 Gyr",
        },
        "stripping": {"kind": "mlcs", "particles": 3000, "sigma": "0.3 km/s"},
        "observable": {
            "kind": "stars", "frame": FRAME, "stars": stars, "window": {"phi1": list(PHI1), "phi2": list(PHI2)},
            "kernel": 3.0, "knots": 15, "fraction": 0.9, "cocoon_fraction": 0.2, **first,
        },
    }  # fmt: skip
    return sk.load(document)


class Fit:
    """The stars with fractions and dispersions u (8,): two logits, and logarithms of dispersions; and their ln L."""

    def __init__(self, spec: sk.Spec) -> None:
        self.model, self.stars = sk.Model(spec), spec.bind(spec.centre()).observable

    def predict(self, theta: sk.Array) -> sk.Prediction:
        """Return the prediction at a track (7,)."""
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
    """Return the track (7,), and fractions and dispersions (8,), of the highest ln L that the simplexes find."""
    theta, step = np.array(list(TRACK.values())).T
    u = np.concatenate([[2.0, -1.0], 0.5 * (LOW + HIGH)])

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


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("members")
    options.add_argument("--worst", type=float, default=6.0, help="largest error of a velocity in km/s")
    given = options.parse_args()
    stars = stars_of(Table.read(given.members, format="ascii.ecsv"), given.worst)
    spec = run_file(stars)
    fit = Fit(spec)
    theta, u = likeliest(fit)
    prediction = fit.predict(theta)
    sampler = emcee.EnsembleSampler(WALKERS, len(u), fit.ln_p, args=(prediction,))
    rng = np.random.default_rng(1)
    sampler.random_state = np.random.RandomState(1).get_state()  # emcee knows no other
    start = np.clip(u + 0.05 * rng.standard_normal((WALKERS, len(u))), [-8, -8, *LOW], [8, 8, *HIGH])
    sampler.run_mcmc(start, STEPS)
    chain = sampler.get_chain(discard=STEPS // 3, flat=True)
    rows, e2 = fit.stars.quantities(), np.exp(2 * chain[:, 2:])
    own = {name: float(np.median(prediction.mean[rows[f"{name}_spread"]])) for name in ("phi2", "radial_velocity")}
    mass = sk.Host(spec.bind(theta).potentials).mass_inside(np.array([20.0]))[0]
    print(f"{len(stars['ra'])} stars; track: {dict(zip(spec.names, theta.round(3).tolist(), strict=True))}")
    print(f"M(<20 kpc) of the likeliest track: {mass / 1e11:.2f}e11 Msun")
    for name, values, published in (
        ("stars of the stream", expit(chain[:, 0]), "-"),
        ("of these in the cocoon", expit(chain[:, 1]), "0.30"),
        ("thin: width, deg", np.sqrt(own["phi2"] ** 2 + e2[:, 0]), "0.23"),
        ("cocoon: width, deg", np.sqrt(own["phi2"] ** 2 + e2[:, 0] + e2[:, 1]), "2.18"),
        ("thin: dispersion, km/s", np.sqrt(own["radial_velocity"] ** 2 + e2[:, 2]), "2.49 +- 0.28"),
        ("cocoon: dispersion, km/s", np.sqrt(own["radial_velocity"] ** 2 + e2[:, 2] + e2[:, 3]), "6.13 +- 0.75"),
    ):
        low, middle, high = np.percentile(values, [16, 50, 84])
        print(f"{name:26s} {middle:.2f} ({low:.2f}-{high:.2f})   {published}")


if __name__ == "__main__":
    main()
