"""How triaxial and tilted is the halo by the streams of examples/many_streams, beside a spherical one?

    python tests/benchmarks/tilted_halo.py --fits live mlcs --streams gd1 pal5 orphan

The shape of the halo's density is a symmetric matrix S without trace: its eigenvectors are the axes, their lengths are
the exponentials of its eigenvalues. Its five numbers have normal priors of mean 0 (a sphere) and standard deviation
0.2, and no angle is unknown where the halo is round, so that a Gaussian by regressions (tests/support/gaussian_fit.py)
can be made. Printed are the axis ratios, chi^2 of a sphere of five degrees of freedom, and the least chi^2 of axis
ratios 1 : 0.75 : 0.70 in any direction (arXiv:2504.07187, GD-1).
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import streamkit as sk
from streamkit import Array

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
import gaussian_fit
from many_skies import FOLDER, RUN, STRIPPINGS, fits_of

WIDTH = 0.2  # standard deviation of the prior of each number of S
PUBLISHED = 1.0, 0.75, 0.70
HALO = "potential.halo."
SHAPE = tuple(f"{HALO}{name}" for name in ("p", "q", "orientation.0", "orientation.1", "orientation.2"))
BASIS = np.array([
    np.diag([1, -1, 0]) / np.sqrt(2), np.diag([1, 1, -2]) / np.sqrt(6),
    *(np.eye(3)[[i]].T @ np.eye(3)[[j]] / np.sqrt(2) + np.eye(3)[[j]].T @ np.eye(3)[[i]] / np.sqrt(2)
      for i, j in ((0, 1), (0, 2), (1, 2))),
])  # fmt: skip


class TiltedFit(gaussian_fit.GaussianFit):
    """A Gaussian whose quantiles of p, q and three angles are the five numbers of S, in units of `WIDTH`."""

    def theta(self, z: Array) -> Array:
        """(d,) Return the parameters. Volume, mass and scale radius are those of the sphere of the same numbers."""
        flat = z.copy()
        flat[self.shape] = 0.0
        found = super().theta(flat)
        lengths, axes = shape_of(z[self.shape])
        angles = Rotation.from_matrix(axes).as_euler("ZXZ", degrees=True) % 360
        p, q = np.clip(lengths[1:] / lengths[0], 0.4, 1.0)
        found[self.shape] = [p, q, *angles]
        mean = (p * q) ** (1 / 3)
        found[self.names.index(f"{HALO}rs")] /= mean
        found[self.names.index(f"{HALO}mass")] /= mean**3
        return found

    @property
    def shape(self) -> list[int]:
        """Where the five numbers are among all."""
        return [self.names.index(name) for name in SHAPE]


def shape_of(numbers: Array) -> tuple[Array, Array]:
    """Return the lengths (3,) of the axes, the longest first, and the axes as columns (3, 3)."""
    value, vector = np.linalg.eigh(np.tensordot(WIDTH * numbers, BASIS, axes=1))
    axes = vector[:, ::-1]
    return np.exp(value[::-1]), axes * np.where(np.linalg.det(axes) < 0, -1, 1)


def document_of(document: dict[str, Any]) -> dict[str, Any]:
    """Return the run file with a halo that is triaxial and tilted in its density."""
    halo = {name: x for name, x in document["potential"]["halo"].items() if name in ("mass", "rs")}
    halo |= {"kind": "nfw_ellipsoidal", "p": {"uniform": [0.4, 1.0]}, "q": {"uniform": [0.4, 1.0]}}
    halo |= {"orientation": [{"uniform": [0, 360]}] * 3}
    return document | {"potential": document["potential"] | {"halo": halo}}


def least_chi2(mean: Array, covariance: Array) -> float:
    """Return the least chi^2 of the published axis ratios in any direction."""
    lengths = np.log(PUBLISHED) - np.log(PUBLISHED).mean()
    inverse = np.linalg.inv(covariance)

    def chi2(angles: Array) -> float:
        axes = Rotation.from_euler("ZXZ", angles).as_matrix()
        away = np.einsum("kij,ij->k", BASIS, axes @ np.diag(lengths) @ axes.T) / WIDTH - mean
        return float(away @ inverse @ away)

    starts = np.random.default_rng(1).uniform(0, 2 * np.pi, (60, 3))
    return min(float(minimize(chi2, start, method="Nelder-Mead").fun) for start in starts)


def main() -> None:
    """Fit, and print the shape."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", default=RUN.name, help="run file in examples/many_streams")
    parser.add_argument("--fits", nargs="+", choices=STRIPPINGS, default=["live"], help="how progenitors are stripped")
    parser.add_argument("--streams", nargs="+", default=[], help="some of the streams")
    parser.add_argument("--particles", type=int, default=4096)
    given = parser.parse_args()
    documents = fits_of(given.streams, given.particles, run=FOLDER / given.run)
    os.chdir(FOLDER)  # the run file names its tables from there
    for stripping in given.fits:
        model = sk.Model(document_of(documents["nfw", stripping]))
        fit = TiltedFit(model, {}, 1)
        settled, *_ = gaussian_fit.settle(fit)
        mean, covariance = fit.found[0][fit.shape], fit.found[1][np.ix_(fit.shape, fit.shape)]
        drawn = np.random.default_rng(1).multivariate_normal(mean, covariance, 4000)
        prior = np.random.default_rng(2).standard_normal((4000, 5))
        for label, numbers in (("prior", prior), ("posterior", drawn)):
            lengths = np.array([shape_of(each)[0] for each in numbers])
            ratios = np.quantile(lengths[:, 1:] / lengths[:, :1], [0.16, 0.5, 0.84], axis=0).T
            told = ", ".join(f"{name} {b:.2f} ({a:.2f}-{c:.2f})" for name, (a, b, c) in zip("pq", ratios, strict=True))
            print(f"{stripping}, {label}: {told}")
        sphere = mean @ np.linalg.inv(covariance) @ mean
        print(f"  S / {WIDTH}: {np.round(mean, 2)} +- {np.round(np.sqrt(np.diag(covariance)), 2)}, settled: {settled}")
        print(f"  chi^2 of a sphere {sphere:.1f} of 5; of {PUBLISHED} at best {least_chi2(mean, covariance):.1f} of 2")


if __name__ == "__main__":
    main()
