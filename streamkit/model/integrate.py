"""Integrate particles from their release to today, block by block, and keep their records.

An integrator only advances particles over a block. Release, winding, phase chi and stripping time are kept here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamkit.components import Integrator
from streamkit.engine import Field, record
from streamkit.errors import blamed
from streamkit.model.blocks import block_edges, with_edges
from streamkit.model.records import Records, begin_records
from streamkit.model.release import Start
from streamkit.stream import Array


def integrate(
    field: Field, integrator: Integrator, start: Start, encounters: Sequence[tuple[float, float]] = ()
) -> Records:
    """Advance particles from their release, at increasing times, to the end of the progenitor's track.

    Blocks are shorter about the ``encounters``, which have a time and a duration, if the integrator needs that.
    """
    orbit, released = start.orbit, start.at_release
    t_release = released.t
    q, v, now = start.q.copy(), start.v.copy(), t_release.copy()
    edges = block_edges(orbit, integrator)
    if not integrator.resolves_passages:
        for time, duration in encounters:
            edges = with_edges(edges, time, duration)
    at_edges = orbit.at(edges)
    states = np.ascontiguousarray(np.concatenate([at_edges.q, at_edges.v, at_edges.a]).T)
    plane, offset, swept, records = begin_records(orbit, released, q, v, np.int64)

    def update(m: int, t1: float, state: Array, r_tidal: float) -> None:
        field.spread(
            m, lambda piece, _: record(piece.start, piece.stop, now, t1, q, v, state, r_tidal, plane, records)
        )  # fmt: skip

    active = np.searchsorted(t_release, edges[1:], side="left")
    for t1, state, r_tidal, m in zip(edges[1:], states[1:], at_edges.r_tidal[1:], active, strict=True):
        with blamed(f"integrator {integrator.kind}"):
            integrator.advance(field, q[:, :m], v[:, :m], now[:m], t1)
        update(m, t1, state, r_tidal)

    turned = offset + np.arctan2(records.planar[1], records.planar[0])
    winding = turned + 2 * np.pi * records.revolutions - swept
    return Records(
        q, v, records.t_strip, records.dq_strip, records.dv_strip, winding, records.chi, bound=records.gap <= 0
    )
