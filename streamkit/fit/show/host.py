"""The host as tables and a picture: its profile, at parameters or over a posterior, and the objects that move in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from astropy import units as u
from astropy.table import QTable, vstack
from matplotlib.figure import Figure

from streamkit.errors import OutOfDomain
from streamkit.fit.samples.results import Results
from streamkit.fit.samples.tables import LEVELS, printable, radii_in_kpc
from streamkit.fit.show.figures import bands, levels
from streamkit.model import PROFILE, Host, Moving, profile_values
from streamkit.report import BLUE, VERMILION, columns, number, panel_grid, paragraph, ticks
from streamkit.runfile import Spec
from streamkit.stream import Array
from streamkit.units import GYR

HOST_RADII = (5.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0, 200.0)  # kpc
LINES = 12  # draws of the priors that are lines of their own in the picture
MOST = 300  # largest number of samples of a posterior for flattening, escape speed and density
OBJECT_UNITS = {"mass": "Msun", "r": "kpc", "r_tidal": "kpc", "t_peri": "Gyr", "r_peri": "kpc", "r_tidal_peri": "kpc",
                "t_apo": "Gyr", "r_apo": "kpc", "r_tidal_apo": "kpc"}  # fmt: skip


def host_table(source: Spec | Results, radii: Any = HOST_RADII, draws: int = 0) -> QTable:
    """Return the profile of the host, one row per radius (kpc, or a Quantity).

    Columns: r, and M, v_c, q, v_esc and rho as their descriptions define them. For a spec they are values at the
    prior's centre (`Spec.with_values` fixes parameters). For results they are medians, with 68 % and 95 % intervals in
    ``_lo68`` and so on; q, v_esc and rho come from at most 300 samples. For a spec with ``draws`` they are those of so
    many draws of the priors.

    Raises ValueError for radii that are not positive, and OutOfDomain if no draw has a host.
    """
    r = radii_in_kpc(radii)
    table = QTable({"r": r * u.kpc})
    if isinstance(source, Results):
        chosen = source.some(MOST)
        drawn = _stacked([profile_values(Host(source.spec.host(theta)), r) for theta in chosen])
        drawn["M"], drawn["v_c"] = source.profiles(r)
        _add_levels(table, drawn)
        source.with_provenance(table, {"samples used": len(chosen)})
    elif draws:
        drawn = prior_profiles(source, r, draws)
        _add_levels(table, drawn)
        table.meta["draws of the priors"] = len(drawn["M"])
    else:
        for name, values in profile_values(Host.at(source), r).items():
            table[name] = values * u.Unit(PROFILE[name].unit)
    for name, column in PROFILE.items():
        table[name].info.description = column.meaning
    return printable(table)


def prior_profiles(spec: Spec, radii: Array, draws: int) -> dict[str, Array]:
    """Return the columns of `PROFILE` (n, nr) at radii (nr,) in kpc, for draws of the priors from the run's seed.

    Draws without a host are left out; OutOfDomain if none has one.
    """
    rng = np.random.default_rng(spec.seed)
    points = np.stack([prior.sample(rng, draws) for prior in spec.priors], axis=1)
    each, reason = [], ""
    for theta in points:
        try:
            each.append(profile_values(Host(spec.host(theta)), radii))
        except OutOfDomain as error:
            reason = error.reason
    if not each:
        raise OutOfDomain(reason)
    return _stacked(each)


def _stacked(each: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    return {name: np.array([one[name] for one in each]) for name in PROFILE}


def _add_levels(table: QTable, drawn: Mapping[str, Array]) -> None:
    """Add median and intervals of each column (n, nr)."""
    for name, values in drawn.items():
        # an escape speed may be infinite: no percentile between two samples
        how: Literal["linear", "nearest"] = "linear" if name in ("M", "v_c") else "nearest"
        for level, percent in LEVELS.items():
            column = np.percentile(values, percent, axis=0, method=how)
            table[f"{name}_{level}".rstrip("_")] = column * u.Unit(PROFILE[name].unit)


def objects_table(objects: Mapping[str, Moving]) -> QTable:
    """Return one row per object: mass, radius and tidal radius today, at the last pericentre and apocentre."""
    rows = []
    for moving in objects.values():
        turning = moving.turning()
        times = {name: turning[name] / GYR for name in ("t_peri", "t_apo")}
        today = {"mass": moving.mass, "r": moving.orbit.r[-1], "r_tidal": moving.orbit.r_tidal[-1]}
        rows.append(today | turning | times)
    table = QTable({"object": list(objects)})
    for name, unit in OBJECT_UNITS.items():
        table[name] = np.array([row[name] for row in rows]) * u.Unit(unit)
    return printable(table)


def orbits_table(objects: Mapping[str, Moving]) -> QTable:
    """Return the orbits, one row per object and time, in Galactocentric coordinates."""
    parts = []
    for name, moving in objects.items():
        orbit = moving.orbit
        part = QTable({"object": [name] * len(orbit.t), "t": orbit.t / GYR * u.Gyr})
        for axis, q in zip("xyz", orbit.q, strict=True):
            part[axis] = q * u.kpc
        for axis, v in zip("xyz", orbit.v, strict=True):
            part[f"v{axis}"] = v * u.km / u.s
        part["r"], part["r_tidal"] = orbit.r * u.kpc, orbit.r_tidal * u.kpc
        parts.append(part)
    return vstack(parts, metadata_conflicts="silent")


def describe_host(profile: QTable, objects: Mapping[str, Moving], note: str = "") -> str:
    """Return both tables as text for a terminal, with the definition of each column."""
    units = {name: column.unit for name, column in PROFILE.items()}
    head = ["r [kpc]", *(f"{name} [{unit}]" if unit else name for name, unit in units.items())]
    rows = [[f"{row['r'].value:g}", *(_cell(row, name) for name in PROFILE)] for row in profile]
    parts = [paragraph(note)] if note else []
    parts.append(f"host today, without the bodies beside it\n{columns([head, *rows])}")
    parts.append("\n".join(paragraph(f"{column.meaning}.", f"  {name}: ", "    ") for name, column in PROFILE.items()))
    body = [["object", "mass [Msun]", "r today", "r_tidal", "last pericentre", "r_tidal there", "last apocentre"]]
    for row in objects_table(objects):
        turns = [f"{row[f'r_{at}'].value:.4g}, {-row[f't_{at}'].value:.3g} Gyr ago" for at in ("peri", "apo")]
        turns = ["-" if "nan" in turn else turn for turn in turns]
        numbers = [_or_dash(row[name].value) for name in ("mass", "r", "r_tidal")]
        body.append([str(row["object"]), *numbers, turns[0], _or_dash(row["r_tidal_peri"].value), turns[1]])
    if len(body) > 1:
        parts.append(f"objects that move in it, radii in kpc\n{columns(body)}")
    return "\n\n".join(parts)


def _cell(row: Any, name: str) -> str:
    value = _or_dash(float(getattr(row[name], "value", row[name])))
    if f"{name}_lo68" not in row.colnames or value == "-":
        return value
    low, high = (float(getattr(row[f"{name}_{end}"], "value", row[f"{name}_{end}"])) for end in ("lo68", "hi68"))
    return f"{value} ({low:.3g} to {high:.3g})"


def _or_dash(value: float) -> str:
    return number(value) if not np.isnan(value) else "-"


LOGARITHMIC = ("M", "rho")  # columns over several powers of ten


def draw_host(
    profile: QTable, objects: Mapping[str, Moving], note: str = "", drawn: Mapping[str, Array] | None = None
) -> Figure:
    """Draw the columns of `host_table` against radius, with their intervals if it has them, and the orbits' radii.

    ``drawn`` are columns (n, nr) of single draws, of which the first are thin lines.
    """
    shown = [name for name in PROFILE if np.isfinite(profile[name].value).any()]
    figure, panels = panel_grid(len(shown) + bool(objects), 3.4, 2.9, across=3, share=False)
    r, has_bands = profile["r"].value, f"{shown[0]}_lo68" in profile.colnames
    for axes, name in zip(panels, shown, strict=False):
        if has_bands:
            bands(axes, r, levels(profile, name, 1.0))
            for line in drawn[name][:LINES] if drawn else ():
                axes.plot(r, line, color="black", lw=0.5, alpha=0.5)
        else:
            axes.plot(r, profile[name].value, color=BLUE, lw=1.8)
        axes.set_ylabel(PROFILE[name].label, fontsize=11)
        axes.set_xlabel("r [kpc]", fontsize=11)
        axes.set_xscale("log")
        ticks(axes)
        if name in LOGARITHMIC:
            axes.set_yscale("log")
        axes.set_xlim(r.min(), r.max() if len(r) > 1 else 1.1 * r.min())
    if objects:
        axes = panels[len(shown)]
        for i, (name, moving) in enumerate(objects.items()):
            axes.plot(moving.orbit.t / GYR, moving.orbit.r, color=f"C{i % 10}", lw=1.3, label=name)
        axes.set_xlabel("t [Gyr]", fontsize=11)
        axes.set_ylabel("radius of the orbit [kpc]", fontsize=11)
        ticks(axes)
        axes.set_ylim(0, 1.25 * axes.get_ylim()[1])
        axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper left")
    if has_bands:
        panels[0].legend(frameon=False, fontsize=9)
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=12)
    return figure
