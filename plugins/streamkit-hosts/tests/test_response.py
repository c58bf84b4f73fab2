"""The host `response`: closed forms of a displaced sphere, a mean that is refused, and the command that makes it."""

import h5py
import numpy as np
import pytest
from astropy.table import Table
from click.testing import CliRunner
from streamkit_hosts import expand
from streamkit_hosts.response import Response

import streamkit as sk
from streamkit.cli.main import main

MASS, SCALE, SHIFT = 1e12, 20.0, 0.4  # Msun, kpc; the shift along x is small beside the scale
UNITS = {"UnitLength_in_cm": 3.0856775814913673e21, "UnitMass_in_g": 1.98840987e33, "UnitVelocity_in_cm_per_s": 1e5}
RADII = np.geomspace(0.05, 400.0, 80)
REST = """
[progenitor]
kind = "plummer"
mass = 2e4
radius = 0.01
x = 12
y = 0
z = 5
vx = 30
vy = 180
vz = 20
lookback = 1
[stripping]
kind = "mlcs"
particles = 200
"""


def pull(q):
    """(3, n) The force of a Plummer sphere."""
    return -sk.G * MASS * q / ((q**2).sum(axis=0) + SCALE**2) ** 1.5


def dipole(times=(0.0,), size=lambda t: 1.0):
    """Return the first-order dipole of the sphere displaced along x: -shift dPhi/dx; Y_11 is sqrt 3 x/r."""
    slope = sk.G * MASS * RADII / (RADII**2 + SCALE**2) ** 1.5
    phi = [size(t) * -SHIFT * slope / np.sqrt(3) for t in times]
    table = {"l": np.ones(len(RADII) * len(times)), "m": np.ones(len(RADII) * len(times)),
             "r": np.tile(RADII, len(times)), "phi": np.concatenate(phi)}  # fmt: skip
    return table | ({"t": np.repeat(times, len(RADII))} if len(times) > 1 else {})


def places(n=200):
    rng = np.random.default_rng(1)
    direction = rng.standard_normal((3, n))
    return direction / np.sqrt((direction**2).sum(axis=0)) * np.geomspace(2, 100, n)


def host(amplitude, table=None):
    document = {"potential": {
        "sphere": {"kind": "plummer", "mass": MASS, "radius": SCALE},
        "response": {"kind": "response", "table": dipole() if table is None else table, "amplitude": amplitude,
                     "tolerance": 1e-3},
    }}  # fmt: skip
    rest = {"kind": "plummer", "mass": 2e4, "radius": 0.01, "x": 12, "y": 0, "z": 5, "vx": 30, "vy": 180, "vz": 20}
    stripping = {"kind": "mlcs", "particles": 50}
    return sk.load(document | {"progenitor": rest | {"lookback": 1.0}, "stripping": stripping})


@pytest.mark.parametrize("amplitude", [1.0, -1.0, 0.0])
def test_the_dipole_of_a_displaced_sphere_is_its_displacement(amplitude):
    """To first order; what is left falls as the square of the shift over the radius."""
    q, shift = places(), np.array([[amplitude * SHIFT], [0.0], [0.0]])
    force = sk.Host.at(host(amplitude)).acceleration(q)
    left = np.sqrt(((force - pull(q - shift)) ** 2).sum(axis=0) / (pull(q) ** 2).sum(axis=0))
    moved = np.sqrt(((pull(q) - pull(q - shift)) ** 2).sum(axis=0) / (pull(q) ** 2).sum(axis=0))
    far = np.sqrt((q**2).sum(axis=0)) > 8
    assert left[far].max() < 4e-3
    assert np.median(left[far]) < 0.05 * np.median(moved[far]) or amplitude == 0
    assert left.max() < 2e-5 or amplitude != 0


def test_it_has_no_mass():
    rigid, deformed = (sk.Host.at(host(amplitude)) for amplitude in (0.0, 1.0))
    at = np.array([5.0, 20.0, 80.0])
    assert deformed.mass_inside(at) == pytest.approx(rigid.mass_inside(at), rel=1e-9)
    assert rigid.mass_inside(at) == pytest.approx(MASS * at**3 / (at**2 + SCALE**2) ** 1.5)


