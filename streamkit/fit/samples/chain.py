"""The chain of a run: how it describes and judges itself, and its rank plots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.components import ChainSampler, Verdict
from streamkit.convergence import effective_samples, rank_r_hat, stuck_walkers
from streamkit.fit.judge import chain as checks
from streamkit.fit.judge.chain import drift, rank_scores, ranks
from streamkit.fit.samples.draws import Draws, Row
from streamkit.report import BAND_95, BLUE, GREY, finish, panel_grid
from streamkit.sample import Chain
from streamkit.stream import Array, IntArray

DRAWN = 2000  # largest number of steps in a trace


class ChainDraws(Draws):
    """A stored chain, judged by the rule of its sampler. Half of the chain of a quick run is burn-in."""

    trace = "step", "grey: walkers; blue: their median; shaded: burn-in"
    trace_caption = (
        "Every walker against step (grey), their median (blue), burn-in shaded. Good traces are level and cross each "
        "other all the time."
    )

    def __init__(self, stored: Chain, sampler: ChainSampler, names: Sequence[str], quick: bool) -> None:
        super().__init__(stored.chain, stored.log_prob, stored.blobs, stored.attributes, quick)
        former = stored.attributes.get("counts", {}).get("surrogate")  # version 0.1.0 stored the fact here
        self.facts = self.facts or ({"surrogate": former} if former else {})
        steps, walkers, _ = self.chain.shape
        rule = self.convergence = sampler.convergence(self.chain)
        self.discard = steps // 2 if quick else rule.discard
        self.tau, self.r_hat = rule.tau, rank_r_hat(self.kept) if quick else rule.r_hat
        self.ess = effective_samples(self.kept, self.tau)
        # if R-hat is above its limit, the walkers have no common distribution
        self.trusted_ess = np.where(self.r_hat > checks.R_HAT.limits[1], np.nan, self.ess)
        self.stuck = stuck_walkers(self.chain, self.log_prob)
        step, walker = np.unravel_index(np.argmax(self.log_prob), self.log_prob.shape)
        self.best = self.chain[step, walker]
        moved = np.diff(self.chain[rule.learned :], axis=0).any(axis=2)
        self.acceptance = float(moved.mean() if moved.size else np.mean(stored.accepted) / steps)
        self.names, self.lacks, self.length = names, rule.missing(names), f"{steps} steps"
        self.headline = f"{self.length} of {walkers} walkers, {self.discard} of them left out as burn-in"
        self.praise = (
            f"{self.length} are {rule.span:.0f} autocorrelation times, and R-hat is {self.r_hat.max():.3f} at most."
        )

    def verdicts(self) -> list[Verdict]:
        """Return the outcomes of the checks of a chain."""
        return [
            checks.length_verdict(self.convergence.span, self.convergence.is_stable),
            checks.r_hat_verdict(self.names, self.r_hat),
            checks.samples_verdict(self.names, self.trusted_ess),
            checks.drift_verdict(self.names, drift(self.kept, self.tau)),
            checks.ranks_verdict(rank_scores(self.kept, self.tau)),
            checks.stuck_verdict(len(self.stuck), self.chain.shape[1]),
            checks.acceptance_verdict(self.acceptance),
        ]

    def rows(self) -> list[Row]:
        """Return acceptance, calls and facts."""
        return [
            ("acceptance", f"{self.acceptance:.3f}", ""),
            ("calls", str(self.calls), f"and {self.search_calls} in the search for a start"),
            *((name, "", text) for name, text in self.facts.items()),
        ]

    def record(self) -> dict[str, Any]:
        """Return steps, walkers and burn-in."""
        steps, walkers, _ = self.chain.shape
        return {"steps": steps, "walkers": walkers, "burn_in": self.discard}

    def draw_trace(self, axes: Axes, parameter: int | None, scale: float) -> None:
        """Draw the walkers' paths against the step, with the burn-in shaded."""
        steps, walkers, _ = self.chain.shape
        ln_p = np.where(np.isfinite(self.log_prob), self.log_prob, np.nan)
        value = ln_p if parameter is None else self.chain[..., parameter] / scale
        x, every = np.arange(1, steps + 1), max(steps // DRAWN, 1)
        alpha = min(max(0.25, 10 / walkers), 1)
        axes.plot(x[::every], value[::every], color=GREY, lw=0.4, alpha=alpha, rasterized=True)
        axes.plot(x[::every], np.median(value, axis=1)[::every], color=BLUE, lw=1.6)
        if self.discard:
            axes.axvspan(1, self.discard, color="black", alpha=0.07, lw=0)
        axes.set_xlim(1, max(steps, 2))
        low = np.percentile(ln_p[self.discard :], 0.5)
        if parameter is None and np.isfinite(low):
            axes.set_ylim(low - 5, np.nanmax(ln_p) + 2)

    def pictures(self, labels: Sequence[str], shown: IntArray) -> dict[str, Callable[[], Figure]]:
        """Return the rank plots of the parameters ``shown``."""
        return {"ranks": partial(rank_plots, self.kept[..., shown], self.tau[shown], labels)}


def rank_plots(kept: Array, tau: Array, labels: Sequence[str]) -> Figure:
    """Draw for every parameter how far each walker's ranks are from even (Vehtari+ 2021, sec. 4; Saeilynoja+ 2022).

    One line a walker: the share of its ranks below a value, minus that value. The band holds 95 % of what as many
    independent samples as the walker has would show at each value.

    ``kept`` are samples (steps, walkers, d), ``tau`` autocorrelation times (d,) in steps.
    """
    by_rank = np.sort(ranks(kept), axis=0)
    steps, walkers, d = kept.shape
    figure, panels = panel_grid(d, 2.6, 1.9, share=True)
    u, below = np.linspace(0, 1, 101), (np.arange(steps) + 0.5) / steps
    for axes, walkers_ranks, n, name in zip(panels, np.moveaxis(by_rank, 2, 0), steps / tau, labels, strict=False):
        if np.isfinite(n):
            spread = 1.96 * np.sqrt(u * (1 - u) / n)
            axes.fill_between(u, -spread, spread, color=BAND_95, lw=0)
        for walker in walkers_ranks.T:
            lines = np.interp(u, walker, below, left=0, right=1) - u
            axes.plot(u, lines, color=GREY, lw=0.6, alpha=min(1.0, max(0.3, 10 / walkers)))
        axes.axhline(0, color=BLUE, lw=1.2)
        axes.set_title(name.replace("\n", ""), fontsize=11)
        axes.set_xlim(0, 1)
        finish(axes)
    figure.supxlabel("rank of the sample, over the number of samples", fontsize=11)
    figure.supylabel("walker's share below, minus the rank", fontsize=11)
    return figure
