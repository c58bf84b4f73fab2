"""Hosts that move: the Milky Way with the Large Magellanic Cloud, against published and independent numbers.

The tables are those of a separate calculation in SciPy, with AGAMA's coordinates of the LMC (Vasiliev 2019, example
of the interaction of the LMC and the Milky Way), the host of gala's MilkyWayPotential, and Hernquist spheres that keep
v_c(8.7 kpc) = 91.7 km/s (Erkal+ 2019).
"""

import functools
import operator
from dataclasses import replace

import numpy as np
import pytest
from galpy import potential as gp
from galpy.orbit import Orbit as GalpyOrbit
from runfiles import changed
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.special import erf

import streamkit as sk
from streamkit.builtin.integrators.adaptive import Adaptive
from streamkit.builtin.integrators.reference import Reference
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist, Kepler, MiyamotoNagai, Plummer, TruncatedFlat
from streamkit.engine import Centre, Friction, build_field, follow_bodies
from streamkit.model import NODE, Host, progenitor_track, simulate, standard_normals
from streamkit.runfile import Body
from streamkit.stream import Observer, to_galactocentric

MILKY_WAY = {
    "bulge": Hernquist(mass=5e9, a=1.0),
    "nucleus": Hernquist(mass=1.71e9, a=0.07),
    "disc": MiyamotoNagai(mass=6.8e10, a=3.0, b=0.28),
    "halo": NFW(mass=5.4e11, rs=15.62),
}
SUN = Observer(8.122, 0.0208, (12.9, 245.6, 7.78))
Q, V = to_galactocentric("icrs", 81.28, -69.78, 49.6, 1.858, 0.385, 262.2, SUN)


def cloud(mass, **settings):
    """The LMC: nothing of it is left where the mass is zero."""
    a = np.sqrt(sk.G * mass * 8.7 / 91.7**2) - 8.7 if mass > 1e9 else 1.0
    return Body(Hernquist(mass=max(mass, 1e-30), a=float(a)), Q, V, **settings)


def inputs_of(bodies, potentials=MILKY_WAY, particles=400, lookback=2.0, **stripping):
    """A Plummer sphere on an orbit like that of Sagittarius."""
    document = changed("potential", {name: {"kind": p.kind, **p.model_dump()} for name, p in potentials.items()})
    document["progenitor"] |= {"mass": 4e8, "lookback": lookback}
    document["stripping"] |= {"particles": particles, "sigma": 10.0, **stripping}
    return replace(sk.load(document).bind(), bodies=bodies)


def stream_of(inputs):
    return simulate(inputs, standard_normals(inputs.stripping, inputs.seed))


def test_today():
    assert np.allclose(Q, (-0.61, -41.02, -26.83), atol=0.005)
    assert np.allclose(V, (-69.9, -221.7, 214.2), atol=0.05)
    assert Host(MILKY_WAY).circular_velocity(np.array([8.122])) == pytest.approx(231.5, abs=0.05)


PATHS = {  # mass, friction: change of the Milky Way's velocity, its displacement
    (5e10, True): ((14.7, 19.0, 21.4, 22.8), (6.4, 16.6, 38.8)),
    (1.38e11, True): ((29.9, 39.6, 45.7, 49.8), (13.1, 34.5, 82.2)),
    (1.38e11, False): ((30.2, 40.5, 47.4, 52.7), (13.2, 35.2, 84.8)),
    (2.5e11, True): ((43.3, 59.2, 70.3, 78.0), (19.0, 51.3, 124.3)),
}
DISTANCES = {  # at -1, -2, -3 and -4 Gyr
    (0.0, True): (183.8, 265.8, 287.1, 253.8),
    (5e10, True): (183.2, 265.2, 285.9, 250.8),
    (1.38e11, True): (177.9, 249.8, 253.5, 189.6),
    (1.38e11, False): (160.4, 188.3, 110.2, 114.2),
    (2.5e11, True): (161.2, 201.0, 149.1, 89.7),
}


def followed(body, friction=None, end=-4.0):
    host = Host(MILKY_WAY)
    table = host._friction(end * sk.GYR) if friction is None else friction
    centre = Centre(body.potential, Q, V, body.reflex, body.mass if body.friction else 0.0, body.extent)
    path, (orbit,) = follow_bodies(list(MILKY_WAY.values()), [centre], table, end * sk.GYR, NODE)
    return path, orbit


