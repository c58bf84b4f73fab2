"""The N-body extracts as streams, and the model started from the same progenitor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import GYR, LEADING, TRAILING, Integrator, Orbit, Stream, load
from streamkit.builtin.potentials.closed_forms import NFW, Plummer
from streamkit.engine import Field, build_field
from streamkit.model import NODE, Host, Model, Satellite
from streamkit.model.integrate import integrate
from streamkit.model.release import Start
from streamkit.nbody import as_stream
from streamkit.nbody.snapshot import Snapshot
from streamkit.runfile import Spec

DATA = Path(__file__).parents[1] / "data"
HOSTS = {
    "A": {"kind": "nfw_m200", "m200": 7.5e11, "c200": 20.0},
    "B": {"kind": "tf", "v0": 210.0, "rs": 12.0, "alpha": 0.45},
}
LOOKBACK = {"A": 4.31, "B": 3.77}


def arrays_of(file: str) -> dict[str, np.ndarray]:
    """The arrays of a file of tests/data, by name."""
    with np.load(DATA / file) as opened:
        return dict(opened)


def run_file(name: str, particles: int = 10000, **stripping: Any) -> Spec:
    """mLCS from the N-body's own progenitor today, at the true parameters."""
    seed = stripping.pop("seed", 1)
    return load(document(name, seed, {"kind": "mlcs", "particles": particles, "sigma": 10.0, **stripping}))


def document(name: str, seed: int, stripping: dict[str, Any], **progenitor: Any) -> dict[str, Any]:
    """A run file with the N-body's own progenitor today."""
    w = arrays_of(f"nbody_{name}.npz")["prog_xv"]
    place = dict(zip(("x", "y", "z", "vx", "vy", "vz"), map(float, w), strict=True))
    plummer = {"kind": "plummer", "mass": 6.4e8, "radius": 0.85, **place, "lookback": LOOKBACK[name]}
    return {"seed": seed, "potential": HOSTS[name], "progenitor": plummer | progenitor, "stripping": stripping}


def model_stream(name: str, particles: int = 10000, **stripping: Any) -> Stream:
    return Model(run_file(name, particles, **stripping)).stream()


def nbody_stream(name: str) -> Stream:
    return as_stream(nbody_snapshot(name), run_file(name).bind())


def nbody_snapshot(name: str) -> Snapshot:
    """The N-body extract, as its file tells it."""
    data = arrays_of(f"nbody_{name}.npz")
    scale = np.array([[GYR], *6 * [[1.0]]])
    return Snapshot(
        source=f"nbody_{name}.npz",
        q=data["x"].astype(float),
        v=data["v"].astype(float),
        t_strip=data["t_strip"] * GYR,
        winding=np.radians(data["winding"].astype(float)),
        chi=data["chi"] * GYR,
        core=data["orbit_txv"].T * scale,
    )


def reference_stream() -> tuple[Field, Orbit, np.ndarray, np.ndarray, np.ndarray]:
    """Field, progenitor's orbit, release times (n,) and release q, v (3, n) of the reference stream."""
    data = arrays_of("nfw_stream.npz")
    host = Host({"halo": NFW(mass=3.584843593e11, rs=9.370845158)})
    start = data["progenitor_start"]
    track = host.alone.orbit(start[:3], start[3:], -float(data["lookback"]) * GYR, 0.0, NODE)
    plummer = Plummer(mass=6.4e8, radius=0.85)
    orbit = replace(track, r_tidal=Satellite(plummer, plummer.mass).tidal_radius(host.tidal_bracket(track)))
    field = host.alone.with_moving(build_field([plummer]), orbit)
    q, v = np.ascontiguousarray(data["release"].T[:3]), np.ascontiguousarray(data["release"].T[3:])
    return field, orbit, data["t_release"] * GYR, q, v


def started(orbit: Orbit, t: np.ndarray, q: np.ndarray, v: np.ndarray) -> Start:
    """Particles at q, v (3, n), released at times t (n,)."""
    return Start(orbit, orbit.at(t), np.where(np.arange(len(t)) % 2 == 0, LEADING, TRAILING), q, v)


def reference_errors(integrator: Integrator) -> np.ndarray:
    """(n,) Position errors in kpc of its escaped particles, against an independent code's converged answer."""
    field, orbit, t, q, v = reference_stream()
    final = arrays_of("nfw_stream.npz")["final"].T[:3]
    escaped = np.sqrt(((final - orbit.q[:, -1:]) ** 2).sum(axis=0)) > 2 * orbit.r_tidal[-1]
    done = integrate(field, integrator, started(orbit, t, q, v))
    return np.asarray(np.sqrt(((done.q - final) ** 2).sum(axis=0))[escaped])
