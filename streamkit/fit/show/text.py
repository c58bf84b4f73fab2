"""A fit as text for a terminal, and as plain values for programs."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from streamkit.errors import printable
from streamkit.fit.judge.chain import stuck_verdict
from streamkit.fit.samples.results import Results
from streamkit.fit.samples.tables import LEVELS
from streamkit.fit.show.figures import are_too_many, parameters_of, reach
from streamkit.report import columns, contents, paragraph, table_record, warning_list

OF_A_STREAM = ("stream ", "data of the host")  # how a sampler's facts about one of several streams are called
# Radii in kpc of the printed masses, as in table 3 of Gibbons+ 2014.
PRINTED_RADII = (50.0, 100.0, 150.0, 200.0)
# Smaller radii, which are printed where the streams or the data reach them.
INNER_RADII = (5.0, 10.0, 20.0, 30.0)


def radii_in_reach(results: Results) -> list[float]:
    """Return the radii in kpc of a table of masses that the best stream or the data reach."""
    low, high = reach(results)
    return [r for r in (*INNER_RADII, *PRINTED_RADII) if low <= r <= high]


def radii_to_show(results: Results) -> list[float]:
    """Return the radii in kpc of the masses that the page and the terminal show."""
    inside = radii_in_reach(results)
    return [*(r for r in INNER_RADII if r in inside), *PRINTED_RADII]


def describe_results(results: Results) -> str:
    """Return a run as text: its convergence, the parameters, the masses, the counts of its calls."""
    draws = results.draws
    inside = radii_in_reach(results)
    radii = radii_to_show(results)
    chain = draws.weighted is None  # weighted samples have no steps
    shown, _, _, _ = parameters_of(results)
    hidden = len(results.names) - len(shown)
    rows = [("parameter", "median", "68 %", "95 %", "unit", *(("tau", "n_eff") if chain else ()))]
    rows += [
        (
            row["parameter"], f"{row['median']:.4g}", _interval(row, 68), _interval(row, 95), row["unit"] or "-",
            *((_or_dash(row["autocorrelation_time"]), _or_dash(n_eff)) if chain else ()),
        )
        for row, n_eff in zip(results.summary()[shown], draws.trusted_ess[shown], strict=True)
    ]  # fmt: skip
    rows = _without_empty(rows)
    masses = [("r", "M(<r)", "68 %", "95 %", "in 1e11 Msun")]
    for r, row in zip(radii, results.mass_profile(radii), strict=True):
        m = {level: f"{row[f'M_{level}'.rstrip('_')].to_value('1e11 Msun'):.3g}" for level in LEVELS}
        remark = "" if r in inside else "extrapolated: beyond the data and the best stream"
        masses.append((f"{r:g} kpc", m[""], f"{m['lo68']} to {m['hi68']}", f"{m['lo95']} to {m['hi95']}", remark))
    calls = draws.rows()
    if np.isfinite(results.r_hat).any():
        worst = int(np.nanargmax(results.r_hat))
        calls.append(("R-hat", f"{results.r_hat[worst]:.3f}", f"the largest: of {results.names[worst]}"))
    calls += [("rejected", str(n), reason) for reason, n in Counter(results.reasons).most_common()]
    if chain:
        walkers = f"of {results.chain.shape[1]} walkers"
        numbers = f": {', '.join(map(str, results.stuck))}" if len(results.stuck) else ""
        calls += [("stuck", str(len(results.stuck)), f"{walkers}{numbers}")]
    parts = [f"{draws.headline}\n{paragraph(results.note())}", f"parameters\n{columns(rows)}"]
    parts[1] += f"\n  {hidden} more, of one stream each, in summary.ecsv" if hidden else ""
    parts += [f"mass of the host\n{columns(masses)}", f"sampler\n{columns(calls)}"]
    if results.fit is not None:
        parts.insert(2, f"fit to the data, at the best sample\n{columns(_goodness(results))}")
        parts[2] += f"\n\nstreams\n{columns(_of_streams(results))}" if len(results.spec.streams) > 1 else ""
    if len(results.stuck):
        parts.append(warning_list([stuck_verdict(len(results.stuck), results.chain.shape[1]).sentence]))
    if results.directory is not None:
        names = [printable(name) for name in contents(results.directory)]
        parts.append(paragraph(", ".join(names), f"products in {results.directory}: ", "  "))
    return "\n\n".join(parts)


def _without_empty(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return rows without the columns that have only a dash below their head."""
    kept = [i for i in range(len(rows[0])) if any(row[i] != "-" for row in rows[1:]) or len(rows) == 1]
    return [tuple(row[i] for i in kept) for row in rows]


def _goodness(results: Results) -> list[tuple[str, ...]]:
    """Return the rows of all quantities; of many streams only that of all data, as each stream has a row."""
    rows = [("quantity", "data", "chi^2", "p", "worst datum", "data - model")]
    table = results.goodness()
    return rows + [_fitted(row, "quantity") for row in (table[-1:] if are_too_many(results) else table)]


def _of_streams(results: Results) -> list[tuple[str, ...]]:
    """Return a row for each of several streams."""
    rows = [("stream", "data", "chi^2", "p", "worst datum", "data - model")]
    return rows + [_fitted(row, "stream") for row in results.streams()]


def _fitted(row: Any, called: str) -> tuple[str, ...]:
    return (
        row[called], f"{row['data']}", f"{row['chi2']:.1f}", f"{row['p']:.2g}", row["worst"],
        f"{row['residual']:+.1f} sigma",
    )  # fmt: skip


def _or_dash(value: float) -> str:
    return f"{value:.0f}" if np.isfinite(value) else "-"


def _interval(row: Any, percent: int) -> str:
    return f"{row[f'lo{percent}']:.4g} to {row[f'hi{percent}']:.4g}"


def results_record(results: Results) -> dict[str, Any]:
    """Return the verdict on a run, its parameters, the masses, and the counts of its calls.

    Keys: directory, digest, status, quick, converged, note, verdict ("fine", "look here" or "do not use"), steps,
    walkers, burn_in, acceptance, calls, search_calls, rejected (by reason), stuck (numbers of walkers), r_hat (the
    largest), effective_samples (the least), goodness, streams, parameters and mass_profile (``rows``, and ``units`` by
    column). For weighted samples there are weighted_samples, ln_evidence and ln_evidence_error in place of steps,
    walkers and burn_in.
    """
    return {
        "directory": None if results.directory is None else str(results.directory),
        "digest": results.spec.digest(),
        "status": results.status,
        "quick": results.quick,
        "converged": results.converged,
        "note": results.note(),
        "verdict": results.verdict,
        **results.draws.record(),
        "acceptance": results.acceptance,
        "calls": results.calls,
        "search_calls": results.search_calls,
        "rejected": results.reasons,
        "stuck": results.stuck,
        "r_hat": float(np.max(results.r_hat)),
        "effective_samples": float(np.min(results.ess)),
        "goodness": table_record(results.goodness()),
        "streams": table_record(results.streams()),
        "parameters": table_record(results.summary()),
        "mass_profile": table_record(results.mass_profile(PRINTED_RADII)),
    }