@pytest.mark.parametrize(("mass", "friction"), PATHS)
def test_the_milky_way_recoils(mass, friction):
    path, _ = followed(cloud(mass, friction=friction))
    speeds, distances = PATHS[mass, friction]
    change = path.at(np.array([-0.25, -0.5, -1.0, -2.0]) * sk.GYR).v
    assert np.sqrt((change**2).sum(axis=0)) == pytest.approx(speeds, rel=0.01)
    assert path.at(np.array([-0.5, -1.0, -2.0]) * sk.GYR).r == pytest.approx(distances, rel=0.01)


def nfw_density(r):
    return 5.4e11 / (4 * np.pi * r * (r + 15.62) ** 2)


def mass_of_spheres(r):
    """Of all components inside r, the disc as a point."""
    halo = 5.4e11 * (np.log(1 + r / 15.62) - r / (r + 15.62))
    return halo + 5e9 * (r / (r + 1.0)) ** 2 + 1.71e9 * (r / (r + 0.07)) ** 2 + 6.8e10


@pytest.mark.parametrize(("mass", "friction"), DISTANCES)
def test_where_the_cloud_came_from(mass, friction):
    """The table says not which dispersion it took: 0.59 of the circular velocity gives all its distances.

    With the host's own, by Jeans's equation, the cloud of 1.38e11 is 6 % further away 4 Gyr ago.
    """
    ln_r = np.arange(0.0, 7.0, 0.02)
    radii = np.exp(ln_r)
    columns = nfw_density(radii) * radii**2, 0.59**2 * sk.G * mass_of_spheres(radii) / radii
    pieces = [CubicSpline(ln_r, y).c[::-1].T * 0.02 ** np.arange(4) for y in columns]
    table = np.ascontiguousarray(np.hstack(pieces))
    _, orbit = followed(cloud(mass, friction=friction), Friction(table[None], 0.0, 0.02, np.zeros(1)))
    times = np.array([-1.0, -2.0, -3.0, -4.0]) * sk.GYR
    assert orbit.at(times).r == pytest.approx(DISTANCES[mass, friction], rel=0.01)
    last = orbit.pericentres()[-1:]
    assert -0.0605 * sk.GYR < last < -0.0515 * sk.GYR
    assert 46.8 < orbit.at(last).r < 47.15


@pytest.mark.parametrize("mass", [5e10, 1.38e11, 2.5e11])
def test_friction_by_jeans_differs_little_in_the_last_gyr(mass):
    _, orbit = followed(cloud(mass), end=-1.0)
    assert orbit.r[0] == pytest.approx(DISTANCES[mass, True][0], rel=0.01)


@pytest.mark.parametrize("radius", [0.5, 8.0, 60.0, 400.0])
def test_density_and_dispersion_of_the_host(radius):
    """NFW: the density in closed form, the dispersion by Jeans's integral with quad."""

    def weighed(r):
        return nfw_density(r) * sk.G * 5.4e11 * (np.log(1 + r / 15.62) - r / (r + 15.62)) / r**2

    friction = Host({"halo": MILKY_WAY["halo"]})._friction(-1.0)
    assert list(friction.times) == [0.0]
    since = (np.log(radius) - friction.first) / friction.step
    s = since - int(since)
    column, dispersion2 = (np.polyval(c[::-1], s) for c in friction.table[0, int(since)].reshape(2, 4))
    assert column / radius**2 == pytest.approx(nfw_density(radius), rel=1e-3)
    wanted = quad(weighed, radius, np.inf, epsrel=1e-10)[0] / nfw_density(radius)
    assert dispersion2 == pytest.approx(wanted, rel=2e-3)


@pytest.mark.parametrize("potential", [Kepler(mass=1e11), TruncatedFlat(v0=210.0, rs=12.0, alpha=0.0)])
def test_friction_in_hosts_without_density_or_without_end(potential):
    """None in a Kepler host; s^2 = v0^2 / 2 in a singular isothermal sphere."""
    (table,) = Host({"host": potential})._friction(-1.0).table
    assert np.isfinite(table).all()
    if isinstance(potential, Kepler):
        assert np.abs(table[:, :4]).max() < 1e-5 * 1e11 / (4 * np.pi)
    else:
        assert table[:, 4] == pytest.approx(210.0**2 / 2, rel=3e-3)


