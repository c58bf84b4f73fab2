"""Samples in the forms of other libraries: columns, a pandas DataFrame, an xarray DataTree as ArviZ reads it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from streamkit.stream import Array, Data
from streamkit.study.fit.replicates import Replicates

if TYPE_CHECKING:
    import pandas as pd
    from xarray import DataTree


def sample_columns(names: Sequence[str], kept: Array, log_prob: Array, discard: int) -> dict[str, Array]:
    """Return the columns (n,) of a table of samples: walker, step (from 1), the parameters, ln posterior."""
    steps, walkers, d = kept.shape
    step, walker = np.mgrid[discard + 1 : discard + steps + 1, :walkers]
    flat = kept.reshape(-1, d)
    columns = {"walker": walker.ravel(), "step": step.ravel()}
    return {**columns, **dict(zip(names, flat.T, strict=True)), "ln_posterior": log_prob[discard:].ravel()}


def sample_frame(names: Sequence[str], kept: Array, log_prob: Array, discard: int) -> pd.DataFrame:
    """Return the table of `sample_columns` as a pandas DataFrame."""
    import pandas as pd  # slow to load

    return pd.DataFrame(sample_columns(names, kept, log_prob, discard))


def arviz_tree(
    names: Sequence[str],
    units: Sequence[str],
    kept: Array,
    log_prob: Array,
    blobs: Any,
    data: Data,
    attributes: Mapping[str, str | int | float],
    drawn: Replicates | None = None,
) -> DataTree:
    """Return samples as ArviZ reads them, each walker a chain: see `Results.to_arviz`.

    ``kept`` are the samples (steps, walkers, d) after burn-in, ``log_prob`` and ``blobs`` (steps, walkers) their ln
    posterior and stored records, ``drawn`` new data of some of the samples.
    """
    import arviz_base  # slow to load

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
    for name, unit in zip(names, units, strict=True):
        tree["posterior"][name].attrs["units"] = unit
    tree.attrs.update(attributes)
    return tree
