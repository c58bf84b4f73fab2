"""A fit as text for a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from streamkit.report import columns, paragraph, warning_list
from streamkit.stream import Array
from streamkit.study.fit.figures import reach
from streamkit.study.fit.results import Results

if TYPE_CHECKING:
    from astropy.table import QTable


def stuck_warnings(stuck: Sequence[int], walkers: int) -> list[str]:
    """Return a warning that names stuck walkers and the remedy; none without any."""
    if not stuck:
        return []
    which = ", ".join(str(walker) for walker in stuck)
    return [
        f"{len(stuck)} of {walkers} walkers are stuck (number {which}): their ln p stays far below the "
        "others', and they hardly move. The intervals are too wide for them. Continue with --resume and a larger "
        "--steps; if they stay, the likelihood is too rough: take more particles, or noise = 'add', and start again."
    ]


# Radii in kpc of the masses that a run prints: those of Gibbons+ 2014, table 3.
PRINTED_RADII = (50.0, 100.0, 150.0, 200.0)
# Smaller ones, which are printed where the streams or the data reach them.
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
    summary, profile = results.summary(), results.mass_profile(radii)
    rows = [("parameter", "median", "68 %", "95 %", "unit", "tau", "n_eff")]
    rows += [
        (
            row["parameter"], f"{row['median']:.4g}", _interval(row, 68), _interval(row, 95),
            row["unit"] or "-", _or_dash(row["autocorrelation_time"]), _or_dash(n_eff),
        )
        for row, n_eff in zip(summary, draws.trusted_ess, strict=True)
    ]  # fmt: skip
    masses = [("r", "M(<r)", "68 %", "95 %", "in 1e11 Msun")]
    masses += [
        (
            f"{r:g} kpc", f"{m[0]:.3g}", f"{m[1]:.3g} to {m[2]:.3g}", f"{m[3]:.3g} to {m[4]:.3g}",
            "" if r in inside else "extrapolated: beyond the data and the best stream",
        )
        for r, m in zip(radii, _masses(profile), strict=True)
    ]  # fmt: skip
    calls = draws.rows()
    if np.isfinite(results.r_hat).any():
        worst = int(np.nanargmax(results.r_hat))
        calls.append(("R-hat", f"{results.r_hat[worst]:.3f}", f"the largest: of {results.names[worst]}"))
    calls += [("rejected", str(n), reason) for reason, n in Counter(results.reasons).most_common()]
    if draws.weighted is None:
        calls += [("stuck", str(len(results.stuck)), f"of {results.chain.shape[1]} walkers")]
    parts = [f"{draws.headline}\n{paragraph(results.note())}", f"parameters\n{columns(rows)}"]
    parts += [f"mass of the host\n{columns(masses)}", f"sampler\n{columns(calls)}"]
    if results.fit is not None:
        parts.insert(2, f"fit to the data, at the best sample\n{columns(_goodness(results))}")
    if warnings := stuck_warnings(results.stuck.tolist(), results.chain.shape[1]):
        parts.append(warning_list(warnings))
    if results.directory is not None:
        names = sorted(path.name for path in results.directory.iterdir() if not path.name.startswith("."))
        parts.append(paragraph(", ".join(names), f"products in {results.directory}: ", "  "))
    return "\n\n".join(parts)


def _goodness(results: Results) -> list[tuple[str, ...]]:
    rows = [("quantity", "data", "chi^2", "p", "worst datum", "data - model")]
    return rows + [
        (
            row["quantity"], f"{row['data']}", f"{row['chi2']:.1f}", f"{row['p']:.2g}", row["worst"],
            f"{row['residual']:+.1f} sigma",
        )
        for row in results.goodness()
    ]  # fmt: skip


def _or_dash(value: float) -> str:
    return f"{value:.0f}" if np.isfinite(value) else "-"


def _interval(row: Any, percent: int) -> str:
    return f"{row[f'lo{percent}']:.4g} to {row[f'hi{percent}']:.4g}"


def _masses(profile: QTable) -> Array:
    """(nr, 5) Median and the ends of the 68 % and 95 % intervals, in 1e11 Msun."""
    names = ("M", "M_lo68", "M_hi68", "M_lo95", "M_hi95")
    return np.stack([profile[name].to_value("Msun") for name in names], axis=1) / 1e11
