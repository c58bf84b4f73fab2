"""The products of fits in several hosts: a row for each, the profile averaged over them, and its picture."""

from __future__ import annotations

from functools import partial

import numpy as np
from astropy import units as u
from astropy.table import Column, QTable
from matplotlib.figure import Figure

from streamkit.components import ChainSampler
from streamkit.report import BAND_68, BAND_95, NotebookFigure, columns, paragraph, ticks
from streamkit.runfile import Spec
from streamkit.stream import Array
from streamkit.study.families.average import LEVELS, average
from streamkit.study.families.runner import Families, best_ln_likelihoods
from streamkit.study.families.weights import STACKING
from streamkit.study.grid import Products

TABLE, PROFILE, PICTURE, RUN = "families.ecsv", "profile.ecsv", "families.png", "families.toml"
PRODUCTS = (TABLE, PROFILE, PICTURE, RUN)
RADII = np.geomspace(2.0, 150.0, 60)  # kpc, of the profile
MASSES = (20.0, 50.0)  # kpc, of the masses in the table and in the terminal
QUANTITIES = (("M", u.Msun, 0), ("v_c", u.km / u.s, 1))
AVERAGE = "average"


def families_products(found: Families) -> Products:
    """Return the tables, the text and the picture."""
    table, profile = families_table(found), profile_table(found)
    text, pictures = describe_families(found, table), {PICTURE: partial(picture, found, profile)}
    return Products(found.spec, RUN, text, {TABLE: table, PROFILE: profile}, pictures)


def families_table(found: Families) -> QTable:
    """Return a row for each family and one for their average: evidence, weight, fit, masses with 68 % intervals."""
    families, nothing = found.families, [np.nan]
    evidence = np.array([each.ln_evidence for each in families])
    weights, errors = found.weights
    table = QTable({"family": [*(each.name for each in families), AVERAGE]})
    table["ln_evidence"], table["ln_evidence_error"] = (np.append(each, nothing) for each in evidence.T)
    weight = "probability of the family, if all were equally probable before the data; equal without evidence"
    if found.by == STACKING:
        weight = "in the mixture of families that predicts each stream best from all others (stacking)"
    densities = [each.ln_density.sum() if len(each.ln_density) else np.nan for each in families]
    table["weight"] = Column(np.append(weights, weights.sum()), description=weight)
    table["weight_error"] = np.append(errors, nothing)
    table["ln_likelihood"] = Column(np.append(best_ln_likelihoods(families), nothing), description="of the best sample")
    text = "sum over the streams of ln of the density of its data, given those of all others"
    table["ln_density"] = Column(np.append(densities, nothing), description=text)
    fits = [each.results.fit for each in families]
    p = [np.nan if fit is None else fit.whole.p_value for fit in fits]
    table["p"] = Column([*p, np.nan], description="of chi^2 of all data")
    table["calls"] = [*(each.results.calls for each in families), sum(each.results.calls for each in families)]
    radii = np.array(MASSES)
    samples = [each.results.profiles(radii)[0] for each in families]
    mixed = average(samples, weights)
    for i, radius in enumerate(MASSES):
        for level in ("", "lo68", "hi68"):
            values = [*(np.percentile(each[:, i], LEVELS[level]) for each in samples), mixed.levels[level][i]]
            table[f"M{radius:g}_{level}".rstrip("_")] = np.array(values) * u.Msun
        table[f"M{radius:g}_spread"] = np.array([*[np.nan] * len(families), mixed.spread[i]]) * u.Msun
    table["verdict"] = [*(each.results.verdict for each in families), ""]
    return table


def profile_table(found: Families) -> QTable:
    """Return mass and circular velocity at radii, averaged over families, their spread, and each one's median."""
    table = QTable({"r": RADII * u.kpc})
    samples = [each.results.profiles(RADII) for each in found.families]
    texts = {
        "within": "standard deviation of the families' own posteriors",
        "between": "standard deviation of the families' means, by their weights",
        "spread": "standard deviation of the families' means, equal weights: what the choice of a family moves",
    }
    for name, unit, which in QUANTITIES:
        parts = [each[which] for each in samples]
        mixed = average(parts, found.weights[0])
        for level, values in mixed.levels.items():
            table[f"{name}_{level}".rstrip("_")] = values * unit
        for what, text in texts.items():
            table[f"{name}_{what}"] = getattr(mixed, what) * unit
            table[f"{name}_{what}"].info.description = text
        for family, part in zip(found.families, parts, strict=True):
            table[f"{name}_{family.name}"] = np.median(part, axis=0) * unit
    return table


