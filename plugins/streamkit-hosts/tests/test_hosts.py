"""Snapshots of bodies in closed form: their multipoles, forces in time, a stream, and what cannot be read."""

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from streamkit_hosts import expand
from streamkit_hosts.multipoles import names, of_particles
from streamkit_hosts.sections import section_lines

import streamkit as sk
from streamkit.cli.main import main

SCALE, SQUEEZE = 10.0, 0.8
UNITS = {"UnitLength_in_cm": 3.0856775814913673e21, "UnitMass_in_g": 1.98840987e33, "UnitVelocity_in_cm_per_s": 1e5}
REST = (
    '[progenitor]\nkind = "plummer"\nmass = 2e4\nradius = 0.01\nx = 12\ny = 0\nz = 5\nvx = 30\nvy = 180\nvz = 20\n'
    'lookback = 2\n[stripping]\nkind = "mlcs"\nparticles = 200\n'
)


def mass_at(t):
    """The mass in Msun at a time in Gyr."""
    return 1e12 * (1 + 0.05 * t)


def squeezed(n, seed):
    """(3, n) A Plummer sphere, squeezed along z."""
    rng = np.random.default_rng(seed)
    share = (np.arange(n) + 0.5) / n * 0.999
    r = SCALE / np.sqrt(share ** (-2 / 3) - 1)
    direction = rng.standard_normal((3, n))
    return direction / np.sqrt((direction**2).sum(axis=0)) * r * np.array([[1.0], [1.0], [SQUEEZE]])


def density(x, y, z, t):
    m2 = (x**2 + y**2 + (z / SQUEEZE) ** 2) / SCALE**2
    return 3 * mass_at(t) / (4 * np.pi * SCALE**3 * SQUEEZE) * (1 + m2) ** -2.5


def write(path, time, n=40_000, shift=0.0, units=UNITS, **header):
    """A snapshot at a time in Gyr, counted from the beginning of the simulation."""
    with h5py.File(path, "w") as file:
        file.create_group("Header").attrs.update(
            units | {"Time": (time + 8) * sk.GYR, "MassTable": [0.0, mass_at(time) / n, 0.0]} | header
        )
        file.create_dataset("PartType1/Coordinates", data=(squeezed(n, int(100 * abs(time))) + shift).T)
    return path


@pytest.fixture(scope="module")
def snapshots(tmp_path_factory):
    folder = tmp_path_factory.mktemp("snapshots")
    return [write(folder / f"snapshot_{k}.hdf5", t, shift=3.0) for k, t in enumerate((0.0, -4.0, -2.5, -1.0, -3.5))]


def sphere_of(made):
    time = made.table["t"] * sk.GYR if "t" in made.table.colnames else None
    return sk.Multipoles(made.table["l"], made.table["m"], made.table["r"], made.table["phi"], time=time)


@pytest.mark.parametrize("place", [(12.0, -7.0, 9.0), (-0.5, 0.8, -0.3)])
def test_one_particle_is_a_point_mass(place):
    """Its harmonics of all degrees, signs of m included, where the sum converges: far inside and far outside."""
    particle, radii, l_max = np.array(place)[:, None], np.geomspace(0.1, 200.0, 60), 11
    phi = of_particles(particle, np.array([1e10]), radii, l_max)
    n, m = np.array(names(l_max)).T
    sphere = sk.Multipoles(np.repeat(n, 60), np.repeat(m, 60), np.tile(radii, len(n)), phi.ravel())
    direction = np.random.default_rng(2).standard_normal((3, 50))
    r = np.sqrt((particle**2).sum())
    q = direction / np.sqrt((direction**2).sum(axis=0)) * np.where(np.arange(50) % 2, 0.1, 9.0) * r
    exact = -sk.G * 1e10 / np.sqrt(((q - particle) ** 2).sum(axis=0))
    np.testing.assert_allclose(sphere.potential(*q), exact, rtol=2e-5)


def test_a_series_has_the_force_of_its_body_at_all_times(snapshots):
    made = expand(snapshots, l_max=4)
    np.testing.assert_allclose(made.times, [-4, -3.5, -2.5, -1, 0], atol=1e-12)
    assert not made.warnings()
    sphere = sphere_of(made)
    direction = np.random.default_rng(3).standard_normal((3, 300))
    r = np.geomspace(3.0, 60.0, 300)
    q, inside = direction / np.sqrt((direction**2).sum(axis=0)) * r, 40_000 * (r**2 / (r**2 + SCALE**2)) ** 1.5
    for t in (-4.0, -1.8, 0.0):
        table = sk.multipole_table(density=lambda x, y, z, t=t: density(x, y, z, t), l_max=8, even=True)
        exact = sk.Multipoles(table["l"], table["m"], table["r"], table["phi"])
        ours, theirs = np.stack(sphere.acceleration(*q, t * sk.GYR)), np.stack(exact.acceleration(*q))
        error = np.sqrt(((ours - theirs) ** 2).sum(axis=0) / (theirs**2).sum(axis=0))
        assert np.median(error) < 0.015
        assert (error < 8 / np.sqrt(inside)).all()  # the noise of so many particles, and of their centre
    still = np.stack(sphere.acceleration(*q, 0.0))
    assert np.median(np.abs(np.stack(sphere.acceleration(*q, -4 * sk.GYR)) / still - 0.8)) < 0.02


