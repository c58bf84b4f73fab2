"""Tables of a stream on the sky that are not as they should be: one sentence each, at the command line."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable, Table
from commands import call, refused
from documents import ROOT

from streamkit.builtin.observables.track.remarks import in_radians

EXAMPLES = ROOT / "examples"
FEW = ("--set", "stripping.particles=200", "--draws", "0")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Copies of the examples, side by side."""
    for name in ("gd1", "pal5", "rotation_curve", "sagittarius_track", "orphan_lmc"):
        shutil.copytree(EXAMPLES / name, tmp_path / name, ignore=shutil.ignore_patterns("*.png"))
    return tmp_path


def write(path: Path, **columns: Any) -> None:
    QTable({name: column for name, column in columns.items() if column is not None}).write(path, overwrite=True)


def changed(path: Path, column: str, row: int, value: float) -> None:
    """Write another number into a table."""
    table = Table.read(path)
    numbers = np.array(table[column], dtype=float)
    numbers[row] = value
    write(path, **{name: table[name] for name in table.colnames} | {column: numbers * table[column].unit})


@pytest.mark.parametrize(
    ("table", "column", "value", "said"),
    [
        ("gd1/phi2", "error", 0.0, "observable.phi2: column 'error' of 'phi2.ecsv': row 3 is 0 deg, expected positive"),
        ("gd1/phi2", "error", -1.0, "row 3 is -1 deg, expected positive"),
        ("gd1/phi2", "error", np.nan, "row 3 is nan deg, expected a finite number"),
        ("gd1/phi2", "error", np.inf, "row 3 is inf deg, expected a finite number"),
        ("gd1/phi2", "error", 1e-300, "expected positive"),
        ("gd1/phi2", "phi2", 1e300, "expected a number below 1e+60"),
        ("gd1/phi2", "phi2", -999.0, "row 3 is -999 deg, expected -90 to 90"),
        ("gd1/phi2", "phi1", np.nan, "column 'phi1' of 'phi2.ecsv': row 3 is nan deg"),
        ("gd1/distance", "distance", -999.0, "row 3 is -999 kpc, expected positive"),
        ("rotation_curve/eilers2019", "R", 0.0, "data.rotation_curve.table: column 'R' of "
         "'../rotation_curve/eilers2019.ecsv': row 3 is 0 kpc, expected positive"),
        ("rotation_curve/eilers2019", "R", -5.0, "row 3 is -5 kpc, expected positive"),
        ("rotation_curve/eilers2019", "v_c", -200.0, "row 3 is -200 km/s, expected positive"),
        ("rotation_curve/eilers2019", "error", 0.0, "row 3 is 0 km/s, expected positive"),
        ("sagittarius_track/ramos2020", "depth_error", 0.0, "column 'depth_error' of 'ramos2020.ecsv': row 3 is 0 kpc"),
    ],
)  # fmt: skip
def test_a_number_that_cannot_be(folder: Path, table: str, column: str, value: float, said: str) -> None:
    changed(folder / f"{table}.ecsv", column, 2, value)
    example = table.partition("/")[0].replace("rotation_curve", "pal5")
    assert said in plain(refused("check", folder / example / f"{example}.toml"))


def plain(text: str) -> str:
    return " ".join(text.split())


def emptied(path: Path) -> None:
    path.write_text("")


def without_rows(path: Path) -> None:
    table = Table.read(path)[:0]
    write(path, **{name: table[name] for name in table.colnames})


def without_units(path: Path) -> None:
    write(path, phi1=[-60.0, -50.0], phi2=[0.0, 1.0], error=[0.2, 0.2])


def of_text(path: Path) -> None:
    write(path, phi1=[-60.0] * u.deg, phi2=["-0.64?"], error=[0.2] * u.deg)


def columns_of(path: Path, *names: str) -> None:
    write(path, phi1=[0.0] * u.deg, **{name: [1.0] * u.deg for name in names})


def with_a_hole(path: Path) -> None:
    path.write_text(path.read_text().replace("-0.64", '""'))


def a_directory(path: Path) -> None:
    path.unlink()
    path.mkdir()