def describe_families(found: Families, table: QTable) -> str:
    """Show evidence, weights and masses of `families_table` for a terminal, and what they rest on."""
    head = (
        "host",
        "ln evidence",
        "weight",
        "best ln L",
        "p",
        *(f"M(<{r:g} kpc) [1e11 Msun]" for r in MASSES),
        "verdict",
    )
    rows = [head]
    for i in range(len(table)):
        row = table[i]
        masses = (
            _interval(*(row[f"M{r:g}{end}"].to_value(u.Msun) / 1e11 for end in ("", "_lo68", "_hi68"))) for r in MASSES
        )
        evidence = f"{row['ln_evidence']:.1f} +- {row['ln_evidence_error']:.1f}" if row["ln_evidence"] > -np.inf else ""
        numbers = (
            "" if np.isnan(row[n]) else f"{row[n]:{form}}" for n, form in (("ln_likelihood", ".1f"), ("p", ".2g"))
        )
        rows.append((row["family"], evidence, f"{row['weight']:.3f}", *numbers, *masses, row["verdict"]))
    spreads = " and ".join(
        f"{table[f'M{r:g}_spread'][-1].to_value(u.Msun) / 1e11:.2f}e11 inside {r:g} kpc" for r in MASSES
    )
    note = f"The choice of a family moves the mass by {spreads} (standard deviation of the families' means). "
    if found.unknown and found.by == STACKING:
        note += (
            f"The weights are equal: left_out.ecsv of {', '.join(found.unknown)} has a stream that its others do not "
            "predict (column problem), or there are no predictions."
        )
    elif found.by == STACKING:
        note += (
            "Weights are those of the mixture that predicts each stream best from all others (stacking); their errors "
            "are those of the choice of the streams. The spread does not depend on weights."
        )
    elif found.unknown:
        note += (
            f"The weights are equal: no evidence is known of {', '.join(found.unknown)}. {remedy(found.spec)}"
        )
    else:
        note += (
            "Weights are evidences of families that were equally probable before the data: they depend on the priors "
            "of the hosts. The spread does not depend on weights."
        )
    return f"{columns(rows)}\n\n{paragraph(note)}"


def remedy(spec: Spec) -> str:
    """Return how to come to evidences, from what the sampler of the run file can do."""
    sampler = spec.sampler
    if isinstance(sampler, ChainSampler):
        return f"The sampler {sampler.kind} gives none: take --sampler emulator, nautilus or dynesty, and another -o."
    if "max_calls" in type(sampler).model_fields:
        return f"The sampler {sampler.kind} gives one when it ends by its rule: raise sampler.max_calls and --resume."
    return "The samplers emulator, nautilus and dynesty give one when they end by their rules."


def picture(found: Families, profile: QTable) -> Figure:
    """Draw mass and circular velocity: the average with its bands, and each family's median."""
    figure = NotebookFigure(figsize=(11.0, 4.6), layout="constrained")
    labels = (r"$M(<r)\ \,[10^{11}\,M_\odot]$", r"$v_{\rm c}(r)\ \,[{\rm km\,s}^{-1}]$")
    r = profile["r"].to_value(u.kpc)
    for axes, (name, unit, _), label, factor in zip(
        figure.subplots(1, 2), QUANTITIES, labels, (1e-11, 1.0), strict=True
    ):

        def of(column: str, name: str = name, unit: u.Unit = unit, factor: float = factor) -> Array:
            return np.asarray(profile[f"{name}_{column}".rstrip("_")].to_value(unit) * factor)

        axes.fill_between(r, of("lo95"), of("hi95"), color=BAND_95, lw=0, label="average, 95 %")
        axes.fill_between(r, of("lo68"), of("hi68"), color=BAND_68, lw=0, label="average, 68 %")
        for i, (family, weight) in enumerate(zip(found.families, found.weights[0], strict=True)):
            style = ("-", "--", "-.", ":")[i % 4]
            axes.plot(r, of(family.name), style, lw=1.6, color=f"C{i}", label=f"{family.name}, weight {weight:.2f}")
        axes.set_xscale("log")
        axes.set_xlim(r[0], r[-1])
        axes.set_ylim(bottom=0)
        axes.set_xlabel(r"$r\ \,[{\rm kpc}]$", fontsize=13)
        axes.set_ylabel(label, fontsize=13)
        ticks(axes)
    figure.axes[0].legend(frameon=False, fontsize=9, loc="upper left")
    return figure


def _interval(value: float, low: float, high: float) -> str:
    return f"{value:.2f} ({low:.2f}-{high:.2f})"
