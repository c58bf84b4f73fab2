"""The weighted samples of a run, with their descriptions and verdicts."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from streamkit.components import DO_NOT, FINE, LOOK, Check, Verdict
from streamkit.fit.judge.chain import SAMPLES, number
from streamkit.fit.samples.draws import Draws, Row
from streamkit.report import BLUE, GREY
from streamkit.sample import Weighted

DRAWN = 5000  # largest number of samples in a trace
# Fraction of all weight in the largest one: with 0.01 a percentile is coarse, with 0.1 the one sample dominates it.
HEAVIEST = Check(
    "largest weight", (0.01, 0.1), "fine up to 1 % of all weights, do not use above 10 %", larger_is_worse=True
)
# The same limits as for the samples of a chain.
KISH = Check(
    SAMPLES.subject,
    SAMPLES.limits,
    "from the weights (Kish 1965): fine from 400 on (Vehtari+ 2021, sec. 4), do not use below 100",
)


class WeightedDraws(Draws):
    """Stored weighted samples of a sampler of this kind.

    The chain has one walker: samples of equal weight, as many as the effective number, drawn with the seed.
    """

    weighted: Weighted
    trace = "number of the sample, by rising likelihood", "grey: all samples; blue: by their weight"
    trace_caption = "The samples in the order of their likelihood: all of them grey, and blue by their weight."

    def __init__(self, stored: Weighted, kind: str, seed: int, quick: bool, emulated: bool = False) -> None:
        drawn = stored.drawn(seed)
        chain, log_prob, blobs = (each[drawn][:, None] for each in (stored.points, stored.log_prob, stored.blobs))
        super().__init__(chain, log_prob, blobs, stored.attributes, quick)
        d = chain.shape[2]
        self.weighted, self._kind, self.lacks = stored, kind, stored.lacks
        self._history: dict[str, Any] = stored.attributes.get("history", {}) if emulated else {}
        if self._history:  # emulated samples have no order: their picture shows how the answer moved
            self.trace = "calls with all particles", "median and 68 % interval; filled: the sampler's checks are passed"
            self.trace_caption = (
                "The answer after so many calls: medians with their 68 % intervals; filled where the sampler's own "
                "checks are passed. The last ones should agree within their intervals."
            )
            self.last_trace = str(self._history["names"][-1]).replace(" [", "\n[")
        self.tau = self.r_hat = np.full(d, np.nan)  # only chains have these
        self.ess = self.trusted_ess = np.full(d, stored.ess)
        self.best = stored.points[np.argmax(stored.log_prob)]
        self.acceptance = float(stored.ess / max(self.calls, 1))
        self.length = f"{self.calls} calls"
        evidence = f"; ln evidence {stored.ln_evidence:.2f} +- {stored.ln_evidence_error:.2f}"
        evidence = evidence if np.isfinite(stored.ln_evidence) else ""
        shown = "" if len(chain) == len(stored.points) else f", shown as {len(chain)} of equal weight"
        self.headline = f"{len(stored.points)} weighted samples of the sampler {kind}{shown}{evidence}"
        samples = f"{stored.ess:.0f} effective samples{evidence}"
        self.praise = f"The sampler {kind} has ended by its own rule, with {samples}."

    def verdicts(self) -> list[Verdict]:
        """Return the outcome of the sampler's rule, its own checks, and those of the weights."""
        stored, kind = self.weighted, self._kind
        rule_said = {
            FINE: f"{kind} has ended by its own rule. There is no R-hat, which compares chains: that no region was "
            "missed rests on this rule. Run it again with another seed where much depends on it.",
            LOOK: f"Not ended by its own rule: {stored.missing}. Continue with --resume.",
        }
        level = LOOK if stored.missing else FINE
        value = f"ln Z = {stored.ln_evidence:.2f} ± {stored.ln_evidence_error:.2f}"
        value = value if np.isfinite(stored.ln_evidence) else kind
        rule = f"fine when {kind} has ended by its own rule, which the run file sets"
        error = 1.2533 / np.sqrt(max(stored.ess, 1.0))  # of a median, in standard deviations of a Gaussian
        medians = f"Every median is known to {error:.2f} of its standard deviation"
        enough = {
            FINE: f"{medians} or better.",
            LOOK: f"{medians} only, the 95 % limits worse. Ask for more effective samples.",
            DO_NOT: "There are too few independent samples for an interval.",
        }
        heavy = {
            FINE: "No single sample carries much of the posterior.",
            LOOK: "One sample carries a visible part of the posterior: ask for more effective samples.",
            DO_NOT: "One sample carries much of the posterior: the maximum has hardly been found.",
        }
        largest = float(stored.weights.max())
        return [
            Verdict("rule of the sampler", level, value, rule_said[level], rule),
            *stored.verdicts,
            KISH.judge(stored.ess, number(stored.ess, ".0f"), enough),
            HEAVIEST.judge(largest, number(100 * largest, ".2g", " %"), heavy),
        ]

    def rows(self) -> list[Row]:
        """Return calls and facts."""
        search = f"; {self.search_calls} more with few particles" if self.search_calls else ""
        row = ("calls", str(self.calls), f"{self.calls / self.weighted.ess:.1f} for each effective sample{search}")
        return [row, *((name, "", text) for name, text in self.facts.items())]

    def record(self) -> dict[str, Any]:
        """Return the number of the samples, and the evidence."""
        return {
            "weighted_samples": len(self.weighted.points),
            "ln_evidence": self.weighted.ln_evidence,
            "ln_evidence_error": self.weighted.ln_evidence_error,
        }

    def provenance(self) -> dict[str, Any]:
        """Return the notes that a table about the samples carries."""
        return super().provenance() | {
            "samples": f"{len(self.weighted.points)} weighted ones, here as {len(self.chain)} of equal weight",
            "ln evidence": self.weighted.ln_evidence,
            "error of ln evidence": self.weighted.ln_evidence_error,
        }

    def draw_trace(self, axes: Axes, parameter: int | None, scale: float) -> None:
        """Draw the history of an emulator; else all samples in the order of their ln likelihood, blue by weight."""
        if self._history:
            self._draw_history(axes, -1 if parameter is None else parameter, scale)
            return
        stored = self.weighted
        order = np.argsort(stored.blobs["ln_likelihood"], kind="stable")
        order = order[np.isfinite(stored.log_prob[order])]
        every = max(len(order) // DRAWN, 1)
        x, chosen = np.arange(1, len(order) + 1)[::every], order[::every]
        value = stored.log_prob[chosen] if parameter is None else stored.points[chosen, parameter] / scale
        share = stored.weights[chosen] / stored.weights.max()
        axes.plot(x, value, ".", color=GREY, ms=1.5, alpha=0.4, mew=0, rasterized=True)
        axes.scatter(x, value, s=5, color=BLUE, alpha=share, lw=0, rasterized=True)
        if parameter is None:
            axes.set_ylim(value.max() - 60, value.max() + 2)

    def _draw_history(self, axes: Axes, quantity: int, scale: float) -> None:
        """Draw the intervals of a quantity against the calls."""
        stages = self._history["stages"]
        calls = np.array([stage["calls"] for stage in stages])
        low, middle, high = np.array([stage["intervals"][quantity] for stage in stages]).T / scale
        axes.errorbar(calls, middle, (middle - low, high - middle), color=BLUE, lw=0.8, elinewidth=1.4)
        passed = np.array([stage["level"] == FINE for stage in stages])
        axes.plot(calls[~passed], middle[~passed], "o", ms=5, mfc="white", mec=BLUE)
        axes.plot(calls[passed], middle[passed], "o", ms=5, color=BLUE)
