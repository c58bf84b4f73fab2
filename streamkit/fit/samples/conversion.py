"""Samples in the forms of other libraries: columns of a table, and an xarray DataTree as ArviZ reads it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from streamkit.distribution import VERSION
from streamkit.fit.judge.goodness import Sampled
from streamkit.fit.samples.draws import Draws
from streamkit.observe import ln_likelihood_of_each, new_data
from streamkit.runfile import Spec
from streamkit.stream import Array, Data

if TYPE_CHECKING:
    from xarray import DataTree


def sample_columns(spec: Spec, draws: Draws) -> dict[str, Array]:
    """Return the columns (n,) of a table of samples after burn-in: walker, step (from 1), parameters, ln posterior."""
    steps, walkers, d = draws.kept.shape
    step, walker = np.mgrid[draws.discard + 1 : draws.discard + steps + 1, :walkers]
    return {
        "walker": walker.ravel(),
        "step": step.ravel(),
        **dict(zip(spec.names, draws.kept.reshape(-1, d).T, strict=True)),
        "ln_posterior": draws.log_prob[draws.discard :].ravel(),
    }


def arviz_tree(spec: Spec, draws: Draws, data: Data, drawn: Replicates | None) -> DataTree:
    """Return samples as ArviZ reads them, each walker a chain: see `Results.to_arviz`.

    ``data`` are the run's data, ``drawn`` new data for some of the samples.
    """
    import arviz_base  # slow to load

    names, kept, log_prob, blobs = spec.names, draws.kept, draws.log_prob[draws.discard :], draws.predictions
    groups: dict[str, dict[str, Array]] = {
        "posterior": {name: kept[..., i].T for i, name in enumerate(names)},
        "sample_stats": {"lp": log_prob.T},
        "constant_data": {"value": data.values, "error": data.errors},
    }
    if blobs is not None:
        groups["sample_stats"]["ln_likelihood"] = blobs["ln_likelihood"].T
        groups["predictions"] = {name: np.swapaxes(blobs[name], 0, 1) for name in ("mean", "variance")}
    datum = {name: ["datum"] for name in ("value", "error", "mean", "variance")}
    coordinates: dict[str, list[str]] = {}
    if drawn is not None:
        for name, labels in drawn.names.items():
            datum[name], coordinates[f"{name} datum"] = [f"{name} datum"], list(labels)
        groups["observed_data"] = drawn.data
        groups["posterior_predictive"] = {name: values[None] for name, values in drawn.drawn.items()}
        if drawn.labels:
            groups["log_likelihood"] = {"data": drawn.ln_likelihood[None]}
            datum["data"], coordinates["data datum"] = ["data datum"], list(drawn.labels)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Found chain dimension", UserWarning)  # a short chain may have more walkers
        tree: DataTree = arviz_base.from_dict(groups, dims=datum, pred_dims=datum, coords=coordinates)
    for name, unit in zip(names, spec.units, strict=True):
        tree["posterior"][name].attrs["units"] = unit
    tree.attrs.update({
        "created_by": f"streamkit {VERSION}",
        "digest": spec.digest(),
        "burn_in": draws.discard,
    })
    return tree


DRAWS = 500  # number of samples with new data


@dataclass(frozen=True)
class Replicates:
    """The data of each quantity by its name, with the new data and likelihoods of some samples."""

    # (n,) names and values of the data of each quantity.
    names: dict[str, tuple[str, ...]]
    data: dict[str, Array]
    drawn: dict[str, Array]  # (k, n) new data of k samples, for quantities of which they can be drawn
    labels: tuple[str, ...]  # (m,) names of all data with a separate likelihood
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
