"""A table of bodies that have flown past a stream: the same stream as a section for each, and what is refused."""

import tomllib

import numpy as np
import pytest
from astropy import units as u
from astropy.table import Table

import streamkit as sk
from streamkit.components import load_registry
from streamkit.runfile import json_schema

UNITS = {"mass": "Msun", "radius": "kpc", "phi1": "deg", "time": "Gyr", "impact_parameter": "kpc", "angle": "deg",
         "v_parallel": "km/s", "v_perpendicular": "km/s"}  # fmt: skip
FRAME = {"pole": [192.85948, 27.12825], "origin": [266.4051, -28.936175]}


def rows():
    return {
        "mass": [1e7, 3e6, 2e5, 5e6, 1e6, 4e5],
        "radius": [0.5, 0.3, 0.07, 0.4, 0.2, 0.1],
        "phi1": [0.0, -1.0, 0.5, 1.0, 0.0, 0.2],
        "time": [0.3, 0.5, 0.2, 0.7, 0.6, 0.4],
        "impact_parameter": [0.1, 0.5, 0.0, 2.0, 1.0, 0.3],
        "angle": [0.0, 40.0, 90.0, 200.0, 300.0, -20.0],
        "v_parallel": [-100.0, 30.0, -250.0, -300.0, 10.0, -60.0],
        "v_perpendicular": [150.0, 90.0, 60.0, -120.0, 200.0, 100.0],
    }


def run_file(table=None, **body):
    document = {
        "potential": {"kind": "logarithmic_halo", "v0": 220},
        "progenitor": {"kind": "plummer", "mass": 1e-3, "radius": "1 pc", "x": 10, "y": 0, "z": 0, "vx": 0, "vy": 220,
                       "vz": 0, "lookback": 1},
        "stripping": {"kind": "mlcs", "particles": 200, "sigma": 0.05, "progenitor_gravity": False},
    }  # fmt: skip
    shared = {"encounter": {"frame": FRAME}}
    return document | {"body": {"subhaloes": {"kind": "plummer", "table": table or rows()} | shared | body}}


def refused(document):
    with pytest.raises(sk.SpecError) as error:
        sk.load(document)
    return str(error.value)


def test_a_row_is_a_body_in_a_section_of_its_own(tmp_path, monkeypatch):
    columns = rows()
    each = {
        f"b{i}": {"kind": "plummer", "mass": columns["mass"][i], "radius": columns["radius"][i],
                  "encounter": {"frame": FRAME} | {name: columns[name][i] for name in list(UNITS)[2:]}}
        for i in range(6)
    }  # fmt: skip
    one_by_one = sk.Model(run_file() | {"body": each}).stream()
    assert np.array_equal(sk.Model(run_file()).stream().q, one_by_one.q)
    table = Table({name: column * u.Unit(UNITS[name].replace("Msun", "solMass")) for name, column in columns.items()})
    table["radius"] = table["radius"].to(u.pc)
    table.write(tmp_path / "subhaloes.ecsv")
    monkeypatch.chdir(tmp_path)
    spec = sk.load(run_file("subhaloes.ecsv"))
    assert np.abs(sk.Model(spec).stream().q - one_by_one.q).max() < 1e-9
    (tmp_path / "run.toml").write_text(spec.toml())
    again = sk.load(tmp_path / "run.toml")
    assert again.document == spec.document
    assert again.digest() == spec.digest()
    table["mass"] *= 2
    table.write(tmp_path / "subhaloes.ecsv", overwrite=True)
    assert sk.load(tmp_path / "run.toml").digest() != spec.digest()


def test_the_factor_of_all_masses_may_have_a_prior():
    spec = sk.load(run_file(mass_factor={"uniform": [0, 2]}))
    assert spec.names == ("body.subhaloes.mass_factor",)
    flybys = spec.bind([1.5]).flybys
    assert [flyby.potential.mass for flyby in flybys.values()] == pytest.approx(1.5 * np.array(rows()["mass"]))
    assert list(flybys)[2] == "subhaloes, row 3"


def test_a_table_acts_on_the_stream_that_its_bodies_met_alone():
    one = run_file(mass_factor={"uniform": [0, 2]}, encounter={"frame": FRAME, "stream": "a"})
    stream = {key: one.pop(key) for key in ("progenitor", "stripping")}
    both = sk.load(one | {"stream": {"a": stream, "b": stream}})
    assert [factor.name for factor in both.factors if len(factor.own)] == ["a"]
    assert both.only("b").names == ()
    inputs = both.bind_all()
    assert (len(inputs.streams["a"].flybys), len(inputs.streams["b"].flybys)) == (6, 0)


def changed(name, row, value):
    columns = rows()
    columns[name][row] = value
    return columns


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        (run_file("nope.ecsv"), "body.subhaloes.table: cannot read the file 'nope.ecsv'"),
        (run_file(changed("mass", 4, -1.0)), "body.subhaloes.table: row 5, mass: found -1.0"),
        (run_file(changed("impact_parameter", 1, -1.0)), "row 2, impact_parameter: found -1.0"),
        (run_file(changed("time", 5, 3.0)), "body.subhaloes.table: row 6, time: found 3 Gyr, expected less than the"),
        (run_file({k: v for k, v in rows().items() if k != "angle"}), "the column 'angle' is missing"),
        (run_file(rows() | {"x": [1.0] * 6}), "there is no column 'x'"),
        (run_file(mass=1e6), "body.subhaloes.mass: the table of bodies (plummer) has no field 'mass'"),
        (run_file(kind="log_halo"), "body.subhaloes.kind"),
        (run_file(kind="logarithmic_halo"), "has no field 'mass' in Msun"),
        (run_file(encounter={"frame": FRAME, "phi1": 3}), "encounter.phi1: found beside a table of bodies"),
        (run_file(encounter={"frame": FRAME, "stream": "gd2"}), "encounter.stream: found 'gd2', and no stream is"),
        (run_file(encounter={}), "body.subhaloes.encounter: 'frame' is missing"),
        (run_file(encounter=3), "body.subhaloes.encounter: found 3, expected a table with stream or frame"),
    ],
)
def test_a_table_that_cannot_be_is_refused(document, sentence):
    assert sentence in refused(document)


