"""Hosts of AGAMA: its own forces, sections for a run file, and what cannot be used."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from streamkit_hosts import agama
from streamkit_hosts.sections import UNITS as TABLE_UNITS
from streamkit_hosts.sections import written

import streamkit as sk
from streamkit import engine
from streamkit.cli.main import main
from streamkit.components import along_axes

FILES = Path(__file__).parent / "agama"
UNITS = agama.Units.of(None, None, None)
ALL = np.genfromtxt(FILES / "forces.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
REST = (
    '\n[progenitor]\nkind = "plummer"\nmass = 2e4\nradius = 0.01\nx = 12\ny = 0\nz = 5\nvx = 30\nvy = 180\nvz = 20\n'
    'lookback = 1\n[stripping]\nkind = "mlcs"\nparticles = 100\n'
)


def theirs(name, t=0):
    """Places (3, n), and AGAMA's potential (n,) and forces (3, n)."""
    rows = ALL[(ALL["name"] == name) & (ALL["t"] == t)]
    return tuple(np.array([rows[k] for k in names]) for names in (("x", "y", "z"), ("phi",), ("ax", "ay", "az")))


def sections(folder, name, *words):
    """The run file that the command prints."""
    words = [str(FILES / name), "-o", str(folder / "host.ecsv"), *words]
    shown = CliRunner().invoke(main, ["import-host", *words])
    assert shown.exit_code == 0, shown.output
    lines = [line for line in shown.output.splitlines() if line.startswith("[") or " = " in line]
    return "\n".join(line for line in lines if not line.startswith("#")) + REST


def error_of(ours, exact):
    return np.sqrt(((ours - exact) ** 2).sum(axis=0) / (exact**2).sum(axis=0))


@pytest.mark.parametrize("name", ["halo0.ini", "disc.ini", "bar.ini"])
def test_forces_are_those_of_agama(tmp_path, name):
    """To 1.2e-4, from 2 to 35 kpc: a triaxial halo that is turned, a disc of 300 pc, a bar off the centre."""
    (tmp_path / "run.toml").write_text(sections(tmp_path, name))
    (part,) = sk.load(tmp_path / "run.toml").bind().potentials.values()
    q, phi, exact = theirs(name)
    force = engine.build_field([part], exact=True).acceleration(np.zeros(q.shape[1]), q)
    assert error_of(force, exact).max() < 1.2e-4
    values = type(part).potential(*q, 0.0, *part.in_engine_units())
    np.testing.assert_allclose(values, phi[0], rtol=1e-4)


def test_a_galaxy_that_changes_is_that_of_agama_at_its_times(tmp_path):
    """A halo in time, a tilted disc, and a bar that is turned, in four sections."""
    text = sections(tmp_path, "galaxy.ini")
    assert [line for line in text.splitlines() if line.startswith("[pot")] == [
        "[potential.halo]", "[potential.disc]", "[potential.disc2]",
    ]  # fmt: skip
    (tmp_path / "run.toml").write_text(text)
    potentials = sk.load(tmp_path / "run.toml").bind().potentials
    np.testing.assert_allclose(potentials["halo"].known_times(), np.array([-2, -1, 0]) / sk.GYR, rtol=1e-9)
    for t in (-2, -1, 0):
        q, _, exact = theirs("galaxy.ini", t)
        times = np.full(q.shape[1], float(t))
        force = sum(along_axes("acceleration", part, q, times) for part in potentials.values())
        assert error_of(force, exact).max() < 1e-4
    (tmp_path / "run.toml").write_text(text.replace("lookback = 1", "lookback = 3"))
    with pytest.raises(sk.SpecError, match=r"is known from -1\.95"):
        sk.load(tmp_path / "run.toml")


def test_a_galaxy_that_moves_is_that_of_agama(tmp_path):
    """A halo in time on a path with velocities, that turns and is tilted; a bar that turns; what accelerates all."""
    text = sections(tmp_path, "moving.ini")
    (tmp_path / "run.toml").write_text(text)
    spec = sk.load(tmp_path / "run.toml")
    potentials, path = spec.bind().potentials, engine.Motion(centre=spec.sections.host_centre.path)
    assert [*potentials] == ["halo", "disc", "acceleration", "moving_frame"]  # the force of the frame is not AGAMA's
    assert len(path.centre) > 1
    for t in (-2, -1, 0):  # between two rows of its path; the halo itself is known then
        q, _, exact = theirs("moving.ini", t)
        q, times = q - path.state_at(float(t))[0][:, None], np.full(q.shape[1], float(t))
        force = engine.build_field([potentials["acceleration"]]).acceleration(times, q)
        force = force + sum(along_axes("acceleration", potentials[name], q, times) for name in ("halo", "disc"))
        assert error_of(force, exact).max() < 2e-4
    (tmp_path / "run.toml").write_text(text.replace("lookback = 1", "lookback = 2.2"))
    with pytest.raises(sk.SpecError) as raised:
        sk.load(tmp_path / "run.toml")
    assert "potential.halo: the multipole is known from -1.95" in str(raised.value)
    assert "potential.disc.centre: it is known from -2.15" in str(raised.value)


def test_a_place_and_an_angle_at_rest_need_no_file(tmp_path):
    given = (FILES / "bar.ini").read_text().replace("type=CylSpline", "type=CylSpline\ncenter=1, -2, 3\nrotation=0.5")
    (tmp_path / "bar.ini").write_text(given)
    (part,) = agama.read(tmp_path / "bar.ini", agama.Units.of(2.0, None, None))
    assert part.centre == {"t": [0.0], "x": [2.0], "y": [-4.0], "z": [6.0]}
    assert part.fields == {"angle": pytest.approx(np.degrees(0.5))}


