"""The default sampler: an ensemble of walkers, by emcee."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from streamkit import Sampler, Samples, Target

QUICK_WALKERS = 24
MOVES = {"surrogate": "terBraak2006", "de": "terBraak2006", "stretch": "Goodman2010"}


class Emcee(Sampler):
    """An ensemble of walkers by emcee, with moves that learn a surrogate of the posterior."""

    kind = "emcee"
    reference = "Foreman-Mackey et al. 2013, PASP 125, 306"
    stopping = ("steps", "tau_factor", "r_hat")

    walkers: int = Field(default=32, ge=2, description="Number of walkers, at least twice the free parameters.")
    steps: int = Field(default=5000, ge=1, description="Longest chain, in steps per walker.")
    tau_factor: float = Field(
        default=50.0, gt=0, description="Stop when the chain is longer than so many autocorrelation times."
    )
    r_hat: float = Field(
        default=1.02,
        gt=1,
        description="Stop only when the rank-normalised R-hat of every parameter is below this.",
    )
    start_particles: int = Field(
        default=1000,
        ge=2,
        description="Particles of the streams that the search for a start tries, the run's own number at most. Where "
        "an observable is made of little of the debris, such small streams have none of it: take more.",
    )
    moves: Literal["surrogate", "de", "stretch"] = Field(
        default="surrogate",
        description="Exchange with a learned surrogate of the posterior, differential evolution, or the stretch move.",
    )

    def sample(self, target: Target) -> Iterator[Samples]:
        """Run the ensemble, which is kept as a chain: there are no weighted samples."""
        target.ensemble(self)
        return iter(())

    def unfit(self, d: int) -> str:
        """Ask for twice as many walkers as parameters."""
        if self.walkers >= 2 * d:
            return ""
        return f"walkers: found {self.walkers}, expected at least {2 * d}, twice the number of free parameters"

    def quick(self, d: int) -> dict[str, int | float]:
        """Take few walkers."""
        return {"walkers": min(self.walkers, max(QUICK_WALKERS, 2 * d + 2))}

    def start(self) -> tuple[int, int]:
        """Return one point for each walker."""
        return self.walkers, self.start_particles

    def calls(self, d: int) -> tuple[int, str]:
        """Return those of the longest chain."""
        total = self.walkers * self.steps
        return total, f"{self.walkers} walkers x at most {self.steps} steps = {total} calls"

    def advice(self, d: int) -> tuple[str, ...]:
        """Warn of too few walkers."""
        few = f"sampler.walkers = {self.walkers} is"
        if self.walkers < 2 * d + 2:
            return (
                f"{few} too few for {d} free parameters: the sampler needs at least {2 * d} and moves badly below "
                f"{2 * d + 2}. Use {3 * d} or more.",
            )
        if self.walkers < 2.5 * d:
            return (f"{few} few for {d} free parameters: {3 * d} or more mix better.",)
        return ()

    def cites(self) -> dict[str, str]:
        """Return emcee, the search, the rule of convergence and the moves."""
        return {
            "ForemanMackey2013": "emcee, the sampler",
            "DelMoral2006": "the search for a start",
            "Vehtari2021": "R-hat",
            MOVES[self.moves]: f"the moves of the walkers, {self.moves!r}",
        }
