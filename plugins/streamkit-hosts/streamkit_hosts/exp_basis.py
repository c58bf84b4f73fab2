"""Read a basis `sphereSL` of EXP: its settings in YAML, its spherical model, and the cache of its functions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from streamkit import Array, StreamkitError
from streamkit.report import DamagedError, group_of, number_of, numbers_of, read_foreign
from streamkit_hosts.basis import FIDUCIAL, Basis, Model
from streamkit_hosts.text import text_of

MOST_BYTES = 1_000_000  # of a file in YAML
MOST_MODEL = 50_000_000  # bytes of a model
FEWEST_ROWS = 20  # of a model
LARGEST_L, LARGEST_N = 32, 100  # from l = 33 on EXP leaves out radii
DEFAULTS = {"numr": 800.0, "Lmax": 6.0, "nmax": 18.0, "cmap": 1.0, "rmapping": 1.0, "scale": 1.0}
FLAGS = ("NO_L1", "EVEN_L", "EVEN_M", "M0_ONLY")  # parts of the expansion that a file switches off
NOT_ALL = ("NO_L0", "N1", "N2")
SAME_BASIS = 1e-3  # largest relative difference of eigenvalues from those in EXP's cache


def settings_of(path: Path) -> dict[str, Any]:
    """Return the numbers and names of a basis in YAML, with EXP's defaults."""
    import yaml  # slow to import

    document = text_of(path, MOST_BYTES)
    try:
        content = yaml.safe_load(document)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise StreamkitError(f"{path}: cannot be read as YAML: {str(error).splitlines()[0]}") from None
    if not isinstance(content, dict) or "id" not in content:
        raise StreamkitError(f"{path}: expected a basis of EXP, `id: sphereSL` with `parameters`")
    if content["id"] != "sphereSL":
        raise StreamkitError(f"{path}: id is {str(content['id'])[:40]!r}; expected sphereSL, the basis of haloes")
    given = content.get("parameters")
    if not isinstance(given, dict):
        raise StreamkitError(f"{path}: has no parameters; expected Lmax, nmax, rmin, rmax and modelname")
    if some := [name for name in NOT_ALL if given.get(name)]:
        raise StreamkitError(f"{path}: {some[0]} leaves out functions; expected a basis with all of them")
    if not isinstance(given.get("modelname"), str):
        raise StreamkitError(f"{path}: has no modelname, the file of its spherical model")
    settings: dict[str, Any] = {name: bool(given.get(name)) for name in FLAGS}
    for name in (*DEFAULTS, "rmin", "rmax"):
        value = given.get(name, DEFAULTS.get(name))
        settings[name] = None if value is None else number_of(path, name, value)
    for name, most in (("Lmax", LARGEST_L), ("nmax", LARGEST_N)):
        if not (settings[name] == int(settings[name]) and (name == "nmax") <= settings[name] <= most):
            raise StreamkitError(f"{path}: {name} is {settings[name]:g}; expected a whole number up to {most}")
    if not (settings["scale"] > 0 and settings["rmapping"] > 0 and 10 <= settings["numr"] <= 1e6):
        raise StreamkitError(f"{path}: expected a positive scale and rmapping, and numr from 10 to 1e6")
    if settings["cmap"] not in (0, 1, 2):
        raise StreamkitError(f"{path}: cmap is {settings['cmap']:g}; expected 0, 1 or 2")
    return settings | {name: given.get(name) for name in ("modelname", "cachename")}


def basis_of(path: Path, settings: dict[str, Any]) -> Basis:
    """Return the basis of a file in YAML with these settings: its model is beside it, and its cache may be."""
    file = path.parent / settings["modelname"]
    model = _model(file)
    first, last = float(model.radius[0]), float(model.radius[-1])
    low = first if settings["rmin"] is None else max(settings["rmin"], first)
    high = 0.99 * last if settings["rmax"] is None or settings["rmax"] > last else settings["rmax"]
    if not 0 < low < 0.5 * high:
        raise StreamkitError(f"{path}: the basis is from {low:g} to {high:g}; expected rmin far below rmax")
    nodes = _nodes(low, high, settings)
    try:
        basis = Basis(model, int(settings["Lmax"]), int(settings["nmax"]), low, high, nodes[FIDUCIAL])
    except StreamkitError as error:
        raise StreamkitError(f"{file}: {error}") from None
    cache = path.parent / str(settings["cachename"])
    if settings["cachename"] and cache.is_file():
        _compare(cache, basis, nodes)
    return basis


def _nodes(low: float, high: float, settings: dict[str, Any]) -> Array:
    """(numr,) The radii of EXP's own tables."""
    count, scale = int(settings["numr"]), settings["rmapping"]
    if settings["cmap"] == 1:
        x = np.linspace(*((r - scale) / (r + scale) for r in (low, high)), count)
        return np.asarray(scale * (1 + x) / (1 - x))
    return np.geomspace(low, high, count) if settings["cmap"] == 2 else np.linspace(low, high, count)


def _model(path: Path) -> Model:
    """Return the spherical model: a count, and rows with radius, density, mass and potential."""
    lines = [line for line in text_of(path, MOST_MODEL).splitlines() if line.strip() and not set(line) & set("#!")]
    try:
        count = int(lines[0].split()[0])
        rows = np.array([[float(x) for x in line.split()[:4]] for line in lines[1 : count + 1]])
    except (ValueError, IndexError):
        rows = count = 0
    if not (np.ndim(rows) == 2 and rows.shape == (count, 4) and count >= FEWEST_ROWS and np.isfinite(rows).all()):
        raise StreamkitError(
            f"{path}: expected a model of EXP: the number of rows, {FEWEST_ROWS} or more, then so many rows with "
            "radius, density, mass and potential"
        )
    radius, density, _, potential = rows.T
    if not (radius[0] > 0 and (np.diff(radius) > 0).all() and (density >= 0).all() and (potential < 0).all()):
        raise StreamkitError(f"{path}: expected radii that grow, densities of 0 or more, and potentials below 0")
    return Model(radius, density, potential)


def _compare(file: Path, basis: Basis, nodes: Array) -> None:
    """Take the signs of EXP's own functions, and refuse those of another basis."""

    def read_cache(data: Any) -> list[tuple[Array, Array]]:
        harmonics = group_of(file, data, "Harmonic")
        groups = [group_of(file, harmonics, str(n)) for n in range(len(basis.eigenvalues))]
        return [tuple(numbers_of(file, group, name) for name in ("ev", "ef")) for group in groups]  # type: ignore[misc]

    try:
        found = read_foreign(file, read_cache)
    except DamagedError as error:
        raise StreamkitError(f"{file}: cannot be read as HDF5: {error}") from None
    shape = basis.eigenvalues.shape[1], len(nodes)
    theirs = np.array([ev.ravel() for ev, _ in found if ev.size == shape[0]])
    if (
        theirs.shape != basis.eigenvalues.shape
        or any(ef.shape != shape for _, ef in found)
        or not (np.abs(theirs / basis.eigenvalues - 1) < SAME_BASIS).all()
    ):
        raise StreamkitError(f"{file}: belongs to another basis, or to another version of EXP: remove it, or the model")
    ours = basis(nodes)
    basis.turn(np.array([(-ours[n] * ef).sum(axis=1) for n, (_, ef) in enumerate(found)]))


