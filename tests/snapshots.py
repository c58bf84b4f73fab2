"""The N-body extracts as streams, and the model started from the same progenitor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from streamkit import GYR, Orbit, Stream, load
from streamkit.engine import build_field
from streamkit.model import Model, next_apocentre
from streamkit.spec import Spec

DATA = Path(__file__).parent / "data"
HOSTS = {
    "A": {"kind": "nfw_m200", "m200": 7.5e11, "c200": 20.0},
    "B": {"kind": "tf", "v0": 210.0, "rs": 12.0, "alpha": 0.45},
}
LOOKBACK = {"A": 4.31, "B": 3.77}


def run_file(name: str, particles: int = 10000, **stripping: Any) -> Spec:
    """mLCS from the N-body's own progenitor today, at the true parameters."""
    w = np.load(DATA / f"nbody_{name}.npz")["prog_xv"]
    return load(
        {
            "seed": stripping.pop("seed", 1),
            "potential": HOSTS[name],
            "progenitor": {
                "kind": "plummer",
                "mass": 6.4e8,
                "radius": 0.85,
                **dict(zip(("x", "y", "z", "vx", "vy", "vz"), map(float, w), strict=True)),
                "lookback": LOOKBACK[name],
            },
            "stripping": {"kind": "mlcs", "particles": particles, "sigma": 10.0, **stripping},
        }
    )


def model_stream(name: str, particles: int = 10000, **stripping: Any) -> Stream:
    return Model(run_file(name, particles, **stripping)).stream()


def nbody_stream(name: str) -> Stream:
    data = np.load(DATA / f"nbody_{name}.npz")
    setup = run_file(name).bind({})
    host = build_field(list(setup.potentials.values()))
    t, *w = data["orbit_txv"].T
    q, v = np.ascontiguousarray(w[:3]), np.ascontiguousarray(w[3:])
    orbit = Orbit(t * GYR, q, v, host.acceleration(0.0, q), np.full(len(t), np.nan))
    n = len(data["t_strip"])
    return Stream(
        q=data["x"].astype(float),
        v=data["v"].astype(float),
        t_release=np.full(n, t[0] * GYR),
        t_strip=data["t_strip"] * GYR,
        dq_strip=np.full((3, n), np.nan),
        dv_strip=np.full((3, n), np.nan),
        tail=np.ones(n, dtype=np.int64),
        winding=np.radians(data["winding"].astype(float)),
        chi=data["chi"] * GYR,
        bound=np.zeros(n, dtype=bool),
        orbit=orbit,
        future=next_apocentre(host, setup),
    )
