"""A progenitor that loses mass in step with the release of its particles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from snapshots import model_stream, nbody_stream, run_file

from streamkit import G, Model, SpecError
from streamkit.builtin.observables.apocentres.observable import Apocentres
from streamkit.builtin.potentials.closed_forms import Plummer, TruncatedFlat
from streamkit.study.ablation.measures import portrait

LOST = 1 - 0.662  # of the mass of the live satellite of run B, in 3.77 Gyr (its README)


def independent(spec, stream, i, loss):
    """Final place of particle i by SciPy: host by formula, a Plummer sphere whose mass falls linearly with time."""
    host = TruncatedFlat(v0=210, rs=12, alpha=0.45).in_engine_units()
    begin = stream.orbit.t[0]

    def rate(t, w):
        (x, u), (y, s) = w[:6].reshape(2, 3), w[6:].reshape(2, 3)
        d = x - y
        mass = 6.4e8 * (1 - loss * (t - begin) / -begin)
        pull = -G * mass * d / (d @ d + 0.85**2) ** 1.5
        return np.concatenate(
            [u, np.add(TruncatedFlat.acceleration(*x, t, *host), pull), s, TruncatedFlat.acceleration(*y, t, *host)]
        )

    t = stream.t_release[i]
    here = stream.orbit.at(t)
    release = spec.bind().stripping.release(here, stream.tail[[i]], 6.4e8, Model(spec).normals[:, [i]])
    start = np.concatenate([release.q[:, 0], release.v[:, 0], here.q[:, 0], here.v[:, 0]])
    return solve_ivp(rate, (t, 0), start, method="DOP853", rtol=1e-11, atol=1e-9).y[:3, -1]


def test_particles_feel_the_mass_that_is_left():
    """Particles that escape early end where an independent integration with M(t) puts them, and not where M = const."""
    spec = run_file("B", 200, mass_loss=0.5).with_values({"integrator.eta": 0.15, "integrator.eta_progenitor": 0.1})
    stream, constant = Model(spec).stream(), model_stream("B", 200)
    direct = ~stream.bound & (stream.t_strip - stream.t_release < 0.3)  # no close encounters: those are chaotic
    chosen = np.flatnonzero(direct)[:: max(direct.sum() // 8, 1)]

    assert len(chosen) >= 5
    for i in chosen:
        expected = independent(spec, stream, i, 0.5)
        assert np.linalg.norm(stream.q[:, i] - expected) < 2e-3
        assert np.linalg.norm(constant.q[:, i] - expected) > 0.05


def test_the_tidal_radius_follows_the_cube_root_of_the_mass_and_the_mass_the_releases():
    burst = model_stream("B", 2000, mass_loss=0.4, release_times="pericentre").orbit
    full = model_stream("B", 2000).orbit
    released = model_stream("B", 2000, mass_loss=0.4, release_times="pericentre").t_release
    gone = np.searchsorted(released, burst.t) / 2000

    assert burst.mass_left == pytest.approx(1 - 0.4 * gone, abs=2e-3)
    assert burst.r_tidal == pytest.approx(full.r_tidal * np.cbrt(burst.mass_left), rel=1e-12)
    assert (full.mass_left == 1).all()


def test_the_release_is_at_the_tidal_radius_of_the_mass_that_is_left():
    spec = run_file("B", 400, mass_loss=0.6, sigma=0.001)
    stream = Model(spec).stream()
    last = spec.bind().stripping.release(stream.orbit.at(stream.t_release), stream.tail, 1.0, Model(spec).normals)
    distance = np.sqrt(((last.q - stream.orbit.at(stream.t_release).q) ** 2).sum(axis=0))
    full = model_stream("B", 2).orbit
    left = 0.4 + 0.6 * stream.t_release / full.t[0]

    assert distance == pytest.approx(np.interp(stream.t_release, full.t, full.r_tidal) * np.cbrt(left), rel=5e-3)


@pytest.mark.parametrize("name", ["A", "B"])
def test_the_leading_apocentre_agrees_with_nbody(name):
    """Mass loss of the live satellite is most of what a constant mass gets wrong in the leading arm of A."""
    rule = Apocentres(recent_debris="epoch_aware")
    wanted = rule.predict(nbody_stream(name)).mean[0]
    off = {loss: abs(rule.predict(model_stream(name, mass_loss=loss)).mean[0] - wanted) for loss in (0.0, LOST)}

    assert off[LOST] < 1.0
    if name == "A":
        assert off[LOST] < 0.5 * off[0.0]


@pytest.mark.parametrize("loss", [1.0, -0.1, "much"])
def test_a_loss_that_is_no_fraction_is_refused(loss):
    with pytest.raises(SpecError, match=r"stripping\.mass_loss"):
        run_file("B", mass_loss=loss)


def test_any_scheme_and_any_progenitor_can_lose_mass():
    spec = run_file("B", 400, mass_loss=0.3).with_values({"stripping.kind": "streakline"})

    assert spec.bind().stripping.mass_loss == 0.3
    assert portrait(spec).stream.orbit.mass_left[-1] == pytest.approx(0.7)
    assert spec.bind().satellite.kind == Plummer.kind