def test_units_of_the_files(tmp_path):
    """G = 1 with 2 kpc and 1e11 Msun: a velocity of 464 km/s, as is written in AGAMA's reference."""
    units = agama.Units.of(2.0, 1e11, None)
    assert units.velocity == pytest.approx(np.sqrt(sk.G * 1e11 / 2))
    assert units.time == pytest.approx(2 / units.velocity / sk.GYR)
    (one,), (other,) = (agama.read(FILES / "bar.ini", each) for each in (UNITS, units))
    np.testing.assert_allclose(other.columns["R"], 2 * one.columns["R"])
    np.testing.assert_allclose(other.columns["dphi_dz"], one.columns["dphi_dz"] * units.velocity**2 / 2)
    assert not written([one], (5.0, 60.0), tmp_path / "bar.ecsv", force=False)[0].warnings


@pytest.mark.slow  # its expansion is compiled
def test_a_stream_is_made_in_a_disc_in_time(tmp_path):
    """The same grid at two times, with half the mass at the first."""
    from astropy.table import Table, vstack

    table = agama.read(FILES / "disc.ini", UNITS)[0].columns
    parts = []
    for t, factor in ((-1.5, 0.5), (-0.75, 0.75), (0.0, 1.0)):
        rows = {"t": np.full(len(table["R"]), t), **table}
        rows |= {name: factor * table[name] for name in ("phi", "dphi_dR", "dphi_dz")}
        parts.append(Table(rows, units=TABLE_UNITS))
    vstack(parts).write(tmp_path / "disc.ecsv")
    disc = f'[potential.disc]\nkind = "cylspline"\ntable = "{tmp_path / "disc.ecsv"}"\ntolerance = 1e-2\n'
    halo = '[potential.halo]\nkind = "logarithmic"\nv_h = 150\nr_h = 5\n'
    (tmp_path / "run.toml").write_text(disc + halo + REST)
    model = sk.Model(sk.load(tmp_path / "run.toml"))
    assert np.isfinite(model.stream().q).all()
    part = sk.load(tmp_path / "run.toml").bind().potentials["disc"]
    q, _, exact = theirs("disc.ini")
    half = engine.build_field([part]).acceleration(np.full(q.shape[1], -0.75 * sk.GYR), q)
    assert error_of(half, 0.75 * exact).max() < 1e-2


GOOD = (FILES / "halo0.ini").read_text()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"has no section \[Potential\]"),
        ("[Potential]\ntype=Plummer\nmass=1\n", "has the type Plummer, which is no table"),
        ("[Potential]\nmass=1\n", "has neither a type nor a file"),
        ("[Potential]\nfile=none.ini\n", "there is no such file"),
        ("[Potential]\nfile=host.ini\n", "name files that name files"),
        ("[Potential]\ntype=Multipole\nnonsense\n", "found 'nonsense', expected name = value"),
        ("[Potential]\ntype=Multipole\nCoefficients\n#Phi\n", "below #Phi expected a line that begins with #radius"),
        ("[Potential]\ntype=Multipole\n", "has no #Phi after Coefficients"),
        (GOOD[: GOOD.index("#dPhi")], "has no #dPhi/dr after Coefficients"),
        (GOOD[:-40], "finite numbers in its table"),
        (GOOD.replace("type=Multipole", "type=Multipole\nrotation=[[0,0],[1]]"), r"rotation is .*expected 1 number"),
        (GOOD.replace("type=Multipole", "type=Multipole\nrotation=[[1,0],[0,2]]"), "at times that increase"),
        (GOOD.replace("type=Multipole", "type=Multipole\ncenter=1,0"), r"center is '1,0'; expected 3 number"),
        (GOOD.replace("type=Multipole", "type=Multipole\ncenter=none.txt"), r"center is 'none.txt'; expected 3 number"),
        (GOOD.replace("type=Multipole", "type=Multipole\norientation=[[0,1,2,3],[1,1,2,3]]"), "orientation changes"),
        ("[Potential]\ntype=UniformAcceleration\n", "has no file; expected one with rows"),
        ("[Potential]\ntype=UniformAcceleration\nfile=1,2,3\ncenter=1,0,0", "is turned or moved"),
        (GOOD.replace("type=Multipole", "type=Multipole\nscale=2,1"), "has scale"),
        ("[Potential]\ntype=Evolving\nTimestamps\n0 a.ini\n", "expected two times or more"),
        ("[Potential]\ntype=Evolving\nTimestamps\n0 a.ini\n1e 2.ini\n", "found '1e 2.ini'; expected a time and a file"),
    ],
)
def test_what_cannot_be_used_is_told(tmp_path, text, said):
    (tmp_path / "host.ini").write_text(text)
    with pytest.raises(sk.StreamkitError, match=said):
        agama.read(tmp_path / "host.ini", UNITS)


def test_a_today_outside_the_times_is_told():
    with pytest.raises(sk.StreamkitError, match="its times are -2 to 0, and today is 1: give --today"):
        agama.read(FILES / "galaxy.ini", UNITS, today=1.0)


def test_a_table_that_is_no_grid_is_told():
    columns = agama.read(FILES / "disc.ini", UNITS)[0].columns
    from streamkit_hosts.cylspline import CylSpline

    for change, said in (
        (lambda rows: {k: v[:-1] for k, v in rows.items()}, "all t, m, R and z once"),
        (lambda rows: rows | {"R": rows["R"] + 1}, "expected six, R from 0 on"),
        (lambda rows: rows | {"z": rows["z"] + 1}, "expected 0 in them"),
        (lambda rows: rows | {"m": rows["m"] + 0.5}, "expected whole numbers"),
    ):
        with pytest.raises(ValueError, match=said):
            CylSpline(table=change(columns))
