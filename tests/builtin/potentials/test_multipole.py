"""The host of multipoles: against the potential that its table was made of, through its expansion too."""

import numpy as np
import pytest
from commands import call, refused
from runfiles import RUN

import streamkit as sk
from streamkit.builtin.potentials.halos import NFWTriaxial
from streamkit.builtin.potentials.multipole import Multipole
from streamkit.engine import build_field

HALO = NFWTriaxial(mass=3.6e11, rs=16.0, p=0.9, q=0.85)


def table(**options):
    values = HALO.in_engine_units()
    made = sk.multipole_table(potential=lambda x, y, z: NFWTriaxial.potential(x, y, z, 0.0, *values), **options)
    made["m"] = made["m"].astype(int)
    return made


def columns(made):
    return {name: np.asarray(made[name], dtype=float).tolist() for name in made.colnames}


def positions(n=200):
    rng = np.random.default_rng(3)
    direction = rng.standard_normal((3, n))
    return direction / np.sqrt((direction**2).sum(axis=0)) * np.exp(rng.uniform(np.log(0.5), np.log(200.0), n))


def turned_and_heavier():
    """Return a table's host with a factor and an angle, and the halo that it is."""
    host = Multipole(table=columns(table(l_max=8, even=True)), factor=1.5, angle=30.0)
    return host, NFWTriaxial(mass=1.5 * 3.6e11, rs=16.0, p=0.9, q=0.85, phi=30.0)


def test_its_potential_is_that_of_the_halo_turned_and_heavier():
    host, turned = turned_and_heavier()
    q = positions()
    difference = Multipole.potential(*q, 0.0, *host.in_engine_units()) - NFWTriaxial.potential(
        *q, 0.0, *turned.in_engine_units()
    )
    assert np.ptp(difference) < 1e-4 * 220.0**2


@pytest.mark.slow  # the orders of its expansion are compiled; tests/expansion has a small one
def test_through_its_expansion_it_is_the_halo_turned_and_heavier():
    host, turned = turned_and_heavier()
    q = positions()
    ours, exact = (build_field([p]).acceleration(0.0, q) for p in (host, turned))
    assert host.expanded().grid.form == "general"
    assert np.sqrt(((ours - exact) ** 2).sum(axis=0) / (exact**2).sum(axis=0)).max() < 3e-4


@pytest.mark.slow
def test_from_a_file_in_a_run(tmp_path):
    table(l_max=4, even=True).write(tmp_path / "halo.ecsv")
    host = '[potential]\nkind = "multipole"\ntable = "halo.ecsv"\nfactor = { uniform = [0.9, 1.1] }\n'
    path = tmp_path / "run.toml"
    path.write_text(host + RUN[RUN.index("[progenitor]") :])
    shown = call("stream", path)
    assert shown.exit_code == 0, shown.output
    assert "general expansion" in shown.stdout


def test_a_file_without_a_pair_is_refused(tmp_path):
    host = '[potential]\nkind = "multipole"\ntable = "halo.ecsv"\nfactor = { uniform = [0.9, 1.1] }\n'
    path = tmp_path / "run.toml"
    path.write_text(host + RUN[RUN.index("[progenitor]") :])
    wrong = table(l_max=4, even=True)[:-1]
    wrong.write(tmp_path / "halo.ecsv", overwrite=True)
    assert "potential.table: found 599 rows; expected each of the 6 pairs of l and m once" in refused("check", path)


@pytest.mark.parametrize("name", ["l", "phi"])
def test_a_column_that_is_missing_is_told(name):
    made = columns(table(l_max=2, even=True))
    del made[name]
    with pytest.raises(ValueError, match=f"the column '{name}' is missing"):
        Multipole(table=made)
