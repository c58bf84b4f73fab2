"""The host of multipoles: against the potential that its table was made of, through its expansion too."""

import numpy as np
import pytest
from commands import call, refused
from runfiles import RUN

import streamkit as sk
from streamkit.builtin.potentials.halos import NFWTriaxial
from streamkit.builtin.potentials.multipole import Multipole

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


def test_its_potential_is_that_of_the_halo_turned_and_heavier():
    host = Multipole(table=columns(table(l_max=8, even=True)), factor=1.5, angle=30.0)
    turned = NFWTriaxial(mass=1.5 * 3.6e11, rs=16.0, p=0.9, q=0.85, phi=30.0)
    q = positions()
    difference = Multipole.potential(*q, 0.0, *host.in_engine_units()) - NFWTriaxial.potential(
        *q, 0.0, *turned.in_engine_units()
    )
    assert np.ptp(difference) < 1e-4 * 220.0**2


@pytest.fixture
def run_file(tmp_path):
    """A run file whose host is a table beside it."""
    host = '[potential]\nkind = "multipole"\ntable = "halo.ecsv"\nfactor = { uniform = [0.9, 1.1] }\n'
    path = tmp_path / "run.toml"
    path.write_text(host + RUN[RUN.index("[progenitor]") :])
    return path


@pytest.mark.slow
def test_from_a_file_in_a_run(run_file):
    table(l_max=4, even=True).write(run_file.with_name("halo.ecsv"))
    shown = call("stream", run_file)
    assert shown.exit_code == 0, shown.output
    assert "general expansion" in shown.stdout


def test_a_file_without_a_pair_is_refused(run_file):
    table(l_max=4, even=True)[:-1].write(run_file.with_name("halo.ecsv"))
    said = "potential.table: found 599 rows; expected each of the 6 pairs of l and m once"
    assert said in refused("check", run_file)


@pytest.mark.parametrize("name", ["l", "phi"])
def test_a_column_that_is_missing_is_told(name):
    made = columns(table(l_max=2, even=True))
    del made[name]
    with pytest.raises(ValueError, match=f"the column '{name}' is missing"):
        Multipole(table=made)