@pytest.mark.slow  # five snapshots
def test_a_galaxy_that_falls_moves_along_its_path(tmp_path):
    """Its centre is on a parabola: from today's place and velocity it is ``g t^2 / 2``. Its run file has the path."""
    gravity, times = 8.0, np.array([-4.0, -3.0, -2.0, -1.0, 0.0])  # kpc/Gyr^2, Gyr
    files = [write(tmp_path / f"{k}.hdf5", t, shift=20 + 30 * t + 0.5 * gravity * t**2) for k, t in enumerate(times)]
    made = expand(files, l_max=2, radii=16)
    for name in "xyz":
        rest = made.path[name] - 0.5 * gravity * times**2  # a velocity, by the noise of the centres: it moves nothing
        np.testing.assert_allclose(rest, np.polyval(np.polyfit(times, rest, 1), times), atol=0.5)
    assert any("its path is a table of its own" in sentence for sentence in made.warnings())
    table = tmp_path / "halo.ecsv"
    words = ["expand", *map(str, files), "--l-max", "2", "--radii", "16", "-o", str(table)]
    shown = CliRunner().invoke(main, words)
    assert shown.exit_code == 0, shown.output
    (tmp_path / "run.toml").write_text(shown.output[shown.output.index("[potential]") :] + REST)
    spec = sk.load(tmp_path / "run.toml")
    inputs = spec.bind()
    assert inputs.q == pytest.approx([12, 0, 5], abs=1e-6)  # from its centre today, as in the run file
    assert inputs.v == pytest.approx([30, 180, 20], abs=1e-6)
    assert spec.sections.host_centre.farthest(2.0)[0] == pytest.approx(0.5 * gravity * 4 * np.sqrt(3), rel=0.2)
    again = CliRunner().invoke(main, words)
    assert again.exit_code != 0
    assert "exists" in again.output
    for name, said in (("halo.fits", "must be one of .ecsv"), ("none/halo.ecsv", "does not exist")):
        refused = CliRunner().invoke(main, [*words[:-1], str(tmp_path / name)])
        assert refused.exit_code != 0
        assert said in refused.output


@pytest.mark.parametrize("first", [-3.00184, -1.95558, -3.0, -0.99996])
def test_the_look_back_time_that_is_told_is_known(first):
    line = section_lines("potential", "multipole", None, np.array([first, 0.0]), tolerance="1")[-1]
    told = float(line.split()[-1])
    assert -first * 0.999 < told <= -first


@pytest.mark.slow  # the orders of its expansion are compiled
def test_a_stream_is_made_in_it(snapshots, tmp_path):
    table = tmp_path / "halo.ecsv"
    shown = CliRunner().invoke(
        main, ["expand", *map(str, snapshots), "--l-max", "2", "--radii", "16", "-o", str(table)]
    )
    assert shown.exit_code == 0, shown.output
    section = shown.output[shown.output.index("[potential]") :]
    path = tmp_path / "run.toml"
    path.write_text(section + REST)
    stream = sk.Model(sk.load(path)).stream()
    assert np.isfinite(stream.q).all()
    path.write_text((section + REST).replace("lookback = 2", "lookback = 5"))
    with pytest.raises(sk.SpecError, match="is known from -4 to 0 Gyr"):
        sk.load(path)


def test_a_single_snapshot_is_a_host_at_rest(snapshots):
    made = expand(snapshots[:1], l_max=2)
    assert made.table.colnames == ["l", "m", "r", "phi"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        pytest.param({"HubbleParam": 0.7}, r"HubbleParam is 0\.7; expected lengths and masses without 1/h", id="h"),
        pytest.param({"ComovingIntegrationOn": 1}, "expected physical coordinates", id="comoving"),
        pytest.param({"MassTable": [0.0, 0.0]}, "has no Masses, and MassTable has none", id="no masses"),
        pytest.param({"Time": np.nan}, "Time: expected a number", id="time"),
        pytest.param({"units": {}}, "has no attribute UnitLength_in_cm", id="units"),
        pytest.param({"n": 500}, "has 500 particles; expected 10000 or more", id="few"),
        pytest.param({"shift": np.nan}, "10000 of 10000 particles have a place that is not finite", id="NaN"),
    ],
)
def test_what_cannot_be_used_is_told(tmp_path, change, said):
    path = write(tmp_path / "one.hdf5", 0.0, **({"n": 10_000} | change))
    with pytest.raises(sk.StreamkitError, match=said):
        expand([path])


def test_damaged_and_missing_files_and_equal_times_are_told(snapshots, tmp_path):
    broken = tmp_path / "broken.hdf5"
    broken.write_bytes(snapshots[0].read_bytes()[:5000])
    with pytest.raises(sk.StreamkitError, match=r"broken\.hdf5: cannot be read as HDF5"):
        expand([broken])
    with pytest.raises(sk.StreamkitError, match="there is no such file"):
        expand([tmp_path / "none.hdf5"])
    with h5py.File(write(tmp_path / "linked.hdf5", 0.0), "r+") as file:
        del file["PartType1"]
        file["PartType1"] = h5py.ExternalLink(str(snapshots[0]), "/PartType1")
    with pytest.raises(sk.StreamkitError, match=r"linked\.hdf5: PartType1: expected a group of this file"):
        expand([tmp_path / "linked.hdf5"])
    with pytest.raises(sk.StreamkitError, match="have the same time"):
        expand([snapshots[0], snapshots[0]], l_max=0)
    with pytest.raises(sk.StreamkitError, match="no particles of type 4; it has 1"):
        expand(snapshots[:1], types=[4])
    with pytest.raises(sk.StreamkitError, match="the table would have 3211000 rows"):
        expand(snapshots[:1] * 38, l_max=12, radii=500)


def test_too_low_a_degree_and_too_few_particles_are_told(tmp_path):
    path = write(tmp_path / "one.hdf5", 0.0, n=10_000)
    made = expand([path], l_max=2)
    assert any("does not converge" in sentence for sentence in made.warnings())
    noisy = expand([path], l_max=10, radii=150)
    assert any("too few particles" in sentence for sentence in noisy.warnings())
