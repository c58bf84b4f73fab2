"""The tidal radius of a progenitor by the mass that counts, and its crossing by the debris."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from snapshots import run_file

from streamkit import GYR, G, Model, Prediction
from streamkit.builtin.integrators.fixed_step import ForestRuth
from streamkit.builtin.observables.apocentres.observable import Apocentres
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist, Kepler, Logarithmic, Plummer
from streamkit.components.bases import Integrator
from streamkit.model import Host, Satellite, next_apocentre

BRACKET = np.array([30.0, 300.0, 3000.0])  # omega^2 - d2Phi/dr2 in (km/s/kpc)^2


@pytest.mark.parametrize("potential", [Plummer(mass=6.4e8, radius=0.85), Hernquist(mass=6.4e8, a=0.5)])
def test_a_total_mass_counts_whole(potential):
    """Gibbons+ 2014, equation 1: r_t^3 = G M / bracket."""
    assert Satellite(potential, 6.4e8).tidal_radius(BRACKET) == pytest.approx(np.cbrt(G * 6.4e8 / BRACKET), rel=1e-14)


@pytest.mark.parametrize("left", [1.0, 0.4])
def test_of_a_scale_mass_what_is_inside_the_tidal_radius_counts(left):
    """r_t^3 = G M(<r_t) / bracket, with M(<r) = M [ln(1 + x) - x / (1 + x)] of the NFW profile."""
    satellite = Satellite(NFW(mass=6.4e8, rs=2.0), 6.4e8)
    r = satellite.shrunk(satellite.tidal_radius(BRACKET), np.full(3, left))
    x = r / 2.0
    inside = left * 6.4e8 * (np.log1p(x) - x / (1 + x))
    assert r**3 == pytest.approx(G * inside / BRACKET, rel=1e-9)
    assert (r < np.cbrt(G * left * 6.4e8 / BRACKET)).all()


def test_a_track_without_a_tidal_radius_stays_without():
    satellite = Satellite(NFW(mass=6.4e8, rs=2.0), 6.4e8)
    assert np.isnan(satellite.tidal_radius(np.array([300.0, np.nan]))).tolist() == [False, True]


def test_the_crossing_is_where_and_when_the_tidal_radius_is_crossed(monkeypatch):
    """At the stripping time the debris is at r_t, whatever the length of the blocks.

    Blocks of 50 Myr against blocks of 2 Myr, in which nothing moves far: half of the particles are within 2 % of r_t
    and within 1 km/s of where the short blocks find them.
    """
    spec = run_file("B", 600).with_values({"integrator.kind": ForestRuth.kind, "integrator.step": 0.002})
    stream = Model(spec).stream()
    monkeypatch.setattr(Integrator, "longest_block", 0.002)
    fine = Model(spec).stream()
    some = (stream.arm != 0) & (fine.arm != 0) & (np.abs(stream.t_strip - fine.t_strip) < 0.05 * GYR)
    assert some.sum() > 100
    away = np.sqrt((stream.dq_strip**2).sum(axis=0)) / stream.orbit.at(stream.t_strip).r_tidal
    assert np.median(np.abs(away[some] - 1)) < 0.02
    assert np.percentile(np.abs(away[some] - 1), 95) < 0.2
    kick = np.sqrt(((stream.dv_strip - fine.dv_strip) ** 2).sum(axis=0))
    assert np.median(kick[some]) < 1.0


def circle(r: float, speed: float) -> dict[str, object]:
    return {"progenitor.x": r, "progenitor.y": 0.0, "progenitor.z": 0.0, "progenitor.vx": 0.0, "progenitor.vy": speed,
            "progenitor.vz": 0.0}  # fmt: skip


def test_the_next_apocentre_is_found_up_to_6_gyr_ahead():
    """A Kepler orbit at its pericentre: half its period, 5 Gyr, to the apocentre."""
    mass, e = 1e11, 0.3
    a = np.cbrt(G * mass * (10.0 * GYR / (2 * np.pi)) ** 2)  # of the period 10 Gyr
    speed = np.sqrt(G * mass / a * (1 + e) / (1 - e))
    inputs = run_file("B", 10).with_values(circle(a * (1 - e), float(speed))).bind()
    ahead = next_apocentre(Host({"point": Kepler(mass=mass)}), inputs)
    assert ahead is not None
    assert ahead.apocentres()[0] == pytest.approx(5.0 * GYR, rel=1e-5)


def test_the_next_apocentre_is_looked_for_when_somebody_asks(monkeypatch):
    asked = []
    monkeypatch.setattr("streamkit.model.model.next_apocentre", lambda *_: asked.append(1))
    stream = Model(run_file("B", 10)).stream()
    assert not asked
    assert stream.future is None
    assert stream.future is None
    assert len(asked) == 1


def test_a_pickled_stream_has_its_next_apocentre():
    stream = Model(run_file("B", 10)).stream()
    copy = pickle.loads(pickle.dumps(stream))
    assert np.array_equal(copy.future.q, stream.future.q)


def test_a_stream_in_a_notebook_is_one_line():
    stream = Model(run_file("B", 50)).stream()
    assert repr(stream).startswith("<Stream of 50 particles: ")
    assert len(repr(stream)) < 100
    assert len(stream._repr_html_()) < 5000
    prediction = Apocentres().predict(stream)
    assert len(repr(prediction)) < 200
    assert prediction.why_not in prediction._repr_html_()
    value = Prediction(("leading",), np.array([57.0]), np.array([0.25]))
    assert repr(value) == "<Prediction: leading 57 +- 0.5>"
    assert "<td>leading</td><td>57</td><td>0.5</td>" in value._repr_html_()


def test_a_host_without_an_end_holds_everything():
    """A logarithmic potential grows without limit."""
    halo = Host({"halo": Logarithmic(**Logarithmic.example)})
    assert halo.unbinds(np.array([20.0, 0, 0]), np.array([0, 2000.0, 0])) is False
