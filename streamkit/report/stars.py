"""Mock stars of a stream as a table that survey simulators read: angles, distance modulus, motions, true magnitudes.

`streamobs` of the LSST DESC reads the CSV file: ra and dec, or phi1 and phi2; ``dist``, the distance modulus; and
``lsst_g_true`` and so on, apparent magnitudes without errors. It adds those of a survey, and its selection.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from astropy import units as u
from astropy.table import QTable, Table

from streamkit.errors import StreamkitError, brief, expect_file, nearest
from streamkit.report.files import save, save_table
from streamkit.stream import Array, Frame, Stream

STARS = (".csv", ".ecsv")  # suffixes of the file
MASS = "mass"  # the column of an isochrone with initial masses in Msun; all others are absolute magnitudes
TRUE = "_true"  # after the name of a band
# Kroupa 2001, MNRAS 322, 231: dN/dm falls as m^-slope above each mass in Msun.
SLOPES = ((0.01, 0.3), (0.08, 1.3), (0.5, 2.3))


def star_table(stream: Stream, frame: Frame = None, isochrone: Table | None = None, seed: int = 0) -> QTable:
    """Return one row per unbound particle, as a star: what the Sun sees of it, and its true magnitudes.

    Columns: ra, dec, pm_ra_cosdec, pm_dec; with a ``frame`` phi1, phi2, pm_phi1_cosphi2, pm_phi2; ``dist``, the
    distance modulus, ``distance`` and ``radial_velocity``. A stream whose particles do not all count alike has a
    ``weight``. With an isochrone (`read_isochrone`) also ``mass`` and the apparent magnitude BAND_true of each band:
    masses are drawn from Kroupa's (2001) initial mass function over the masses of the isochrone.
    """
    free = ~stream.bound & (stream.weight > 0)
    table = QTable()
    sky = stream.seen()
    table["ra"], table["dec"] = sky.lon[free] % 360.0 * u.deg, sky.lat[free] * u.deg
    motions = {"pm_ra_cosdec": sky.pm_lon_coslat, "pm_dec": sky.pm_lat}
    if frame is not None:
        seen = stream.seen(frame)
        table["phi1"], table["phi2"] = seen.lon[free] * u.deg, seen.lat[free] * u.deg
        motions |= {"pm_phi1_cosphi2": seen.pm_lon_coslat, "pm_phi2": seen.pm_lat}
    modulus = 5 * np.log10(sky.distance[free]) + 10
    table["dist"], table["distance"] = modulus * u.mag, sky.distance[free] * u.kpc
    for name, motion in motions.items():
        table[name] = motion[free] * u.mas / u.yr
    table["radial_velocity"] = sky.radial_velocity[free] * u.km / u.s
    if np.ptp(stream.weight[free]) > 0:
        table["weight"] = stream.weight[free]
    if isochrone is not None:
        known = np.asarray(isochrone[MASS], dtype=float)
        mass = initial_masses(np.random.default_rng(seed).random(len(modulus)), known[0], known[-1])
        table[MASS] = mass * u.Msun
        for band in (name for name in isochrone.colnames if name != MASS):
            table[f"{band}{TRUE}"] = (modulus + np.interp(mass, known, isochrone[band])) * u.mag
    return table


def write_stars(table: QTable, path: Path) -> None:
    """Write the stars as CSV, without units, or ECSV."""
    if path.suffix == ".ecsv":
        save_table(path, table)
        return
    plain = Table({name: np.asarray(table[name].value if hasattr(table[name], "value") else table[name])
                   for name in table.colnames})  # fmt: skip
    save(path, lambda part: plain.write(str(part), format="ascii.csv", overwrite=True))


def initial_masses(shares: Array, low: float, high: float) -> Array:
    """(n,) Return the quantiles of Kroupa's (2001) initial mass function between two masses, at shares (n,) of 1."""
    knots = [low, *(mass for mass, _ in SLOPES if low < mass < high), high]
    slopes = [next(slope for mass, slope in reversed(SLOPES) if mass <= m or mass == SLOPES[0][0]) for m in knots[:-1]]
    heights, powers = [1.0], [1 - slope for slope in slopes]
    for (m, upper), slope in zip(pairwise(knots), slopes, strict=True):
        heights.append(heights[-1] * (upper / m) ** -slope)
    parts = [h * m / p * ((upper / m) ** p - 1)
             for h, p, (m, upper) in zip(heights[:-1], powers, pairwise(knots), strict=True)]  # fmt: skip
    ends = np.concatenate([[0.0], np.cumsum(parts)])
    wanted = np.asarray(shares) * ends[-1]
    which = np.clip(np.searchsorted(ends, wanted, side="right") - 1, 0, len(parts) - 1)
    m, h, p = (np.array(each)[which] for each in (knots[:-1], heights[:-1], powers))
    return np.asarray(m * (1 + (wanted - ends[which]) * p / (h * m)) ** (1 / p))


def read_isochrone(path: Path) -> Table:
    """Read an isochrone: ``mass`` (initial, Msun) and the absolute magnitude in each band, such as ``lsst_g``.

    Rows are returned by increasing mass. StreamkitError for a file that is no such table.
    """
    try:
        expect_file(path)
        table = Table.read(str(path), format="ascii")
    except OSError as error:
        raise StreamkitError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # astropy raises many kinds for a text that is no table
        raise StreamkitError(f"{path}: cannot be read as a table: {brief(error)}") from None
    names = table.colnames
    if MASS not in names:
        raise StreamkitError(f"{path}: there is no column {MASS!r}.{nearest(MASS, names)} It has {', '.join(names)}")
    if len(names) < 2 or len(table) < 2:
        raise StreamkitError(f"{path}: expected two rows or more, and beside {MASS!r} a column for each band")
    for name in names:
        try:
            column: Array = np.asarray(np.ma.filled(np.ma.asarray(table[name], dtype=float), np.nan))
        except (TypeError, ValueError):
            raise StreamkitError(f"{path}: {name}: not a column of numbers") from None
        bad = ~np.isfinite(column) | ((column <= 0) if name == MASS else False)
        if bad.any():
            wanted = "a positive mass in Msun" if name == MASS else "an absolute magnitude"
            i = int(np.argmax(bad))
            raise StreamkitError(f"{path}: {name}: row {i + 1}: found {column[i]:g}, expected {wanted}")
        table[name] = column
    table.sort(MASS)
    return table