def a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def in_wrong_radians(path: Path) -> None:
    write(path, phi1=[-60.0, -2.0] * u.rad, phi2=[-0.6, 0.0] * u.deg, error=[0.2, 0.2] * u.deg)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (in_wrong_radians, 'phi1 runs over 3323.16 deg, more than a turn; expected the unit "deg" for phi1, as '
         "numbers in degrees?"),
        (Path.unlink, "observable.phi2: cannot read the file 'phi2.ecsv' (No such file or directory) in"),
        (a_directory, "observable.phi2: cannot read the file 'phi2.ecsv' (it is a directory) in"),
        (a_pipe, "it is a device or pipe"),
        (emptied, "'phi2.ecsv' is empty; expected a table in the format ECSV"),
        (without_rows, "column 'phi1' of 'phi2.ecsv': found 0 number(s), expected at least 1"),
        (without_units, "column 'phi1' of 'phi2.ecsv': the file gives no unit, expected one like deg. Write it into "
         'the file, or beside it in the run file: units = { phi1 = "deg" }'),
        (of_text, "column 'phi2' of 'phi2.ecsv': found '-0.64?', expected numbers"),
        (with_a_hole, "column 'phi2' of 'phi2.ecsv': the value of row 1 is missing"),
        (lambda path: path.write_bytes(b"\xcc" * 1000), "'phi2.ecsv' is no text in UTF-8: invalid continuation byte"),
        (lambda path: path.write_text("no table at all"), "'phi2.ecsv' is no table in the format ECSV"),
        (lambda path: columns_of(path, "ph2", "error"), "no column 'phi2'. Did you mean 'ph2'?"),
        (lambda path: columns_of(path, "phi2"), "no column 'error'. It has: phi1, phi2"),
    ],
)  # fmt: skip
def test_a_table_that_is_none(folder: Path, change: Callable[[Path], Any], said: str) -> None:
    change(folder / "gd1" / "phi2.ecsv")
    assert said in plain(refused("check", folder / "gd1" / "gd1.toml"))


CSV = '{ file = "phi2.csv", units = { phi1 = "deg", phi2 = "deg", error = "deg" } }'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("phi1,phi2,phi2,error\n-60,0,1,0.2\n", "'phi2.csv' has two columns 'phi2'"),
        ("phi1,phi2,error\n-60,0,0.2\n-50,0\n", "column 'error' of 'phi2.csv': the value of row 2 is missing"),
        ("-60,0,0.2\n-50,0,0.2\n", "'phi2.csv' has no column 'phi1'. It has: -60, 0, 0.2."),
        ("phi1,phi2,error", "found 0 number(s)"),
    ],
)
def test_a_csv_table_that_is_none(folder: Path, text: str, said: str) -> None:
    (folder / "gd1" / "phi2.csv").write_text(text)
    path = rewritten(folder / "gd1" / "gd1.toml", 'phi2 = "phi2.ecsv"', f"phi2 = {CSV}")
    assert said in plain(refused("check", path))


def test_two_columns_of_one_name_in_ecsv(folder: Path) -> None:
    path = folder / "gd1" / "phi2.ecsv"
    write(path, phi1=[0.0], phi2=[0.0], phi3=[0.0], error=[1.0])
    path.write_text(path.read_text().replace("phi3", "phi2"))
    assert "'phi2.ecsv' has two columns 'phi2'" in plain(refused("check", folder / "gd1" / "gd1.toml"))


def rewritten(path: Path, old: str, new: str) -> Path:
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("gd1/gd1", '"track"\nframe = "GD1Koposov10"', '"track"\nframe = "GD1Koposov2010"',
         "observable.frame: there is no frame 'GD1Koposov2010'. Did you mean 'GD1Koposov10'?"),
        ("gd1/gd1", 'kernel = "3 deg"', 'kernel = "0 deg"', "observable.kernel: found 0.0 deg, should be greater than"),
        ("gd1/gd1", 'kernel = "3 deg"', 'kernel = "1000 deg"', "found 1000.0 deg, should be less than or equal to 45"),
        ("gd1/gd1", "radial_velocity_outliers = { uniform = [0, 0.5] }", "radial_velocity_outliers = 1",
         "observable.radial_velocity_outliers: found 1, should be less than 1"),
        ("gd1/gd1", 'radial_velocity_dispersion = { uniform = ["0 km/s", "30 km/s"] }',
         'radial_velocity_dispersion = "-1 km/s"', "found -1.0 km/s, should be greater than or equal to 0"),
        ("gd1/gd1", 'stars = ["radial_velocity"]', 'stars = ["radial_velocty"]', "Did you mean 'radial_velocity'?"),
        ("gd1/gd1", 'stars = ["radial_velocity"]', 'stars = ["distance_modulus"]', "observable.stars: found "
         "['distance_modulus']: there is no table of 'distance_modulus'; there is phi2, distance, pm_phi1_cosphi2"),
        ("gd1/gd1", 'stars = ["radial_velocity"]', 'stars = "radial_velocity"', "should be a list"),
        ("gd1/gd1", 'distance = "distance.ecsv"', 'distances = "distance.ecsv"', "Did you mean 'distance'?"),
        ("gd1/gd1", '"phi2.ecsv"', '{ file = "phi2.ecsv", columns = { eror = "error" } }', "Did you mean 'error'?"),
        ("gd1/gd1", '"phi2.ecsv"', "{ phi1 = [1, 2], phi2 = [0, 1], error = [1] }", "phi1 2, phi2 2, error 1"),
        ("gd1/gd1", '"phi2.ecsv"', "{ phi1 = [1], phi2 = [0], error = [0] }", "entry [0] is 0 deg, expected positive"),
        ("sagittarius_track/sagittarius_track", "unwrapped = true", "unwrapped = false",
         "phi1 runs over 420 deg, more than a turn; expected unwrapped = true"),
        ("orphan_lmc/orphan_lmc", "[11.1, 252.24, 7.25]", "[11.1, 252.24]", "gsr_sun takes three velocities"),
        ("orphan_lmc/orphan_lmc", 'velocity_frame = "gsr"', 'velocity_frame = "GSR"', "Did you mean 'gsr'?"),
        ("pal5/pal5", "systematic = 0.03", "systematic = 1", "data.rotation_curve.systematic: found 1"),
        ("pal5/pal5", "[likelihood]", '[data.more]\nkind = "enclosed_mass"\nradius = 0\nmass = [2e11, 1e10]\n'
         "[likelihood]", "data.more.radius: found 0 kpc, should be greater than 0"),
        ("pal5/pal5", "[likelihood]", '[data.more]\nkind = "enclosed_mass"\nradius = 9\nmass = [-2e11, 1e10]\n'
         "[likelihood]", "data.more.mass: found [-200000000000.0, 10000000000.0]: expected a positive number"),
        ("pal5/pal5", "[likelihood]", '[data.more]\nkind = "flattening"\nradius = 9\nz = 0\nq = [0.9, 0.1]\n'
         "[likelihood]", "data.more.z: in the plane the potential has no flattening"),
        ("pal5/pal5", "[likelihood]", '[data.more]\nkind = "rotation_curv"\n[likelihood]', "'rotation_curve'?"),
    ],
)  # fmt: skip
def test_a_field_that_is_wrong(folder: Path, file: str, old: str, new: str, said: str) -> None:
    assert said in plain(refused("check", rewritten(folder / f"{file}.toml", old, new)))