def test_a_row_whose_point_the_stream_does_not_reach_is_named():
    with pytest.raises(sk.OutOfDomain, match=r"body subhaloes, row 3: .* has no particles at phi1 = 90 deg"):
        sk.Model(run_file(changed("phi1", 2, 90.0))).stream()


def test_the_schema_knows_tables_of_bodies():
    definitions = json_schema(load_registry())["$defs"]
    fields = definitions["bodies.plummer"]["properties"]
    assert set(fields) == {"kind", "table", "mass_factor", "encounter", "friction", "reflex"}


SATELLITES = {
    "mass": [1e11, 4e8, 2e9],
    "radius": [9.0, 0.8, 1.5],
    "x": [-1.0, 30.0, 17.0],
    "y": [-41.0, 20.0, 2.0],
    "z": [-28.0, -50.0, -6.0],
    "vx": [-57.0, 100.0, 230.0],
    "vy": [-226.0, 20.0, -35.0],
    "vz": [221.0, -60.0, 195.0],
}
SKY = {
    "mass": [1.4e11, 1e9],
    "radius": [16.0, 1.0],
    "ra": [81.28, 283.0],
    "dec": [-69.78, -30.0],
    "distance": [49.6, 26.0],
    "pm_ra_cosdec": [1.858, -2.7],
    "pm_dec": [0.385, -1.4],
    "v_los": [262.2, 142.0],
}
SHARED = {"friction": "none", "reflex": False}


def placed(table, **body):
    document = run_file()
    return document | {"body": {"satellites": {"kind": "plummer", "table": table} | body}}


def row(table, i):
    return {name: column[i] for name, column in table.items()}


@pytest.mark.parametrize("table", [SATELLITES, SKY], ids=["Galactocentric", "sky"])
def test_a_row_with_a_place_today_is_a_body_in_a_section_of_its_own(table, tmp_path, monkeypatch):
    """In the run file or in a file, whose unit of the size is pc; with masses that share a factor."""
    count = len(table["mass"])
    each = {f"b{i}": {"kind": "plummer"} | row(table, i) | SHARED for i in range(count)}
    one_by_one = sk.Model(run_file() | {"body": each}).stream()
    spec = sk.load(placed(table, **SHARED))
    assert np.array_equal(sk.Model(spec).stream().q, one_by_one.q)
    assert list(spec.bind().bodies)[1] == "satellites, row 2"
    assert sk.load(tomllib.loads(spec.toml())).document == spec.document
    units = UNITS | dict.fromkeys(("ra", "dec"), "deg") | dict.fromkeys(("pm_ra_cosdec", "pm_dec"), "mas/yr")
    units |= dict.fromkeys(("distance", *"xyz"), "kpc") | dict.fromkeys(("v_los", "vx", "vy", "vz"), "km/s")
    made = Table({name: column * u.Unit(units[name].replace("Msun", "solMass")) for name, column in table.items()})
    made["radius"] = made["radius"].to(u.pc)
    made["name"] = ["a galaxy"] * count
    made.write(tmp_path / "satellites.ecsv")
    monkeypatch.chdir(tmp_path)
    free = sk.load(placed("satellites.ecsv", mass_factor={"uniform": [0, 2]}, **SHARED))
    assert free.names == ("body.satellites.mass_factor",)
    assert np.abs(sk.Model(free).stream([1.0]).q - one_by_one.q).max() < 1e-9
    assert [body.mass for body in free.bind([0.5]).bodies.values()] == pytest.approx(0.5 * np.array(table["mass"]))


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        (placed(SATELLITES | {"ra": [1.0] * 3}), "body.satellites.table: found coordinates of several sets"),
        (placed({"mass": [1e9], "radius": [1.0]}), "satellites.table: found no phase-space coordinates"),
        (placed({"mass": [1e9], "radius": [1.0]}), "Or expected those of an encounter: phi1, time, impact_parameter"),
        (placed({k: v for k, v in SATELLITES.items() if k != "vz"}), "satellites.table: the column 'vz' is missing"),
        (placed(SATELLITES | {"mass": [1e9, -1.0, 1e9]}), "body.satellites.table: row 2, mass: found -1.0"),
        (placed(SKY | {"dec": [0.0, -100.0]}), "body.satellites.table: row 2, dec: found -100.0"),
        (placed(SATELLITES, friction="some"), "body.satellites.friction: found 'some'"),
        (placed(SATELLITES, x=3), "body.satellites.x: the table of bodies (plummer) has no field 'x'"),
        (placed({k: list(v) * 40 for k, v in SATELLITES.items()}), "found 120 bodies with places today"),
        (placed(SATELLITES, kind="logarithmic_halo"), "has no field 'mass' in Msun"),
    ],
)
def test_a_table_of_places_that_cannot_be_is_refused(document, sentence):
    assert sentence in refused(document)
