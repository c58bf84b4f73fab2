"""New data that the samples predict, and the ln likelihood of each datum, as ArviZ reads them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit.observe import ln_likelihood_of_each, new_data
from streamkit.stream import Array
from streamkit.study.fit.goodness import Sampled

DRAWS = 500  # samples that new data are drawn for


@dataclass(frozen=True)
class Replicates:
    """The data of each quantity by its name, with what some samples say of them."""

    # (n,) names and values of the data of each quantity.
    names: dict[str, tuple[str, ...]]
    data: dict[str, Array]
    drawn: dict[str, Array]  # (k, n) new data of k samples; without a quantity of which none can be drawn
    labels: tuple[str, ...]  # (m,) names of all data that have a likelihood of their own
    ln_likelihood: Array  # (k, m) their ln likelihoods


def replicates(sampled: Sampled) -> Replicates | None:
    """Return new data and ln likelihoods for at most `DRAWS` samples, evenly spaced; None without any.

    Random numbers come from the run's seed.
    """
    samples = [*sampled.at_samples(DRAWS)]
    if not samples:
        return None
    rng = np.random.default_rng([sampled.spec.seed, 2])
    drawn: dict[str, list[Array]] = {}
    each: list[list[Array]] = []
    for measured in samples:
        each.append([])
        for one in measured:
            ln_each = ln_likelihood_of_each(one.measurement, one.prediction, one.data)
            if ln_each is not None:
                each[-1].append(ln_each[one.rows])
            values = new_data(one.measurement, one.prediction, one.data, rng)
            for name, rows in one.quantities() if values is not None else ():
                drawn.setdefault(name, []).append(values[rows])  # type: ignore[index]  # not None here
    first = samples[0]
    quantities = [(one, name, rows) for one in first for name, rows in one.quantities()]
    judged = [one for one in first if ln_likelihood_of_each(one.measurement, one.prediction, one.data) is not None]
    return Replicates(
        {name: one.labels(rows) for one, name, rows in quantities},
        {name: one.data.values[rows] for one, name, rows in quantities},
        {name: np.array(rows) for name, rows in drawn.items() if len(rows) == len(samples)},
        tuple(label for one in judged for label in one.labels(one.rows)),
        np.array([np.concatenate(row) if row else np.empty(0) for row in each]),
    )