@pytest.mark.parametrize(
    ("phi1", "told"),
    [
        ([310.0, 330.0, 320.0], "no warnings"),  # in another order, across a whole turn
        pytest.param([-30.0, -30.0, -30.0], "no warnings", marks=pytest.mark.slow),
        pytest.param([-30.0], "no warnings", marks=pytest.mark.slow),
        ([150.0, 160.0, 170.0], "3 of its longitudes lie where the stream has no debris"),
    ],
)
def test_unusual_tables_are_data(folder: Path, phi1: list[float], told: str) -> None:
    """One star, one longitude several times, angles of any turn and order; what is beside the debris is told."""
    rows = ", ".join(str(angle) for angle in phi1)
    table = f"{{ phi1 = [{rows}], phi2 = [{'0.1, ' * len(phi1)}], error = [{'1, ' * len(phi1)}] }}"
    result = call("check", rewritten(folder / "gd1" / "gd1.toml", '"phi2.ecsv"', table), *FEW)
    assert result.exit_code == 0
    assert told in plain(result.output)


def test_very_many_stars(folder: Path) -> None:
    """A text shows the worst of them, and a call stays cheap."""
    rng, n = np.random.default_rng(3), 20000
    columns = {"phi1": rng.uniform(-60, 0, n), "radial_velocity": rng.normal(-100, 50, n), "error": np.full(n, 5.0)}
    units = '{ phi1 = "deg", radial_velocity = "km/s", error = "km/s" }'
    Table(columns).write(folder / "gd1" / "many.csv")
    given = f'radial_velocity = {{ file = "many.csv", units = {units} }}'
    path = rewritten(folder / "gd1" / "gd1.toml", 'radial_velocity = "radial_velocity.ecsv"', given)
    result = call("check", path, *FEW)
    assert result.exit_code == 0, result.output
    assert "the 20 of 20032 that are farthest from the data" in plain(result.output)


def test_distances_that_are_moduli_have_a_name_of_their_own(folder: Path) -> None:
    write(folder / "gd1" / "distance.ecsv", phi1=[-30.0] * u.deg, distance=[14.5] * u.mag, error=[0.1] * u.mag)
    said = plain(refused("check", folder / "gd1" / "gd1.toml"))
    assert "found the unit 'mag', expected kpc or one like it. A distance modulus has a name of its own: " in said


def test_a_number_out_of_its_range_is_told_with_the_unit_that_the_file_states(folder: Path) -> None:
    columns = {"ra": [140.0] * u.deg, "dec": [20.0] * u.rad, "pm_dec": [-12.0] * u.mas / u.yr}
    write(folder / "gd1" / "members.ecsv", **columns, pm_dec_error=[0.1] * u.mas / u.yr)
    path = folder / "gd1" / "gd1.toml"
    path.write_text(path.read_text().replace('phi2 = "phi2.ecsv"', 'members = "members.ecsv"'))
    said = plain(refused("check", path))
    assert "row 1 is 1145.92 deg, expected -90 to 90, after conversion from the unit 'rad': is that the unit?" in said


@pytest.mark.parametrize(("factor", "told"), [(1.0, False), (np.pi / 180, True), (0.1, False)])
def test_longitudes_that_are_likely_in_radians_are_told(factor: float, told: bool) -> None:
    degrees = np.linspace(-55.0, -5.0, 6)
    given = dict.fromkeys(("distance", "radial_velocity"), (degrees, degrees, degrees))
    said = in_radians(given | {"phi2": (degrees * factor, degrees, degrees)})
    assert [text.partition(":")[0] for text in said] == ["phi2"] * told
    assert not told or '-0.96 to -0.0873 deg, that of the other data from -55 to -5 deg. Is it in radians?' in said[0]