def test_friction_in_a_growing_host_is_that_of_its_density_then():
    """An NFW halo that had half its mass: density and squared dispersion follow the factor; against SciPy."""
    t, factor, end = np.array([-3.0, -1.0, 0.0]) * sk.GYR, np.array([0.3, 0.8, 1.0]), -2.5 * sk.GYR
    halo = NFW(mass=5.4e11, rs=15.62, growth={"t": t / sk.GYR, "factor": factor})
    body = Body(Hernquist(mass=1e11, a=10.0), 0.8 * Q, 0.7 * V, reflex=False)
    found = Host({"halo": halo}, {"body": body}).paths(end).bodies["body"]

    def inside(r):
        return 5.4e11 * (np.log(1 + r / 15.62) - r / (r + 15.62))

    radii = np.geomspace(1.0, 1000.0, 200)
    pushes = [quad(lambda r: nfw_density(r) * sk.G * inside(r) / r**2, r, np.inf)[0] for r in radii]
    dispersion2 = CubicSpline(np.log(radii), np.array(pushes) / nfw_density(radii))

    def rates(now, w):
        x, v = w[:3], w[3:]
        d, speed, grown = np.sqrt(x @ x), np.sqrt(v @ v), np.interp(now, t, factor)
        s = speed / np.sqrt(2 * grown * dispersion2(np.log(d)))
        part = erf(s) - 2 * s / np.sqrt(np.pi) * np.exp(-(s**2))
        coulomb = np.sqrt(np.log(d / 20.0)) if d > 20 else 0.0
        slow = 4 * np.pi * sk.G**2 * 1e11 * grown * nfw_density(d) * coulomb * part / speed**3
        return np.concatenate([v, -sk.G * grown * inside(d) / d**3 * x - slow * v])

    done = solve_ivp(rates, (0, end), np.concatenate([body.q, body.v]), rtol=1e-9, atol=1e-9, max_step=0.02)
    assert found.q[:, 0] == pytest.approx(done.y[:3, -1], abs=0.1)
    still = replace(body, friction=False)
    free = Host({"halo": halo}, {"body": still}).paths(end).bodies["body"]
    assert np.abs(free.q[:, 0] - found.q[:, 0]).max() > 20


def test_a_body_without_mass_is_no_body():
    static, moved = (stream_of(inputs_of(bodies)) for bodies in ({}, {"lmc": cloud(0.0)}))
    assert np.allclose(moved.q, static.q, rtol=0, atol=1e-9)
    assert np.allclose(moved.v, static.v, rtol=0, atol=1e-8)
    assert np.allclose(moved.t_strip, static.t_strip, rtol=0, atol=1e-9)
    assert np.array_equal(moved.bound, static.bound)


def test_a_body_far_away_cancels():
    """It pulls everything alike, 4.3 (km/s)^2/kpc, unless the Milky Way is held: then all fall by a t^2 / 2."""
    far = Body(Kepler(mass=1e22), np.array([0.0, 0.0, 1e8]), np.zeros(3), friction=False)
    static, pulled = (stream_of(inputs_of(bodies, lookback=1.0)) for bodies in ({}, {"far": far}))
    assert np.allclose(pulled.q, static.q, rtol=0, atol=1e-4)
    held = Host(MILKY_WAY, {"far": replace(far, reflex=False)}).until(-sk.GYR)
    a = sk.G * 1e22 / 1e16
    pull = held.acceleration(-0.5, Q[:, None])[:, 0] - Host(MILKY_WAY).alone.acceleration(-0.5, Q[:, None])[:, 0]
    assert pull == pytest.approx([0, 0, a], abs=1e-5 * a)


def test_a_circular_body_in_a_held_host_is_at_rest_in_a_rotating_frame():
    """With Coriolis and centrifugal terms, by SciPy."""
    halo, sphere, radius = NFW(mass=5.4e11, rs=15.62), Plummer(mass=2e10, radius=3.0), 30.0
    inside = halo.mass * (np.log(1 + radius / halo.rs) - radius / (radius + halo.rs))
    omega = np.sqrt(sk.G * inside / radius**3)
    place = np.array([radius, 0.0, 0.0])
    body = Body(sphere, place, np.array([0.0, omega * radius, 0.0]), friction=False, reflex=False)
    q, v, end = np.array([-22.0, 9.0, 5.0]), np.array([60.0, 140.0, 70.0]), -2.0 * sk.GYR
    found = Host({"halo": halo}, {"sphere": body}).until(end).orbit(q, v, 0.0, end, NODE)

    def rates(t, w):
        x, u = w[:3], w[3:]
        r, d = np.sqrt(x @ x), x - place
        a = -sk.G * halo.mass * (np.log(1 + r / halo.rs) - r / (r + halo.rs)) * x / r**3
        a = a - sk.G * sphere.mass * d / (d @ d + sphere.radius**2) ** 1.5
        a = a + omega**2 * np.array([x[0], x[1], 0.0]) + 2 * omega * np.array([u[1], -u[0], 0.0])
        return np.concatenate([u, a])

    begin = np.concatenate([q, v - omega * np.array([-q[1], q[0], 0.0])])
    done = solve_ivp(rates, (0.0, end), begin, method="DOP853", rtol=1e-12, atol=1e-12)
    c, s = np.cos(omega * end), np.sin(omega * end)
    x, y, z = done.y[:3, -1]
    wanted = np.array([c * x - s * y, s * x + c * y, z])
    assert np.abs(found.q[:, 0] - wanted).max() < 1e-6 * np.sqrt(wanted @ wanted)


