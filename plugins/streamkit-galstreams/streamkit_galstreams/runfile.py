"""The text of a run file for some streams, and their tables."""

from __future__ import annotations

import re
from io import StringIO

import numpy as np
from astropy import units as u
from astropy.table import QTable

from streamkit.cli import Written
from streamkit_galstreams.measured import ONE
from streamkit_galstreams.points import DISTANCE, Points
from streamkit_galstreams.progenitor import progenitor_of

UNITS = {
    "phi1": "deg", "phi2": "deg", "distance": "kpc", "pm_phi1_cosphi2": "mas/yr", "pm_phi2": "mas/yr",
    "radial_velocity": "km/s",
}  # fmt: skip
DIGITS = {"phi1": 2, "phi2": 3, "distance": 3, "pm_phi1_cosphi2": 3, "pm_phi2": 3, "radial_velocity": 1}
SOURCE = (
    "galstreams (BSD 3-clause, Copyright (c) 2017 Cecilia Mateu); Mateu 2023, MNRAS 520, 5225, and the paper named "
    "after the dot of track"
)
HOST = """\
version = 1
seed = 1

[sun]
r0 = "8.122 kpc"
z = "0.0208 kpc"
v_circ = "host"                  # tied to the host below
u = "12.9 km/s"
v = "12.2 km/s"
w = "7.78 km/s"

[potential]
preset = "bovy2014"              # bulge and disc; the halo is replaced

[potential.halo]
kind = "nfw_triaxial"            # flattened in the potential
mass = { log_uniform = ["1e11 Msun", "1.5e12 Msun"] }
rs = { log_uniform = ["4 kpc", "40 kpc"] }
q = { uniform = [0.7, 1.4] }     # axis ratio of the halo's potential

[body.lmc]                       # the Large Magellanic Cloud: v_c(8.7 kpc) = 91.7 km/s whatever its mass
kind = "hernquist_vcirc"
mass = { log_uniform = ["2e10 Msun", "3e11 Msun"] }
ra = "81.28 deg"
dec = "-69.78 deg"
distance = "49.6 kpc"
pm_ra_cosdec = "1.858 mas/yr"
pm_dec = "0.385 mas/yr"
v_los = "262.2 km/s"

[stream_defaults.stripping]
kind = "mlcs"
particles = 1000                 # for a look; take 5000 and more for a result

[stream_defaults.observable]
kind = "track"

[sampler]
kind = "emulator"
"""


def section_name(stream: str) -> str:
    """Return the name of a stream's section and files: ``GD-1`` is gd1, ``AAU-ATLAS`` is aau_atlas."""
    joined = re.sub(r"(?<=[a-z])-(?=\d)", "", stream.lower())
    return re.sub(r"[^a-z0-9]+", "_", joined).strip("_")


def written(streams: list[Points]) -> Written:
    """Return the run file of some streams, with the tables that it reads, by name."""
    names = [section_name(points.track.stream) for points in streams]
    title = "# " + ", ".join(points.track.stream for points in streams)
    opening = _wrapped(
        f"{title} in a host beside the Large Magellanic Cloud, from the smooth tracks of galstreams. CHECK THE "
        "ERRORS: the library has none. Those of the tables are widths of the streams or guesses, and points of a "
        "smooth curve are not independent."
    )
    parts = [opening + HOST, *(section(name, points) for name, points in zip(names, streams, strict=True))]
    tables = {f"{name}.ecsv": table_text(points) for name, points in zip(names, streams, strict=True)}
    return Written(f"{names[0] if len(names) == 1 else 'streams'}.toml", "\n".join(parts), tables)


def section(name: str, points: Points) -> str:
    """Return the sections of one stream."""
    progenitor, found = progenitor_of(points), points.measured
    told = [f"{points.track.name}: {_what(points)}.", *(f"{fault[0].upper()}{fault[1:]}." for fault in found.faults)]
    errors = [f"{column} {error:.2g}{_unit(column)} ({source})" for column, (error, source) in points.errors.items()]
    told.append(f"Errors: {', '.join(errors)}.")
    lines = [_wrapped("# " + " ".join(told)).rstrip("\n"), f"[stream.{name}]", points.frame.to_toml()]
    lines += [f'table = "{name}.ecsv"', f"[stream.{name}.progenitor]", _wrapped(f"# {progenitor.comment}").rstrip("\n")]
    lines += [f"{field} = {value}" for field, value in progenitor.fields.items()]
    lines += [f"[stream.{name}.stripping]", f"sigma = {progenitor.sigma}", f"[stream.{name}.observable]"]
    lines.append(f'kernel = "{_kernel(points):.1f} deg"')
    if found.distance == ONE:
        value = points.middle["distance"]
        lines += [
            "# one distance for the whole stream is one datum; its error is ours",
            f'distance = {{ phi1 = ["{points.middle["phi1"]:.1f} deg"], distance = ["{value:.2f} kpc"], '
            f'error = ["{DISTANCE * value:.2f} kpc"] }}',
        ]
    return "\n".join(lines) + "\n"


def table_text(points: Points) -> str:
    """Return the table of a stream as ECSV."""
    table = QTable()
    for column, values in points.columns.items():
        unit = u.Unit(UNITS[column])
        table[column] = np.round(values, DIGITS[column]) * unit
        if column in points.errors:
            error = points.errors[column][0] * (values if column == "distance" else np.ones(len(values)))
            table[f"{column}_error"] = np.round(error, 3) * unit
    table.meta = {
        "track": points.track.name,
        "source": SOURCE,
        "note": "points of a smooth track, turned into the frame of the run file; the errors are widths or guesses",
    }
    text = StringIO()
    table.write(text, format="ascii.ecsv")
    return text.getvalue()


def _kernel(points: Points) -> float:
    """Return the kernel of the mean track: a third of the distance between points, 1 to 5 degrees."""
    return float(np.clip(points.length / 7 / 3, 1.0, 5.0))


def _what(points: Points) -> str:
    names = {"s": "sky", "d": "distance", "p": "proper motions", "v": "velocity"}
    return ", ".join(names[letter] for letter in points.measured.dims if letter != "-")


def _unit(column: str) -> str:
    return "" if column == "distance" else f" {UNITS[column]}"


def _wrapped(comment: str, width: int = 118) -> str:
    """Return a comment in lines that begin with #."""
    lines, words = [""], comment.removeprefix("# ").split()
    for word in words:
        if len(lines[-1]) + len(word) + 3 > width:
            lines.append("")
        lines[-1] += f" {word}"
    return "".join(f"#{line}\n" for line in lines)
