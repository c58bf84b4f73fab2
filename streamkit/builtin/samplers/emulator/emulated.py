"""The emulated posterior: a density that costs next to nothing, and samples of it at several temperatures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.coordinates import Space
from streamkit.builtin.samplers.emulator.emulator import Emulator
from streamkit.builtin.samplers.emulator.walk import choose, walk

# Most densities that are computed at a time: more need memory, and are no faster.
PART = 4096


@dataclass(frozen=True)
class Emulated:
    """The posterior with an emulator in place of the model.

    Attributes
    ----------
    noise
        Whether the variance of one call is part of the likelihood.
    """

    space: Space
    emulator: Emulator
    noise: bool

    def ln_likelihood(self, y: Array, fit_error: bool = True) -> Array:
        """(n,) ln likelihood at coordinates y (n, d), with or without the emulator's own error."""
        parts = [y[i : i + PART] for i in range(0, len(y), PART)]
        return np.concatenate(
            [self.emulator.ln_likelihood(part, self.space.back(part), self.noise, fit_error) for part in parts]
        )

    def ln_density(self, y: Array, inverse_temperature: float = 1.0) -> Array:
        """(n,) ln density at coordinates y (n, d), the likelihood to the power of the inverse temperature."""
        lnp = self.space.ln_prior(y)
        inside = np.isfinite(lnp)
        if inside.any():
            lnp[inside] += inverse_temperature * self.ln_likelihood(y[inside])
        return np.where(np.isnan(lnp), -np.inf, lnp)

    def sample(self, pool: Array, walkers: int, steps: int, seed: list[int], inverse_temperature: float = 1.0) -> Array:
        """(steps, w, d) Walk from places of a pool (n, d), drawn by their density."""

        def density(y: Array) -> Array:
            return self.ln_density(y, inverse_temperature)

        rng = np.random.default_rng(seed)
        values = density(pool)
        pool, values = pool[np.isfinite(values)], values[np.isfinite(values)]
        start = pool[choose(values, walkers, rng)]
        chain, _ = walk(density, start, steps, seed)
        return chain
