"""A host that another code has expanded, as the table of a `multipole` potential, and how far it can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from streamkit import Array
from streamkit_hosts.compare import LIMIT, POINTS, median_change, places
from streamkit_hosts.table import PRECISION, check_rows, close_radii, force_of, table_of

INNERMOST = 0.01  # kpc: the first radius of a table
SAME = 1e-9  # of the largest: a harmonic that is smaller everywhere is left out


@dataclass(frozen=True)
class Expansion:
    """Phi_lm(r, t) of a host as another code has it, with units of streamkit.

    ``phi(r)`` returns (T, h, k) in (km/s)^2 at radii (k,) in kpc from ``first`` to ``last``; the first harmonic is the
    mean. ``cuts`` are the same with fewer terms, by the name of what was left out.
    """

    times: Array  # (T,) in Gyr, 0 today
    harmonics: list[tuple[int, int]]
    phi: Callable[[Array], Array]
    first: float
    last: float
    cuts: dict[str, Callable[[Array], Array]] = field(default_factory=dict)
    said: tuple[str, ...] = ()  # what the reader has to say
    path: dict[str, list[float]] = field(default_factory=dict)  # the columns of `centre`; none for a host at rest


@dataclass(frozen=True)
class Imported:
    """A table of multipoles from the files of another code, with its errors."""

    table: Any
    times: Array  # (T,) in Gyr, 0 today
    radii: Array  # (k,) in kpc
    harmonics: list[tuple[int, int]]
    # Median relative change of the force without some terms, between the radii of the streams.
    changes: dict[str, float]
    said: tuple[str, ...]

    def warnings(self) -> list[str]:
        """Return a sentence for each reason not to trust the table."""
        return [
            *self.said,
            *(
                f"the expansion does not converge at the radii of the streams: without {what} the force changes by "
                f"{change:.1%}. Its own code would give another force with more terms"
                for what, change in self.changes.items()
                if change > LIMIT
            ),
        ]


def tabulated(source: Expansion, between: tuple[float, float], precision: float = PRECISION) -> Imported:
    """Return the table of a host; its convergence is judged between two radii in kpc, those of the streams.

    Its radii are so close that splines have the radial force to ``precision``.

    Raises StreamkitError with a sentence for a table that would be too large.
    """
    first = max(source.first, min(INNERMOST, 0.5 * source.last))
    check_rows(
        len(source.times) * len(source.harmonics), f"{len(source.times)} times at one radius", "take a lower --l-max"
    )
    radii, phi = close_radii(source.phi, first, source.last, precision)
    size = np.abs(phi).max(axis=(0, 2))
    kept = np.flatnonzero((size > SAME * size[0]) | (np.arange(len(size)) == 0))
    harmonics = [source.harmonics[h] for h in kept]
    check_rows(
        len(source.times) * len(kept) * len(radii),
        f"{len(source.times)} times, {len(kept)} harmonics, {len(radii)} radii",
        "take a lower --l-max, fewer times by --every, or a larger --precision",
    )
    said = list(source.said)
    if source.last < between[1] or source.first > between[0]:
        said.append(
            f"the expansion is known from {source.first:.3g} to {source.last:.3g} kpc, not at all radii of the streams "
            f"({between[0]:g} to {between[1]:g} kpc): there is no mass outside, and powers of r continue it inside"
        )
    low, high = max(between[0], radii[0]), min(between[1], radii[-1])
    place = places(min(low, 0.9 * high), high, seed=POINTS)
    some = np.unique([0, len(source.times) // 2, len(source.times) - 1])
    changes = {
        what: max(_change(phi[k], cut[k], radii, source.harmonics, place) for k in some)
        for what, cut in ((what, cut_phi(radii)) for what, cut_phi in source.cuts.items())
    }
    table = table_of(source.times, radii, harmonics, phi[:, kept])
    return Imported(table, source.times, radii, harmonics, changes, tuple(said))


def _change(phi: Array, cut: Array, radii: Array, harmonics: list[tuple[int, int]], place: Array) -> float:
    whole, low = (force_of(each, radii, harmonics, place) for each in (phi, cut))
    return median_change(whole, low, whole)
