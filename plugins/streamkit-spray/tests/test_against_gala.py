"""Our draws against gala's, by distribution, in the progenitor's frame: same state, same tidal radius."""

import astropy.units as u
import gala.dynamics as gd
import gala.potential as gp
import numpy as np
import pytest
from gala.dynamics import mockstream as ms
from gala.units import galactic
from scipy.stats import ks_2samp
from streamkit_spray import Chen25, Fardal15, Fardal15Gala

from streamkit import LEADING, TRAILING, G, Orbit

MASS = 6.4e8
COUNT = 20000
Q, V = np.array([18.0, -6.0, 11.0]), np.array([40.0, 150.0, -120.0])  # kpc, km/s


@pytest.fixture(scope="module")
def progenitor():
    """The progenitor at one time, as gala's orbit, in a flattened halo."""
    halo = gp.MiyamotoNagaiPotential(m=4e11 * u.Msun, a=4 * u.kpc, b=8 * u.kpc, units=galactic)
    frame = gp.StaticFrame(galactic)
    orbit = gd.Orbit(pos=Q[:, None] * u.kpc, vel=V[:, None] * u.km / u.s, t=[0.0] * u.Myr, frame=frame)
    return gp.Hamiltonian(halo), orbit


def gala_offsets(progenitor, df):
    """(2, 6, COUNT) of leading and trailing particles: offsets and kicks along e_r, e_phi, e_z."""
    hamiltonian, orbit = progenitor
    stream = df.sample(orbit, MASS * u.Msun, hamiltonian=hamiltonian, n_particles=COUNT)
    q, v = stream.xyz.to_value(u.kpc), stream.v_xyz.to_value(u.km / u.s)
    return np.stack([offsets(q[:, stream.lead_trail == k], v[:, stream.lead_trail == k]) for k in "lt"])


def offsets(q, v):
    """(6, n) offsets from the progenitor along e_r, e_phi, e_z."""
    e_r = Q / np.linalg.norm(Q)
    e_z = np.cross(Q, V) / np.linalg.norm(np.cross(Q, V))
    axes = np.stack([e_r, np.cross(e_z, e_r), e_z])
    return np.concatenate([axes @ (q - Q[:, None]), axes @ (v - V[:, None])])


@pytest.fixture(scope="module")
def state(progenitor):
    """The progenitor as streamkit's orbit, with the tidal radius that gala uses: its streakline shows it."""
    lead = gala_offsets(progenitor, ms.StreaklineStreamDF())[0, :, 0]
    r_tidal = -lead[0]
    omega = np.linalg.norm(np.cross(Q, V)) / (Q @ Q)
    assert np.allclose(lead, [-r_tidal, 0, 0, 0, -omega * r_tidal, 0], atol=1e-8)
    one = np.ones(COUNT)
    return Orbit(0 * one, np.outer(Q, one), np.outer(V, one), np.zeros((3, COUNT)), r_tidal * one)


def test_the_tidal_radius_is_the_one_of_the_formula(progenitor, state):
    """r_t^3 = G M / (Omega^2 - d^2 Phi/dr^2), with gala's own Hessian."""
    e_r = Q / np.linalg.norm(Q)
    hessian = progenitor[0].potential.hessian(Q * u.kpc).to_value((u.km / u.s / u.kpc) ** 2).reshape(3, 3)
    wanted = np.cbrt(G * MASS / (state.omega[0] ** 2 - e_r @ hessian @ e_r))
    assert state.r_tidal[0] == pytest.approx(wanted, rel=1e-4)


def our_offsets(state, scheme):
    clouds = []
    for seed, tail in enumerate((LEADING, TRAILING)):
        normals = np.random.default_rng(seed).standard_normal((scheme.draws, COUNT))
        release = scheme.release(state, np.full(COUNT, tail), MASS, normals)
        clouds.append(offsets(release.q, release.v))
    return np.stack(clouds)


def smallest_p(ours, theirs):
    """Smallest Kolmogorov-Smirnov p-value of the components that vary."""
    moving = [k for k in range(6) if theirs[k].std() > 1e-6]
    return min(ks_2samp(ours[k], theirs[k]).pvalue for k in moving)


CASES = {
    "fardal15": (Fardal15(), lambda rng: ms.FardalStreamDF(gala_modified=False, random_state=rng)),
    "fardal15_gala": (Fardal15Gala(), lambda rng: ms.FardalStreamDF(gala_modified=True, random_state=rng)),
    "chen25": (Chen25(), lambda rng: ms.ChenStreamDF(random_state=rng)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_same_distribution(progenitor, state, name):
    scheme, df = CASES[name]
    theirs = gala_offsets(progenitor, df(np.random.RandomState(42)))
    ours = our_offsets(state, scheme)
    for mine, other in zip(ours, theirs, strict=True):
        spread = other.std(axis=1) + 1e-6
        assert (np.abs(mine.mean(axis=1) - other.mean(axis=1)) < 5 * spread * np.sqrt(2 / COUNT)).all()
        scaled = np.abs(np.cov(mine) - np.cov(other)) / np.outer(spread, spread)
        assert (scaled < 5 * np.sqrt(8 / COUNT)).all()
        assert smallest_p(mine, other) > 1e-3


def test_the_variants_are_told_apart(progenitor, state):
    """The comparison has teeth: the paper's constants are not gala's variant."""
    theirs = gala_offsets(progenitor, CASES["fardal15_gala"][1](np.random.RandomState(1)))
    assert smallest_p(our_offsets(state, Fardal15())[1], theirs[1]) < 1e-10
