"""Published masses, circular velocities and flattenings: as a table beside the values of a run, and in pictures."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.io.registry import IORegistryError
from astropy.table import QTable, Table
from matplotlib.axes import Axes

from streamkit.errors import StreamkitError, nearest
from streamkit.fit.samples.results import Results
from streamkit.model import Host
from streamkit.stream import Array

# The axis ratio of the potential of the whole host at a position, and of the density of its halo.
POTENTIAL, DENSITY = "q_Phi", "q_rho"
# The quantities that a table may hold, and their units.
UNITS = {"M": "Msun", "v_c": "km/s", POTENTIAL: "", DENSITY: ""}
NUMBERS = ("radius", "value", "error_minus", "error_plus")
COLUMNS = ("quantity", *NUMBERS, "reference")
MARKERS = "sD^vopP*hX"
MILKY_WAY = "milky_way"  # the name of the table that comes with streamkit
MOST = 300  # largest number of samples for the flattening


def read_literature(path: str | Path) -> QTable:
    """Read a table of published values, of any format that astropy recognises by the name: ECSV, FITS, VOTable, CSV.

    Columns: quantity, "M" (mass inside the radius), "v_c" (circular velocity), "q_Phi" (axis ratio of the potential of
    the whole host, at a cylindrical radius and a height z) or "q_rho" (axis ratio of the density of its halo); radius
    in kpc unless the column has another unit; z, for q_Phi, as the radius; value, error_minus and error_plus (both
    positive, 1 sigma) in Msun or km/s; reference. The table returned holds plain numbers in these units, z NaN where
    there is none. The name `MILKY_WAY` is that of the table of streamkit's own, unless a file is called so.

    Raises StreamkitError if it cannot be read or is not such a table: with the row.
    """
    path = Path(path)
    if str(path) == MILKY_WAY and not path.is_file():
        path = Path(__file__).with_name(f"{MILKY_WAY}.ecsv")
    if not path.is_file():
        raise StreamkitError(
            f"literature {str(path)!r}: there is no such file; {MILKY_WAY!r} is a table that streamkit brings."
        )
    try:
        try:
            table = Table.read(path)
        except IORegistryError:
            table = Table.read(path, format="ascii")
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        reason = "expected ECSV, CSV, FITS or VOTable" if "guess" in reason else reason  # astropy's lists its guesses
        raise StreamkitError(f"literature {str(path)!r}: cannot be read as a table ({reason})") from None
    return checked(table, f"literature {str(path)!r}")


def checked(table: Table, where: str) -> QTable:
    """Return a table of published values in plain numbers: kpc, Msun, km/s. StreamkitError says what is wrong."""
    if missing := [name for name in COLUMNS if name not in table.colnames]:
        raise StreamkitError(
            f"{where}: the column {missing[0]!r} is missing. Wanted: {', '.join(COLUMNS)}; found: "
            f"{', '.join(table.colnames)}.{nearest(missing[0], table.colnames)}"
        )
    quantities = [str(name) for name in table["quantity"]]
    for row, name in enumerate(quantities, 1):
        if name not in UNITS:
            raise StreamkitError(
                f"{where}, row {row}: the quantity must be {', '.join(list(UNITS)[:-1])} or {DENSITY}, found {name!r}."
                f"{nearest(name, UNITS)}"
            )
    columns: dict[str, Any] = {"quantity": quantities}
    for name in (*NUMBERS, *(["z"] if "z" in table.colnames else [])):
        column = table[name]
        try:
            given = column.unit
            plain: Any = np.ma.filled(np.ma.asarray(column.value if given is not None else column, dtype=float), np.nan)
            units = ["kpc" if name in ("radius", "z") else UNITS[quantity] for quantity in quantities]
            columns[name] = plain * np.array([1.0 if given is None else u.Unit(given).to(unit) for unit in units])
        except (TypeError, ValueError, u.UnitConversionError) as error:
            raise StreamkitError(f"{where}: the column {name!r} is not usable ({error})") from None
        good = np.isfinite(plain) & ((plain >= 0) if name.startswith("error") else (plain > 0))
        if name != "z" and not good.all():
            row = int(np.argmin(good))
            raise StreamkitError(f"{where}, row {row + 1}: {name} must be a positive number, found {plain[row]:g}")
    z = columns.setdefault("z", np.full(len(quantities), np.nan))
    placed = np.array([name != POTENTIAL for name in quantities]) | (np.isfinite(z) & (z != 0))
    if not placed.all():
        row = int(np.argmin(placed))
        raise StreamkitError(
            f"{where}, row {row + 1}: {POTENTIAL} is that at a radius and a height z in kpc, other than 0; found "
            f"z = {z[row]:g}"
        )
    return QTable({**columns, "reference": [str(text) for text in table["reference"]]})


def keys_of(table: QTable) -> dict[str, str]:
    """Return the references of published values, each with the key of its BibTeX entry.

    The key is empty for a reference that is not in the table `MILKY_WAY`: streamkit has no entry of it.
    """
    ours = set(read_literature(Path(__file__).with_name(f"{MILKY_WAY}.ecsv"))["reference"])
    return {text: _key(text) if text in ours else "" for text in dict.fromkeys(map(str, table["reference"]))}


def _key(reference: str) -> str:
    """Return the key of a reference such as "Malhan & Ibata 2019": the first author and the year, in ASCII."""
    plain = unicodedata.normalize("NFKD", reference).encode("ascii", "ignore").decode()
    first, year = re.split(r"[+&]| (?=\d)", plain)[0], plain[-4:]
    return first.replace(" ", "") + year


def draw_literature(axes: Axes, table: QTable, name: str, factor: float = 1.0) -> None:
    """Draw the published values of one quantity over a profile, each reference with its own marker.

    Flattenings stand at their distance from the centre.
    """
    rows = table[[quantity == name for quantity in table["quantity"]]]
    for i, reference in enumerate(dict.fromkeys(rows["reference"])):
        those = rows[rows["reference"] == reference]
        errors = factor * np.array([those["error_minus"], those["error_plus"]])
        place = np.hypot(those["radius"], those["z"]) if name == POTENTIAL else those["radius"]
        axes.errorbar(
            place, factor * those["value"], yerr=errors, fmt=MARKERS[i % len(MARKERS)], ms=6, color="black",
            mfc="white", capsize=3, lw=1.2, zorder=5, label=reference,
        )  # fmt: skip


def beside_literature(results: Results, table: QTable) -> QTable:
    """Return the published values with the run's own at the same radii and places.

    Further columns: ours, ours_minus, ours_plus (median and half-widths of the 68 % interval), and deviation: ours
    minus theirs in standard errors, the two errors that face each other added in quadrature. NaN for the flattening of
    a halo's density, which a host need not have.
    """
    ours: dict[str, list[float]] = {name: [] for name in ("ours", "ours_minus", "ours_plus", "deviation")}
    radii, z = np.asarray(table["radius"], dtype=float), np.asarray(table["z"], dtype=float)
    mass, v_c = results.profiles(radii)
    shapes = flattenings(results, radii, z) if POTENTIAL in table["quantity"] else np.empty((0, len(table)))
    samples = {"M": mass, "v_c": v_c, POTENTIAL: shapes, DENSITY: np.full((1, len(table)), np.nan)}
    for k, row in enumerate(table):
        values = samples[row["quantity"]][:, k]
        values = values[np.isfinite(values)]
        low, middle, high = np.percentile(values, [16, 50, 84]) if len(values) else np.full(3, np.nan)
        above = middle > row["value"]
        error = np.hypot(middle - low, row["error_plus"]) if above else np.hypot(high - middle, row["error_minus"])
        deviation = (middle - row["value"]) / error if error else np.nan
        for name, value in zip(ours, (middle, middle - low, high - middle, deviation), strict=True):
            ours[name].append(float(value))
    beside = table.copy()
    for name, column in ours.items():
        beside[name] = column
    return beside


def flattenings(results: Results, radii: Array, z: Array) -> Array:
    """(n, k) `Host.flattening` of at most `MOST` samples, at cylindrical radii and heights (k,) in kpc."""
    return np.array([Host(results.spec.host(theta)).flattening(radii, z) for theta in results.some(MOST)])
