"""Mock catalogues: stars of the example stream about its mean track, among field stars of a known density."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import streamkit as sk
from streamkit.testing.streams import example_stream

FRAME = {"ends": [[303.1, -49.2], [268.2, 14.8]]}  # the stream lies along its great circle
WINDOW = {"phi1": [-40.0, 40.0], "phi2": [-15.0, 15.0]}
KERNEL, HIGH = 5.0, 30.0  # degrees: of the lines, and from one end of phi2 to the other
COLUMNS = "phi2", "pm_phi1_cosphi2", "pm_phi2"
# Field stars: even in phi2, Gaussian in the proper motions, denser toward larger phi1.
FIELD_PM, FIELD_WIDTH = (-2.0, 0.0), 4.0


@cache
def the_stream() -> sk.Stream:
    """The stream that the members are of."""
    return example_stream()


def members_of_stream(count: int, rng: np.random.Generator) -> dict[str, sk.Array]:
    """Places and motions of members: Gaussian about the mean track, by its covariances."""
    phi1 = rng.uniform(-40, 40, count)
    grid = np.linspace(-40, 40, 81)
    track = the_stream().track(FRAME, grid, kernel=KERNEL)
    found = {"phi1": phi1}
    for name in COLUMNS:
        row = track.names.index(name)
        mean, spread = np.interp(phi1, grid, track.mean[row]), np.interp(phi1, grid, track.spread[row])
        found[name] = rng.normal(mean, spread)
    return found


def field_stars(count: int, rng: np.random.Generator) -> dict[str, sk.Array]:
    """Places and motions of field stars, three times as dense at the upper end of the window as at the lower one."""
    phi1 = -40 + 40 * (np.sqrt(1 + 8 * rng.random(count)) - 1)
    return {
        "phi1": phi1, "phi2": rng.uniform(-0.5 * HIGH, 0.5 * HIGH, count),
        "pm_phi1_cosphi2": rng.normal(FIELD_PM[0], FIELD_WIDTH, count),
        "pm_phi2": rng.normal(FIELD_PM[1], FIELD_WIDTH, count),
    }  # fmt: skip


def field_density(stars: dict[str, sk.Array], error: float) -> sk.Array:
    """The density of measured field stars at their phi1, per deg (mas/yr)^2; all motions have one error."""
    variance = FIELD_WIDTH**2 + error**2
    away2 = (stars["pm_phi1_cosphi2"] - FIELD_PM[0]) ** 2 + (stars["pm_phi2"] - FIELD_PM[1]) ** 2
    return np.asarray(np.exp(-0.5 * away2 / variance) / (2 * np.pi * variance) / HIGH)


def catalogue(members: int, others: int, seed: int = 0, error: float = 0.1) -> tuple[dict[str, Any], sk.BoolArray]:
    """A table of stars in ICRS, with the density of the field, and which of them are of the stream."""
    rng = np.random.default_rng(seed)
    parts = members_of_stream(members, rng), field_stars(others, rng)
    stars = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    for name in COLUMNS[1:]:
        stars[name] = stars[name] + rng.normal(0, error, members + others)
    inside = np.abs(stars["phi2"]) < 0.5 * HIGH
    stars = {name: column[inside] for name, column in stars.items()}
    ra, dec, *pm = sk.sky_frame(FRAME).to_icrs(*(stars[name] for name in ("phi1", *COLUMNS)))
    errors = np.full(len(ra), error)
    table = {
        "ra": ra, "dec": dec, "pm_ra_cosdec": pm[0], "pm_dec": pm[1], "pm_ra_cosdec_error": errors,
        "pm_dec_error": errors, "background_density": field_density(stars, error),
    }  # fmt: skip
    order = rng.permutation(len(ra))
    return {name: column[order].tolist() for name, column in table.items()}, np.flatnonzero(inside)[order] < members


def without_field(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table without the density of the field."""
    return {name: column for name, column in table.items() if name != "background_density"}
