"""The default sampler: an ensemble of walkers, by emcee."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from streamkit import Array, ChainSampler, Ensemble, Target
from streamkit.builtin.samplers.ensemble.learning import learning_steps

QUICK_WALKERS = 24
MOVES = {"surrogate": "terBraak2006", "de": "terBraak2006", "stretch": "Goodman2010"}  # papers of the moves


class Emcee(ChainSampler):
    """An ensemble of walkers by emcee, with moves that learn a surrogate of the posterior."""

    kind = "emcee"
    reference = "Foreman-Mackey et al. 2013, PASP 125, 306"

    moves: Literal["surrogate", "de", "stretch"] = Field(
        default="surrogate",
        description="Exchange with a learned surrogate of the posterior, differential evolution, or the stretch move.",
    )

    def walk(self, target: Target, ensemble: Ensemble) -> Iterator[Ensemble]:
        """Take steps with the moves of the run file."""
        from streamkit.builtin.samplers.ensemble.walk import walk  # emcee and SciPy are slow to load

        return walk(self.moves, target, ensemble)

    def learning_steps(self, chain: Array) -> int:
        """Return the steps in which the surrogate is learned."""
        return learning_steps(self.moves, chain)

    def reject_dimension(self, d: int) -> str:
        """Require twice as many walkers as parameters."""
        if self.walkers >= 2 * d:
            return ""
        return f"walkers: found {self.walkers}, expected at least {2 * d}, twice the number of free parameters"

    def quick_settings(self, d: int) -> dict[str, int | float]:
        """Take few walkers."""
        return {"walkers": min(self.walkers, max(QUICK_WALKERS, 2 * d + 2))}

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
