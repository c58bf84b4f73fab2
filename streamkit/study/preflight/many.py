"""Many streams in the text of a preflight: one line for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

import numpy as np

from streamkit import report
from streamkit.observe import scatter_of
from streamkit.runfile import Spec

if TYPE_CHECKING:
    from streamkit.study.preflight.preflight import Look, Preflight

FEW = 6  # largest number of streams that are shown in full


def are_many(spec: Spec) -> bool:
    """Return whether a run file has more streams than a terminal shows in full."""
    return len(spec.streams) > FEW


def component_rows(spec: Spec) -> Iterator[tuple[str, str, str]]:
    """Yield path, kind and supplier of the components; of many streams those of one kind together."""
    same: dict[tuple[str, str, str], int] = {}
    for path, cls, supplier in spec.components():
        top, _, below = path.partition(".")
        shown = f"stream.*.{below.partition('.')[2]}" if top == "stream" and are_many(spec) else path
        same[shown, cls.kind, supplier] = same.get((shown, cls.kind, supplier), 0) + 1
    for (path, kind, supplier), count in same.items():
        yield path, kind, f"{supplier}, of {count} streams" if path.startswith("stream.*") else supplier


def without_names(reasons: Counter[str], streams: Collection[str]) -> Counter[str]:
    """Return the reasons why streams cannot be measured; the same one of many streams together."""
    if len(streams) <= FEW:
        return reasons
    same: Counter[str] = Counter()
    for reason, count in reasons.items():
        name, colon, why = reason.partition(": ")
        same[why if colon and name in streams else reason] += count
    return same


def stream_table(spec: Spec, preflight: Preflight, place: str) -> str:
    """Return a table with a row for each stream.

    Its columns are the number of free parameters, the ends of the progenitor's orbit in kpc, the look-back time in
    radial periods, the number of data, the median and the largest of their distances from the stream in standard
    deviations of the likelihood, and how many draws from the prior have a stream that can be measured.
    """
    tried = preflight.prior_draws
    own = {factor.name: len(factor.own) for factor in spec.factors}
    rows = [("stream", "free", "pericentre", "apocentre", "periods", "data", "median", "largest", "measured")]
    for name, look in preflight.streams.items():
        measured = f"{tried.measured(name)} of {tried.draws}" if tried is not None else "-"
        rows.append((name, str(own[name]), *_orbit(look), *_data(look), measured))
    note = (
        "free: parameters of its own. pericentre, apocentre: kpc, the last ones. periods: radial ones in the look-back "
        "time. median, largest: distances of the data from the stream, in errors. measured: draws from the prior"
    )
    return f"streams, at {place}\n{report.columns(rows)}\n{report.paragraph(note, '  ')}"


def _orbit(look: Look) -> tuple[str, str, str]:
    ends = [f"{radii[0]:.3g}" if len(radii) else "none" for radii in (look.orbit.pericentres, look.orbit.apocentres)]
    period = look.orbit.period
    return ends[0], ends[1], f"{look.inputs.lookback / period:.1f}" if np.isfinite(period) else "-"


def _data(look: Look) -> tuple[str, str, str]:
    observables = list(look.inputs.observables.values())
    if not observables:
        return "0", "-", "-"
    values = np.concatenate([each.data()[0] for each in observables])
    count = str(int(np.isfinite(values).sum()))
    if look.prediction is None or look.prediction.why_not:
        return count, "none", "none"
    away = np.abs(look.prediction.mean - values) / scatter_of(observables, look.prediction)
    return count, f"{np.nanmedian(away):.1f}", f"{np.nanmax(away):.1f}"