@pytest.mark.slow  # SciPy gives the same orbits above
def test_an_orbit_beside_the_cloud_is_galpys():
    """galpy's MovingObjectPotential and NonInertialFrameForce, with the Milky Way's path from SciPy."""
    body, end = cloud(1.38e11, friction=False), -0.5 * sk.GYR
    host = [
        gp.HernquistPotential(amp=2 * sk.G * 5e9, a=1.0),
        gp.HernquistPotential(amp=2 * sk.G * 1.71e9, a=0.07),
        gp.MiyamotoNagaiPotential(amp=sk.G * 6.8e10, a=3.0, b=0.28),
        gp.NFWPotential(amp=sk.G * 5.4e11, a=15.62),
    ]
    sphere = gp.HernquistPotential(amp=2 * sk.G * body.mass, a=body.potential.a)

    def force(potentials, x):
        r, z = np.hypot(x[0], x[1]), x[2]
        outward = sum(p.Rforce(r, z) for p in potentials) / r
        return np.array([outward * x[0], outward * x[1], sum(p.zforce(r, z) for p in potentials)])

    def rates(t, w):
        x0, v0, x1, v1 = w.reshape(4, 3)
        return np.concatenate([v0, force([sphere], x0 - x1), v1, force(host, x1 - x0)])

    begin = np.concatenate([np.zeros(6), Q, V])
    path = solve_ivp(rates, (0.0, end), begin, method="DOP853", rtol=1e-12, atol=1e-12, dense_output=True).sol
    times = np.linspace(0.0, end, 1601)
    x0, _, x1, _ = path(times).reshape(4, 3, -1)
    pulls = [CubicSpline(times[::-1], pull[::-1]) for pull in np.transpose([force([sphere], d) for d in (x0 - x1).T])]
    frame = gp.NonInertialFrameForce(a0=[lambda t, pull=pull: float(pull(t)) for pull in pulls])

    def cylindrical(q, v):
        r, phi = np.hypot(q[0], q[1]), np.arctan2(q[1], q[0])
        c, s = np.cos(phi), np.sin(phi)
        return [r, v[0] * c + v[1] * s, v[1] * c - v[0] * s, q[2], v[2], phi]

    lmc = GalpyOrbit(cylindrical(Q, V))
    milky_way = functools.reduce(operator.add, [*host, frame])
    lmc.integrate(1.05 * times, milky_way, method="dop853", progressbar=False)
    q, v = np.array([19.0, 0.5, -25.7]), np.array([120.0, 160.0, 190.0])
    theirs = GalpyOrbit(cylindrical(q, v))
    moving = gp.MovingObjectPotential(lmc, pot=sphere)
    theirs.integrate(times, milky_way + moving, method="dop853", progressbar=False)
    ours = Host(MILKY_WAY, {"lmc": body}).until(end).orbit(q, v, 0.0, end, NODE)
    at = times[400::400]
    wanted = np.array([theirs.x(at), theirs.y(at), theirs.z(at)])
    assert np.abs(ours.at(at).q - wanted).max() < 1e-6 * np.sqrt((wanted**2).sum(axis=0)).min()


def passing_clump():
    """A clump of 1e9 Msun that meets the progenitor of `inputs_of` within 1 kpc, 0.5 Gyr ago, in a held halo."""
    halo = {"halo": MILKY_WAY["halo"]}
    inputs = inputs_of({}, halo, lookback=1.0)
    track = progenitor_track(Host(halo), inputs)
    meets = track.at(np.array([-0.5 * sk.GYR]))
    back = build_field([halo["halo"]])
    there, motion = meets.q[:, 0] + np.array([0.3, 0.6, -0.2]), np.array([-150.0, 120.0, 60.0])
    today = back.orbit(there, motion, -0.5 * sk.GYR, 0.0, NODE)
    clump = Plummer(mass=1e9, radius=0.3)
    return halo, inputs, track, Body(clump, today.q[:, -1], today.v[:, -1], friction=False, reflex=False)


