"""The products of a sensitivity: a table of every point, the slopes, the same for a terminal, and the picture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from astropy import units as u
from astropy.table import Column, QTable

from streamkit.report import columns, paragraph
from streamkit.study.grid import MANY, Products, by_column, rms
from streamkit.study.sensitivity.curves import CENTRAL
from streamkit.study.sensitivity.figure import sensitivity_figure
from streamkit.study.sensitivity.runner import Sensitivity


def points_table(response: Sensitivity) -> QTable:
    """Return one row per parameter and value: the observables' means over the seeds, scatter and own noise.

    Parameters have different units, so a plain column has the values, and the column ``unit`` their units.
    """
    curves = response.curves
    out = QTable()
    out["parameter"] = [curve.name for curve in curves for _ in curve.x]
    out["value"] = np.concatenate([curve.x for curve in curves])
    out["unit"] = [curve.unit or "1" for curve in curves for _ in curve.x]
    for i, (name, unit) in enumerate(zip(response.names, response.units, strict=True)):
        for suffix, part in (("", "mean"), ("_sd", "scatter"), ("_noise", "noise")):
            if suffix != "_sd" or response.seeds > 1:
                out[name + suffix] = np.concatenate([getattr(curve, part)[:, i] for curve in curves]) * u.Unit(unit)
    out["streams"] = np.concatenate([curve.streams for curve in curves])
    reasons = ["; ".join(f"{n} x {why}" for why, n in some.most_common()) for curve in curves for some in curve.reasons]
    why = "why there is no stream, or no value, and for how many of the seeds"
    out["reason"] = Column(reasons, description=why)
    return out


def slopes_table(response: Sensitivity) -> QTable:
    """Return one row per parameter: where it is fixed, one standard deviation of its prior, and the slopes there.

    For each observable: the derivative (its unit by the parameter's), the change per standard deviation of the
    prior at that slope, its standard error, and the same change in standard errors of the datum.
    """
    curves = response.curves
    out = QTable()
    out["parameter"] = [curve.name for curve in curves]
    out["value"] = [curve.fixed for curve in curves]
    out["unit"] = [curve.unit or "1" for curve in curves]
    sd = "half the central 68 % of the prior; of ln(value) for a log-uniform prior"
    out["sd"] = Column([curve.slope.sd for curve in curves], description=sd)
    for i, (name, unit, error) in enumerate(zip(response.names, response.units, response.data.errors, strict=True)):
        per_unit, per_sd, noise = (
            np.array([getattr(curve.slope, part)[i] for curve in curves]) for part in ("per_unit", "per_sd", "error")
        )
        out[f"{name}_slope"] = Column(per_unit, description=f"derivative, {unit or '1'} per unit of the parameter")
        out[f"{name}_per_sd"] = per_sd * u.Unit(unit)
        out[f"{name}_per_sd_error"] = noise * u.Unit(unit)
        pull = "change per sd of the prior, in standard errors of the datum"
        out[f"{name}_pull"] = Column(per_sd / error, description=pull)
    missing = [curve.missing for curve in curves]
    out["without"] = Column(missing, description="points of the curve without a value")
    return out


def describe_sensitivity(response: Sensitivity) -> str:
    """Show the slopes for a terminal, and why points have no value."""
    n, seeds = sum(len(curve.x) for curve in response.curves), response.seeds
    head = f"{len(response.curves)} parameters varied over the central {CENTRAL:.0%} of their priors, {n} points"
    head += f", means over {seeds} seeds" if seeds > 1 else f", seed {response.spec.seed}"
    many = len(response.names) > MANY
    groups = by_column(response.names)
    shown = list(groups) if many else list(response.names)
    rows: list[Sequence[str]] = [("parameter", "fixed at", "prior sd", *shown, "without a value")]
    for curve in response.curves:
        sd = f"{curve.slope.sd:.3g}"
        pulls = [_pull(*each) for each in zip(curve.slope.per_sd, response.data.errors, response.units, strict=True)]
        if many:
            changes = curve.slope.per_sd / response.data.errors
            pulls = [_pull(float(rms(changes[which])), 1.0, "").lstrip("+") for which in groups.values()]
        gaps = f"{curve.missing} of {len(curve.x)}" if curve.missing else ""
        rows.append((curve.name, f"{curve.fixed:.4g} {curve.unit}".strip(), sd, *pulls, gaps))
    parts = [paragraph(head), columns(rows)]
    parts.append(
        paragraph(
            "Each number is the slope at the fixed point: change of the observable, in standard errors of the datum, "
            "per standard deviation of the prior (half its central 68 %; of ln x for a log-uniform prior). It is that "
            "of a parabola through the points within one such deviation."
            + (" Of the data of a column, the root of the mean square." if many else "")
        )
    )
    if response.reasons:
        rows = [(str(count), reason) for reason, count in response.reasons.most_common()]
        parts.append(f"streams without a value\n{columns(rows)}")
    return "\n\n".join(parts)


def _pull(per_sd: float, error: float, unit: str) -> str:
    """Write a slope in standard errors of the datum, or in the observable's unit where there is no datum."""
    if not np.isfinite(per_sd):
        return "-"
    return f"{per_sd / error:+.2f}" if np.isfinite(error) else f"{per_sd:+.2g} {unit}".strip()


TABLE, SLOPES, PICTURE, RUN = "sensitivity.ecsv", "slopes.ecsv", "sensitivity.png", "sensitivity.toml"
PRODUCTS = (TABLE, SLOPES, PICTURE, RUN)


def sensitivity_products(sensitivity: Sensitivity) -> Products:
    """Return the observables at every point and their slopes, the header with the fixed point, and the picture."""
    data = zip(sensitivity.data.values.tolist(), sensitivity.data.errors.tolist(), strict=True)
    header = {
        "seeds": sensitivity.seeds,
        "central": CENTRAL,
        "fixed": sensitivity.point,
        "data": dict(zip(sensitivity.names, map(list, data), strict=True)),
    }
    tables = {TABLE: points_table(sensitivity), SLOPES: slopes_table(sensitivity)}
    pictures = {PICTURE: partial(sensitivity_figure, sensitivity)}
    return Products(
        sensitivity.spec, RUN, describe_sensitivity(sensitivity), tables, pictures, header, sensitivity.stopped
    )
