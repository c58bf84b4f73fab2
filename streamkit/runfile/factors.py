"""The factors of a likelihood: each stream's data depend on the host and on parameters of that stream alone.

A free parameter below ``stream.NAME.``, or of a body that flies past that stream, belongs to it, one below ``data.`` to
the host's data, and every other one (of the potential, the other bodies, the Sun, the integrator) is shared by all of
them. A run file has no other way to couple two streams: no progenitor moves another one, and a perturber of several
streams is a body of the host.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from streamkit.runfile.encounter import ENCOUNTER
from streamkit.runfile.inputs import ONLY
from streamkit.stream import IntArray

OF_A_STREAM = ("progenitor", "stripping", "observable")  # the sections of each stream
SEEN = "observable"  # the section with the data of a stream
DATA = "[data]"  # the name of the factor of the data of the host: a TOML key of a stream has no brackets


@dataclass(frozen=True, eq=False)
class Factor:
    """A part of the likelihood, with the parameters that decide it.

    Attributes
    ----------
    name
        The name of its stream; `DATA` for the data of the host.
    shared, own
        Indices of the free parameters of the whole run file: those that other factors depend on too, and its own.
    """

    name: str
    shared: IntArray
    own: IntArray

    @property
    def parameters(self) -> IntArray:
        """Indices of all parameters that it depends on, in the order of the run file."""
        return np.sort(np.concatenate([self.shared, self.own]))


def factors_of(
    names: Sequence[str], streams: Sequence[str], data: Collection[str], met: Mapping[str, str]
) -> tuple[Factor, ...]:
    """Return the factors of a run file with these free parameters, streams and data of the host.

    ``met`` has the stream of each body that flies past one.

    One stream is one factor, which has the data of the host too. Of several streams each is a factor, and the data of
    the host are another one.
    """
    every = np.arange(len(names))
    if len(streams) == 1:
        return (Factor(streams[0], every[:0], every),)
    return parts_of(names, streams, data, met)


def parts_of(
    names: Sequence[str], streams: Sequence[str], data: Collection[str], met: Mapping[str, str]
) -> tuple[Factor, ...]:
    """Return each stream, of one or of several, and the data of the host as factors of their own."""
    every = np.arange(len(names))
    prefixes: dict[str, tuple[str, ...]] = {name: (f"stream.{name}.",) for name in streams if name != ONLY}
    if ONLY in streams:
        prefixes = {ONLY: tuple(f"{section}." for section in OF_A_STREAM)}
    for body, stream in met.items():
        prefixes[stream] += (f"body.{body}.",)
    prefixes |= {DATA: ("data.",)} if data else {}
    own = [(name, every[[each.startswith(prefix) for each in names]]) for name, prefix in prefixes.items()]
    shared = np.setdiff1d(every, np.concatenate([each for _, each in own]))
    return tuple(Factor(name, shared, each) for name, each in own)


def part(document: Mapping[str, Any], streams: Collection[str], data: bool, observables: bool) -> dict[str, Any]:
    """Return a document with these of its streams alone, with the data of the host and observables or without them."""
    kept = {key: value for key, value in document.items() if (data or key != "data") and (observables or key != SEEN)}
    if ONLY in streams:
        return kept
    tables = {name: table for name, table in document["stream"].items() if name in streams}
    bodies = {
        name: body
        for name, body in document.get("body", {}).items()
        if ENCOUNTER not in body or body[ENCOUNTER].get("stream", ONLY) in {*streams, ONLY}
    }
    if not observables:
        tables = {name: {key: v for key, v in table.items() if key != SEEN} for name, table in tables.items()}
    return kept | {"stream": tables} | ({"body": bodies} if "body" in document else {})