def test_without_amplitude_a_stream_is_that_of_the_rigid_host():
    document = dict(host(0.0).document)
    alone = {**document, "potential": {"sphere": document["potential"]["sphere"]}}
    streams = [sk.Model(one).stream().q for one in (document, alone)]
    np.testing.assert_array_equal(*streams)
    assert np.abs(sk.Model(host(1.0)).stream().q - streams[0]).max() > 0.05


def test_it_changes_in_time():
    """A deformation that grows with the cube of time is followed by splines in time without error."""
    times = (-4.0, -3.0, -2.0, -1.0, 0.0)
    one = Response(table=dipole(times, lambda t: (1 + t / 4) ** 3), amplitude=2.0)
    splines = Response.prepare(one.table)
    q = places()
    today = np.array(Response.acceleration(*q, 0.0, **splines, amplitude=2.0))
    for t in (-3.4, -0.7):
        then = np.array(Response.acceleration(*q, t * sk.GYR, **splines, amplitude=2.0))
        np.testing.assert_allclose(then, (1 + t / 4) ** 3 * today, rtol=1e-9, atol=1e-9)
    assert one.known_times() == pytest.approx(times)


def test_a_mean_is_refused():
    table = dipole()
    table["l"] = table["m"] = np.zeros(len(RADII))
    with pytest.raises(sk.SpecError, match=r"potential\.response\.table: .*found rows with l = 0.*expected l > 0"):
        host(1.0, table)


def write(path, shift, n=60_000):
    """A snapshot of the sphere, whose outer part lies beside the inner one by a shift along x."""
    rng = np.random.default_rng(3)
    share = (np.arange(n) + 0.5) / n * 0.99
    r = SCALE / np.sqrt(share ** (-2 / 3) - 1)
    direction = rng.standard_normal((3, n))
    q = direction / np.sqrt((direction**2).sum(axis=0)) * r
    q[0] += shift * (r > SCALE) + 7.0  # the galaxy is elsewhere
    with h5py.File(path, "w") as file:
        file.create_group("Header").attrs.update(UNITS | {"Time": 0.0, "MassTable": [0.0, MASS / n]})
        file.create_dataset("PartType1/Coordinates", data=q.T)
    return path


def test_the_command_leaves_out_the_mean_and_the_path(tmp_path):
    """The same rows as the whole table has, beside which a rigid halo and a response have its force."""
    snapshot = write(tmp_path / "snapshot.hdf5", 3.0)
    out = tmp_path / "response.ecsv"
    done = CliRunner().invoke(main, ["expand", str(snapshot), "--response", "--l-max", "2", "-o", str(out)])
    assert done.exit_code == 0, done.output
    assert "the centre moves" not in done.output
    whole, made = expand([snapshot], l_max=2).table, Table.read(out)
    assert set(made["l"]) == {1, 2}
    np.testing.assert_allclose(made["phi"], whole["phi"][whole["l"] > 0])
    assert 'kind = "response"' in done.output
    run = tmp_path / "run.toml"
    section = done.output[done.output.index("[potential.response]") :].replace(str(tmp_path) + "/", "")
    run.write_text(f'[potential.sphere]\nkind = "plummer"\nmass = {MASS}\nradius = {SCALE}\n{section}{REST}')
    spec = sk.load(run)
    assert spec.names == ("potential.response.amplitude",)
    force = [sk.Host.at(spec, {spec.names[0]: a}).acceleration(places()) for a in (0.0, 1.0, 2.0)]
    np.testing.assert_allclose(force[2] - force[1], force[1] - force[0], rtol=1e-6, atol=1e-6)
    assert np.abs(force[1] - force[0]).max() > 1.0


def test_noise_is_told_in_units_of_the_response(tmp_path):
    still, pulled = (expand([write(tmp_path / f"{shift}.hdf5", shift)], l_max=2, response=True) for shift in (0.0, 9.0))
    assert pulled.noise < 0.2 * still.noise
    assert any("of the response" in sentence for sentence in still.warnings())
    assert not pulled.warnings()
