"""The probability of each star of a catalogue to be a member of its stream, averaged over the posterior, as a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from astropy import units as u
from astropy.table import Column, QTable, vstack

from streamkit.fit.judge.goodness import Measured, Sampled
from streamkit.runfile import Spec
from streamkit.stream import Array, Prediction

MOST = 100  # samples over which a probability is averaged


@runtime_checkable
class HasMembers(Protocol):
    """An observable that compares single stars, some of which are not of the stream."""

    def membership_of_parts(self, prediction: Prediction) -> Array:
        """(P, N) Return the probability of each star to be of each part of the stream, the thin stream first."""

    def places(self) -> Mapping[str, tuple[Array, str]]:
        """Return what identifies the stars, (N,) each with its unit: ra and dec, and what is compared."""

    def over_stars(self, prediction: Prediction) -> Mapping[str, tuple[str, Array, Array, Array]]:
        """Return by column its label, longitudes (K,), and the mean and the width of the stream there for a picture."""


def has_members(spec: Spec) -> bool:
    """Return whether an observable of a run file compares single stars."""
    streams = spec.sections.streams.values()
    return any(isinstance(each.centre, HasMembers) for stream in streams for each in stream.observables.values())


def members_table(sampled: Sampled | None) -> QTable:
    """Return a row for each star of each catalogue, in their order; `streamkit.Results.members` has the columns."""
    found: dict[str, list[Array]] = {}
    last: dict[str, Measured] = {}
    for _, measured in () if sampled is None else sampled.each(MOST):
        for each in measured:
            if isinstance(each.measurement, HasMembers):
                found.setdefault(each.name, []).append(each.measurement.membership_of_parts(each.prediction))
                last[each.name] = each
    return (
        vstack([_table(each.stream, each.measurement, found[name]) for name, each in last.items()])
        if last
        else QTable()
    )


def _table(stream: str, stars: object, chances: list[Array]) -> QTable:
    """Return the rows of one catalogue, with chances (P, N) by sample."""
    assert isinstance(stars, HasMembers)  # noqa: S101  asked for above
    of_parts = np.array([chance if len(chance) > 1 else np.vstack([chance, 0 * chance]) for chance in chances])
    of_stream = of_parts.sum(axis=1)
    table = QTable({name: column * u.Unit(unit) for name, (column, unit) in stars.places().items()})
    table.add_column(Column([stream] * len(table), dtype=str), name="stream", index=0)
    table["p_member"], table["p_member_sd"] = of_stream.mean(axis=0), of_stream.std(axis=0)
    table["p_cocoon"] = of_parts[:, 1].mean(axis=0)
    return table
