"""Snapshots in the Gadget-HDF5 layout. Each snapshot is also a checkpoint: a run can continue from it."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import Array
from streamkit.errors import ChainError
from streamkit.report import DamagedError, read_foreign, save, through_memory
from streamkit_nbody.plan import digest
from streamkit_nbody.simulation import Simulation
from streamkit_nbody.state import State, Track

UNITS = {
    "UnitLength_in_cm": 3.0856775814913673e21,  # kpc
    "UnitMass_in_g": 1.98840987e33,  # Msun
    "UnitVelocity_in_cm_per_s": 1e5,  # km/s
}
PARTICLES = "PartType1"
LENGTH, SPEED, TIME, MASS = "kpc", "km/s", "kpc/(km/s)", "Msun"
BOUND = -1.0  # stripping time of a particle that has not been stripped


def write(path: Path, simulation: Simulation, state: State, content: dict[str, Any]) -> None:
    """Write a state, whole or not at all, with the `plan.content` of its run; a file that exists is replaced."""

    def fill(memory: BytesIO) -> None:
        import h5py

        with h5py.File(memory, "w") as file:
            _write_header(file, simulation, state, content)
            _write_particles(file.create_group(PARTICLES), simulation, state)
            _write_track(file.create_group("Progenitor"), simulation, state)

    save(path, through_memory(fill))


def _write_header(file: Any, simulation: Simulation, state: State, content: dict[str, Any]) -> None:
    count = np.array([0, simulation.plan.particles, 0, 0, 0, 0], dtype=np.int64)
    header = file.create_group("Header").attrs
    header.update(UNITS)
    header.update(
        Time=state.time, Redshift=0.0, BoxSize=0.0, HubbleParam=1.0, Omega0=0.0, OmegaLambda=0.0,
        NumPart_ThisFile=count, NumPart_Total=count, NumPart_Total_HighWord=np.zeros(6, dtype=np.int64),
        MassTable=np.zeros(6), NumFilesPerSnapshot=1, Flag_DoublePrecision=1,
        TimeBeforeToday=simulation.plan.span - state.time, Softening=simulation.plan.softening,
    )  # fmt: skip
    file.create_group("Parameters").attrs.update(UNITS)
    run = file.create_group("Run").attrs
    run.update(digest=digest(content), content=json.dumps(content), binding_energy=state.binding)


def _write_particles(group: Any, simulation: Simulation, state: State) -> None:
    n = simulation.plan.particles
    stripped = ~state.bound & (state.gap > 0.0)
    _dataset(group, "Coordinates", state.q.T, LENGTH, "Galactocentric")
    _dataset(group, "Velocities", state.v.T, SPEED, "Galactocentric")
    _dataset(group, "Accelerations", state.a.T, "(km/s)^2/kpc", "by the host and the particles")
    _dataset(group, "Masses", np.full(n, simulation.gravity.mass), MASS, "")
    _dataset(group, "ParticleIDs", np.arange(n), "", "their order at the start")
    last = np.where(stripped, state.t_strip, BOUND)
    _dataset(group, "StrippingTime", last, TIME, "last time inside the tidal radius; -1: bound or inside")
    winding = state.winding(simulation.plane)
    _dataset(group, "Winding", winding, "rad", "angle swept minus the satellite's; positive leads")
    _dataset(group, "Bound", state.bound.astype(np.int8), "", "1: bound to the satellite")
    _dataset(group, "TidalGap", state.gap, LENGTH, "distance from the satellite minus the tidal radius")
    _dataset(group, "LastInside", state.t_strip, TIME, "as StrippingTime, of all particles")
    _dataset(group, "StrippingOffset", state.dq_strip.T, LENGTH, "from the satellite at the last record inside")
    _dataset(group, "StrippingVelocity", state.dv_strip.T, SPEED, "from the satellite at the last record inside")
    _dataset(group, "Revolutions", state.revolutions, "", "about the Galactic centre in the orbital plane")


def _write_track(group: Any, simulation: Simulation, state: State) -> None:
    track, orbit = state.track, simulation.orbit.at(state.track.t - simulation.plan.span)
    group.attrs.update(Position=track.q[:, -1], Velocity=track.v[:, -1], BoundMass=track.mass[-1])
    _dataset(group, "Times", track.t, TIME, "since the start")
    _dataset(group, "Coordinates", track.q.T, LENGTH, "of the satellite: the mean of its most bound half")
    _dataset(group, "Velocities", track.v.T, SPEED, "of the same")
    _dataset(group, "BoundMass", track.mass, MASS, "")
    _dataset(group, "TidalRadius", track.r_tidal, LENGTH, "for the bound mass")
    _dataset(group, "Energy", track.energy, "Msun (km/s)^2", "of all particles in the host")
    _dataset(group, "PointMassCoordinates", orbit.q.T, LENGTH, "the orbit without mass loss")


def _dataset(group: Any, name: str, values: Any, unit: str, what: str) -> None:
    attributes = group.create_dataset(name, data=values).attrs
    attributes["unit"], attributes["description"] = unit, what


def read(path: Path) -> tuple[State, dict[str, Any]]:
    """Read a state and the content of its run; ChainError if the file is no readable snapshot of this package."""
    try:
        state, content, stated = read_foreign(path, _read)
    except DamagedError as error:
        raise ChainError(f"{path}: cannot be read as a checkpoint of streamkit-nbody: {error}") from None
    if digest(content) != stated:
        raise ChainError(f"{path}: its content does not match its digest {str(stated)[:12]}: the file was changed")
    return state, content


def _read(file: Any) -> tuple[State, dict[str, Any], str]:
    run, p, track = file["Run"].attrs, file[PARTICLES], file["Progenitor"]
    state = State(
        q=_rows(p["Coordinates"]),
        v=_rows(p["Velocities"]),
        a=_rows(p["Accelerations"]),
        bound=p["Bound"][:].astype(bool),
        gap=p["TidalGap"][:],
        t_strip=p["LastInside"][:],
        dq_strip=_rows(p["StrippingOffset"]),
        dv_strip=_rows(p["StrippingVelocity"]),
        revolutions=p["Revolutions"][:],
        track=Track(
            track["Times"][:], _rows(track["Coordinates"]), _rows(track["Velocities"]),
            track["BoundMass"][:], track["TidalRadius"][:], track["Energy"][:],
        ),
        binding=float(run["binding_energy"]),
    )  # fmt: skip
    return state, json.loads(run["content"]), run["digest"]


def _rows(data: Any) -> Array:
    return np.ascontiguousarray(data[:].T)
