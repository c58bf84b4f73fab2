"""How rough ln p is near its maximum: along each parameter and along random directions of a finished fit.

    python tests/benchmarks/smoothness.py OUT [--particles N] [--save lines.npz] [--beside lines.npz] [--plot p.png]

OUT is the directory of a fit. Each line has 200 points over one posterior standard deviation about the best sample
(one unit of Mahalanobis distance in a random direction). The roughness of a line is the rms of ln p about a
polynomial (of degree 6, or 3 for fewer than 48 points), where it lies within 4 of its maximum.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

import streamkit as sk
from streamkit.sample import CHAIN, Posterior, read_chain_file

POINTS, NEAR, DEGREE = 200, 4.0, 6


def lines(directory: Path, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """The best sample (d,), steps (lines, d) that are one standard deviation long, and what each line is."""
    result = read_chain_file(directory / CHAIN)
    half = len(result.chain) // 2
    samples, lnp = result.chain[half:].reshape(-1, result.chain.shape[2]), result.log_prob[half:].ravel()
    best = samples[np.argmax(lnp)]
    root = np.linalg.cholesky(np.cov(samples.T))
    turned = np.random.default_rng(seed).standard_normal((count, len(best)))
    turned /= np.sqrt((turned**2).sum(axis=1))[:, None]
    steps = np.concatenate([np.diag(samples.std(axis=0)), turned @ root.T])
    names = [*sk.load(directory / "run.toml").names, *(f"direction {k + 1}" for k in range(count))]
    return best, steps, names


def roughness(s: np.ndarray, lnp: np.ndarray) -> tuple[float, np.ndarray]:
    """The rms about the smooth curve near its maximum, and that curve (n,); NaN where it is too narrow to tell."""
    level = median_filter(np.where(np.isfinite(lnp), lnp, -1e300), 5)
    low = np.flatnonzero(level < level.max() - NEAR)
    peak = int(np.argmax(level))
    begin, end = low[low < peak].max(initial=-1) + 1, low[low > peak].min(initial=len(s))
    result = (np.arange(len(s)) >= begin) & (np.arange(len(s)) < end) & np.isfinite(lnp)
    degree = DEGREE if result.sum() >= 8 * DEGREE else 3
    smooth = np.full(len(s), np.nan)
    if result.sum() < 12:
        return float("nan"), smooth
    smooth[result] = np.polynomial.Polynomial.fit(s[result], lnp[result], degree)(s[result])
    rest = (lnp - smooth)[result]
    return float(np.sqrt((rest**2).sum() / (len(rest) - degree - 1))), smooth


def draw(path: Path, s: np.ndarray, names: list[str], sets: list[tuple[str, str, np.ndarray]]) -> None:
    """One panel a line."""
    from matplotlib.figure import Figure

    rows = -(-len(names) // 4)
    figure = Figure(figsize=(13, 2.1 * rows), layout="constrained")
    panels = figure.subplots(rows, 4).ravel()
    for k, (axes, name) in enumerate(zip(panels, names, strict=False)):
        text = []
        for label, colour, lnp in sets:
            rms, smooth = roughness(s, lnp[k])
            offset = np.nanmax(smooth) if np.isfinite(smooth).any() else np.nanmax(lnp[k])
            axes.plot(s, lnp[k] - offset, ".", ms=2, color=colour, label=label)
            axes.plot(s, smooth - offset, color=colour, lw=1)
            text.append(f"{rms:.2f}")
        axes.set_title(f"{name}: rms {' / '.join(text)}", fontsize=8)
        axes.set(ylim=(-NEAR - 1.5, 2.0))
        axes.tick_params(labelsize=7)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    panels[0].legend(fontsize=7, frameon=False, markerscale=4)
    figure.supxlabel("distance along the line [posterior standard deviations]", fontsize=10)
    figure.supylabel(r"$\ln p - \max$ of the smooth curve", fontsize=10)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Evaluate the lines, print the roughness of each, and draw them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="directory of a fit")
    parser.add_argument("--particles", type=int, help="instead of the fit's own number")
    parser.add_argument("--directions", type=int, default=10, help="random directions")
    parser.add_argument("--points", type=int, default=POINTS, help="points a line")
    parser.add_argument("--save", type=Path, help="keep the values")
    parser.add_argument("--beside", type=Path, help="values of another version, drawn as 'before'")
    parser.add_argument("--plot", type=Path, help="picture of the lines")
    given = parser.parse_args()
    spec = sk.load(given.out / "run.toml")
    if given.particles:
        spec = spec.with_values({"stripping.particles": given.particles})
    posterior = Posterior(spec)
    best, steps, names = lines(given.out, given.directions, seed=1)
    s = np.linspace(-0.5, 0.5, given.points)
    lnp = np.array([[posterior.evaluate(best + x * step).lnp for x in s] for step in steps])
    for name, values in zip(names, lnp, strict=True):
        print(f"{name:24s} rms {roughness(s, values)[0]:.2f}")
    every = np.array([roughness(s, values)[0] for values in lnp])
    print(f"median {np.nanmedian(every):.2f}, largest {np.nanmax(every):.2f}")
    if given.save:
        np.savez(given.save, s=s, lnp=lnp)
    if given.plot:
        now = ("now", "#0072B2", lnp)
        before = [("before", "#D55E00", np.load(given.beside)["lnp"])] if given.beside else []
        draw(given.plot, s, names, [*before, now])


if __name__ == "__main__":
    main()