def test_steps_foresee_a_clump_that_passes_through_the_stream():
    """Particles around the progenitor when the clump comes: as DOP853 has them, though their orbits change."""
    halo, _, track, clump = passing_clump()
    field = Host(halo, {"clump": clump}).until(-sk.GYR)
    rng = np.random.default_rng(4)
    begin = track.at(np.array([-0.54 * sk.GYR]))
    q = begin.q + rng.normal(0, 1.0, (3, 60))
    v = begin.v + rng.normal(0, 10.0, (3, 60))
    ends = {}
    for name, integrator in {
        "ours": Adaptive(),
        "finer": Adaptive(eta=0.2, eta_progenitor=0.225),
        "dop": Reference(),
    }.items():
        ends[name] = q.copy(), v.copy()
        for edge in np.linspace(-0.54, -0.44, 6)[1:]:
            integrator.advance(field, *ends[name], np.full(60, (edge - 0.02) * sk.GYR), edge * sk.GYR)
    alone = q.copy(), v.copy()
    Reference().advance(Host(halo).alone, *alone, np.full(60, -0.54 * sk.GYR), -0.44 * sk.GYR)
    kicked = np.sqrt(((ends["dop"][1] - alone[1]) ** 2).sum(axis=0))
    errors = {name: np.sqrt(((ends[name][1] - ends["dop"][1]) ** 2).sum(axis=0)) for name in ("ours", "finer")}
    assert np.median(kicked) > 5.0
    assert np.median(errors["ours"]) < 0.05
    assert errors["ours"].max() < 0.5
    assert errors["finer"].max() < 0.1 * errors["ours"].max()


def test_the_tidal_radius_feels_the_bodies():
    """d2Phi/dr2 of an NFW halo and a Plummer sphere beside the line of sight, in closed form along the radius."""
    halo, sphere = NFW(mass=5.4e11, rs=15.62), Plummer(mass=5e10, radius=4.0)
    place = np.array([20.0, 6.0, 0.0])
    host = Host({"halo": halo}, {"sphere": Body(sphere, place, np.array([0.0, 100.0, 0.0]))})
    q, v = np.array([25.0, 0.0, 0.0]), np.array([0.0, 200.0, 0.0])
    orbit = host.until(-10 * NODE).orbit(q, v, 0.0, -10 * NODE, NODE)
    r, rs = 25.0, halo.rs
    inside = np.log(1 + r / rs) - r / (r + rs)
    of_halo = -sk.G * halo.mass * (2 * inside / r**3 - 1 / (r * (r + rs) ** 2))
    d2 = (r - place[0]) ** 2 + place[1] ** 2 + sphere.radius**2
    of_sphere = sk.G * sphere.mass * (1 / d2**1.5 - 3 * (r - place[0]) ** 2 / d2**2.5)
    assert host.tidal_bracket(orbit)[-1] == pytest.approx(8.0**2 - of_halo - of_sphere, rel=1e-6)


def test_energies_know_the_bodies():
    halo, lmc = Kepler(mass=1e12), Kepler(mass=1e11)
    host = Host({"halo": halo}, {"lmc": Body(lmc, np.array([0.0, 40.0, 0.0]), np.zeros(3))})
    q = np.array([[30.0], [0.0], [0.0]])
    assert host.potential(q)[0] == pytest.approx(-sk.G * (1e12 / 30 + 1e11 / 50), rel=1e-14)
    escape = np.sqrt(2 * sk.G * (1e12 / 30 + 1e11 / 50))
    for speed, out in ((0.99 * escape, False), (1.01 * escape, True)):
        assert host.unbinds(q[:, 0], np.array([speed, 0.0, 0.0])) is out
    assert host.mass_inside(np.array([100.0]))[0] == pytest.approx(1e12)


def test_several_bodies_and_what_lies_ahead():
    inputs = inputs_of({"lmc": cloud(1.38e11), "smc": Body(Hernquist(mass=5e9, a=3.0), Q + 12.0, V - 40.0)})
    stream = stream_of(inputs)
    assert len(stream.future.apocentres()) == 1
    assert np.isfinite(stream.q).all()
    losing = stream_of(replace(inputs, stripping=inputs.stripping.model_copy(update={"mass_loss": 0.5})))
    assert np.isfinite(losing.q).all()
    assert losing.orbit.mass_left[-1] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("q", "v", "potential", "reason"),
    [
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], Kepler(mass=1e9), "the orbit of the body clump is not finite"),
        ([20.0, 0.0, 0.0], [10.0, 1.0, 0.0], Plummer(mass=1e9, radius=1.0), "the body clump passes too near"),
    ],
)
def test_bodies_that_cannot_be_followed(q, v, potential, reason):
    body = Body(potential, np.array(q), np.array(v))
    with pytest.raises(sk.OutOfDomain, match=reason):
        stream_of(inputs_of({"clump": body}))
