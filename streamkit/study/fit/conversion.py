"""Samples in the forms of other libraries: columns of a table, and an xarray DataTree as ArviZ reads it."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from streamkit.distribution import VERSION
from streamkit.stream import Array, Data
from streamkit.study.fit.replicates import Replicates

if TYPE_CHECKING:
    from xarray import DataTree

    from streamkit.study.fit.results import Results


def sample_columns(results: Results) -> dict[str, Array]:
    """Return the columns (n,) of a table of samples after burn-in: walker, step (from 1), parameters, ln posterior."""
    steps, walkers, _ = results.kept.shape
    step, walker = np.mgrid[results.discard + 1 : results.discard + steps + 1, :walkers]
    return {
        "walker": walker.ravel(),
        "step": step.ravel(),
        **dict(zip(results.names, results.samples.T, strict=True)),
        "ln_posterior": results.log_prob[results.discard :].ravel(),
    }


def arviz_tree(results: Results, data: Data, drawn: Replicates | None) -> DataTree:
    """Return samples as ArviZ reads them, each walker a chain: see `Results.to_arviz`.

    ``data`` are those of the run, ``drawn`` new data of some of the samples.
    """
    import arviz_base  # slow to load

    names, kept, log_prob = results.names, results.kept, results.log_prob[results.discard :]
    blobs = None if results.blobs is None else results.blobs[results.discard :]
    groups: dict[str, dict[str, Array]] = {
        "posterior": {name: kept[..., i].T for i, name in enumerate(names)},
        "sample_stats": {"lp": log_prob.T},
        "constant_data": {"value": data.values, "error": data.errors},
    }
    if blobs is not None and blobs.dtype.names and "mean" in blobs.dtype.names:
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
    for name, unit in zip(names, results.spec.units, strict=True):
        tree["posterior"][name].attrs["units"] = unit
    tree.attrs.update({
        "created_by": f"streamkit {VERSION}",
        "digest": results.spec.digest(),
        "note": results.note(),
        "converged": int(results.converged),
        "burn_in": results.discard,
    })
    return tree
