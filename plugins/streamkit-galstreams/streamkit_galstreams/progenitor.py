"""The progenitor of a stream: its cluster, where that lies in the track, or a point in the middle of the debris."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from astropy.table import QTable

from streamkit_galstreams.points import Points

NEAR = 5.0, 3.0  # deg: a cluster so near to the ends of the track, and to its line, is part of it
WIDE = 200.0  # pc; a wider stream is taken for a dwarf galaxy's
KMS = 4.740471  # km/s of one mas/yr at one kpc
CLUSTER: dict[str, str] = {"mass": '"2e4 Msun"', "radius": '"30 pc"', "lookback": '"3 Gyr"', "sigma": '"1 km/s"'}
DWARF: dict[str, str] = {"mass": '"1e7 Msun"', "radius": '"0.3 kpc"', "lookback": '"4 Gyr"', "sigma": '"5 km/s"'}
SYSTEMATIC = 0.026  # mas/yr: Gaia's own error of a cluster's proper motion (Vasiliev & Baumgardt 2021)


@dataclass(frozen=True)
class Progenitor:
    """The fields of the section as a run file writes them, with a comment on what was chosen."""

    comment: str
    fields: dict[str, str]
    sigma: str  # the velocity dispersion with which debris leaves


def progenitor_of(points: Points) -> Progenitor:
    """Return the progenitor of a stream."""
    cluster = _cluster_of(points)
    return _in_the_middle(points) if cluster is None else cluster


@cache
def clusters() -> dict[str, dict[str, Any]]:
    """Return the clusters by the first part of their stream's name."""
    table = QTable.read(str(files("streamkit_galstreams") / "clusters.ecsv"), format="ascii.ecsv")
    return {
        str(row["stream"]): {name: getattr(row[name], "value", row[name]) for name in table.colnames} for row in table
    }


def _cluster_of(points: Points) -> Progenitor | None:
    name = points.track.stream.split("-")[0]
    cluster = clusters().get(points.track.stream, clusters().get(name))
    if cluster is None:
        return None
    seen = points.frame.from_icrs(float(cluster["ra"]), float(cluster["dec"]))
    phi1, line = float(seen.phi1), points.columns["phi1"]
    if not line[0] - NEAR[0] < phi1 < line[-1] + NEAR[0] or abs(float(seen.phi2)) > NEAR[1]:
        return None
    fields = {"kind": '"plummer"', "mass": '{ log_uniform = ["1e4 Msun", "1e6 Msun"] }', "radius": '"10 pc"'}
    fields |= {"ra": f'"{cluster["ra"]:.3f} deg"', "dec": f'"{cluster["dec"]:.3f} deg"'}
    fields["distance"] = _normal(cluster, "distance", "kpc")
    for motion in ("pm_ra_cosdec", "pm_dec"):
        error = math.hypot(float(cluster[f"{motion}_error"]), SYSTEMATIC)
        fields[motion] = f'{{ normal = ["{cluster[motion]:.4f} mas/yr", "{error:.4f} mas/yr"] }}'
    fields["v_los"] = f'"{cluster["v_los"]:.2f} km/s"'
    fields["lookback"] = CLUSTER["lookback"]
    comment = f"the cluster {cluster['cluster']} (Vasiliev & Baumgardt 2021); its mass is free, its radius a guess"
    return Progenitor(comment, fields, CLUSTER["sigma"])


def _normal(cluster: dict[str, Any], name: str, unit: str) -> str:
    return f'{{ normal = ["{cluster[name]:.2f} {unit}", "{max(float(cluster[f"{name}_error"]), 0.01):.2f} {unit}"] }}'


def _in_the_middle(points: Points) -> Progenitor:
    middle = points.middle
    distance = middle["distance"]
    width = math.radians(points.errors["phi2"][0]) * (distance if math.isfinite(distance) else 10.0) * 1e3
    wide = width > WIDE
    guess = DWARF if wide else CLUSTER
    what = f"as the stream is {width:.0f} pc wide: a dwarf galaxy" if wide else "a cluster"
    fields = {"kind": '"plummer"', "mass": guess["mass"], "radius": guess["radius"]}
    fields["phi1"] = f'"{middle["phi1"]:.1f} deg"'
    half = max(1.0, 2 * points.errors["phi2"][0])
    fields["phi2"] = _uniform(middle["phi2"] - half, middle["phi2"] + half, "deg", 1)
    if math.isfinite(distance):
        fields["distance"] = _uniform(0.75 * distance, 1.25 * distance, "kpc", 1)
        half = max(0.5, 20 / (KMS * distance))
    else:
        fields["distance"] = '{ log_uniform = ["3 kpc", "60 kpc"] }'
        half = 1.0
    for motion in ("pm_phi1_cosphi2", "pm_phi2"):
        value = middle[motion]
        known = math.isfinite(value)
        fields[motion] = _uniform(value - half, value + half, "mas/yr", 2) if known else _uniform(-10, 10, "mas/yr", 0)
    velocity = middle["radial_velocity"]
    known = math.isfinite(velocity)
    fields["v_los"] = _uniform(velocity - 100, velocity + 100, "km/s", 0) if known else _uniform(-300, 300, "km/s", 0)
    fields["lookback"] = guess["lookback"]
    return Progenitor(f"unknown; {what} in the middle of the observed stretch", fields, guess["sigma"])


def _uniform(low: float, high: float, unit: str, digits: int) -> str:
    return f'{{ uniform = ["{low:.{digits}f} {unit}", "{high:.{digits}f} {unit}"] }}'
