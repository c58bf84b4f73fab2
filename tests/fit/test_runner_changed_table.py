"""A table that changes or goes while a fit runs: told, with what is kept; the run goes on with the table it had."""

from concurrent.futures import Executor, Future

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable
from commands import call, refused
from runfiles import FIT

import streamkit as sk

CURVE = {"R": [6.0, 10.0, 20.0], "v_c": [231.0, 228.0, 204.0], "error": [5.0, 5.0, 5.0]}
UNITS = {"R": u.kpc, "v_c": u.km / u.s, "error": u.km / u.s}


def written(folder, error=5.0):
    columns = CURVE | {"error": [error] * 3}
    QTable({name: np.array(column) * UNITS[name] for name, column in columns.items()}).write(
        folder / "curve.ecsv", overwrite=True
    )


@pytest.fixture
def run_file(tmp_path):
    """A small fit of a stream, and of a rotation curve in a table."""
    written(tmp_path)
    document = FIT | {"data": {"curve": {"kind": "rotation_curve", "table": "curve.ecsv"}}}
    path = tmp_path / "run.toml"
    path.write_text(sk.runfile.to_toml(document))
    return path


class Elsewhere(Executor):
    """Makes calls as another machine would, which reads the tables anew: by then there is another one."""

    def __init__(self, change):
        self.change = change

    def submit(self, fn, /, *args, **kwargs):
        self.change()
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except BaseException as error:
            future.set_exception(error)
        return future


def test_workers_elsewhere_that_find_another_table_end_the_run_with_what_it_has(run_file):
    folder = run_file.parent
    there = Elsewhere(lambda: written(folder, error=6.0))
    with pytest.raises(sk.SpecError, match=r"'curve.ecsv' has changed since") as caught:
        sk.run(run_file, folder / "out", workers=there, steps=3, progress=False, products=False)
    assert "The run stopped after no finished step. To begin again: " in str(caught.value)


@pytest.mark.slow
def test_a_run_goes_on_with_its_own_table_only_and_loses_nothing(run_file):
    folder, out = run_file.parent, run_file.parent / "out"
    sk.run(run_file, out, steps=3, progress=False, products=False)
    written(folder, error=6.0)
    before = sk.load_results(out).chain.copy()
    assert "the data file curve.ecsv" in refused("run", run_file, "-o", out, "--resume", "--steps", "4")
    (folder / "curve.ecsv").unlink()
    assert "data.curve.table: cannot read the file 'curve.ecsv'" in " ".join(
        refused("run", run_file, "-o", out, "--resume", "--steps", "4").split()
    )
    assert call("status", out).exit_code == 0
    np.testing.assert_array_equal(sk.load_results(out).chain, before)
    written(folder)
    sk.run(run_file, out, steps=4, resume=True, progress=False, products=False)
    assert len(sk.load_results(out).chain) == 4
