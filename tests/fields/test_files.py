"""Arrays, tables and files as fields: every form of the run file, and a sentence for everything that is wrong."""

import pickle
import tomllib
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable
from commands import call
from pydantic import Field
from runfiles import BASE, schema_with

import streamkit as sk
from streamkit.fields import Files

RADII, SPEEDS = [8.0, 50.0, 100.0, 200.0], [237.0, 158.0, 133.0, 110.0]

PLUGIN = '''
from typing import Annotated, Any
import numpy as np
from pydantic import Field
import streamkit as sk

class Window(sk.Observable):
    """Counts particles beyond radii."""
    kind = "window"
    example = {"r": [8, 12], "track": {"phi1": [0, 1], "error": [1, 1]}}
    r: Annotated[sk.LengthArray, sk.Increasing()] = Field(description="Radii.")
    track: Annotated[sk.Table, sk.Columns(phi1="deg", error="deg").optional(weight="")] = Field(description="Track.")
    file: sk.DataFile | None = Field(default=None, description="A file.")
    v: sk.SpeedArray | None = Field(default=None, description="Speeds.")
    def data(self) -> Any:
        return np.ones(1), np.ones(1)
    def predict(self, stream: Any) -> Any:
        return sk.Prediction(("n",), np.array([(stream.r > self.r[0]).mean()]), np.ones(1))

@sk.hookimpl
def streamkit_components() -> list[type[sk.Component]]:
    return [Window]
'''


class Toy(sk.Observable):
    kind = "toy"
    r: Annotated[sk.LengthArray, sk.Increasing()] = Field(default=[1.0, 2.0], description="Radii.")
    v: sk.SpeedArray | None = Field(default=None, description="Speeds.")
    t: sk.TimeArray | None = Field(default=None, description="Times.")
    grid: sk.NumberTensor | None = Field(default=None, description="Numbers.")
    table: Annotated[sk.Table, sk.Columns(phi1="deg", error="deg").optional(w="")] | None = Field(
        default=None, description="Table."
    )
    file: sk.DataFile | None = Field(default=None, description="File.")

    def data(self) -> Any:
        return np.ones(1), np.ones(1)

    def predict(self, stream: sk.Stream) -> Any:
        raise NotImplementedError


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    table = QTable({"R": RADII * u.kpc, "v_c": np.array(SPEEDS) * u.km / u.s, "bare": SPEEDS})
    table["R_pc"] = table["R"].to(u.pc)
    table.write(tmp_path / "v.ecsv")
    table.write(tmp_path / "v.fits")
    table.write(tmp_path / "v.csv")
    (tmp_path / "marked.csv").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "v.csv").read_bytes())  # as Excel writes it
    np.save(tmp_path / "v.npy", SPEEDS)
    np.save(tmp_path / "grid.npy", np.arange(6).reshape(2, 3))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "form",
    [
        RADII,
        ["8 kpc", "50000 pc", 100, 200],
        "[8, 50, 100, 200] kpc",
        "[8000, 50000, 100000, 200000] pc",
        RADII * u.kpc,
        np.array(RADII),
        {"file": "v.ecsv", "column": "R"},
        {"file": "v.ecsv", "column": "R_pc"},
        {"file": "v.fits", "column": "R_pc"},
        {"file": "v.csv", "column": "R", "unit": "kpc"},
        {"file": "marked.csv", "column": "R", "unit": "kpc"},
        {"file": "v.csv", "column": "R_pc", "unit": "pc"},
    ],
    ids=str,
)
def test_an_array_has_many_forms(folder: Path, form: Any) -> None:
    result = Toy(r=form).r
    np.testing.assert_allclose(result, RADII, rtol=1e-12)
    assert result.dtype == float
    with pytest.raises(ValueError, match="read-only"):
        result[0] = 1.0


def test_arrays_of_numpy_have_the_unit_that_is_told_or_that_of_the_field(folder: Path) -> None:
    np.testing.assert_array_equal(Toy(v={"file": "v.npy"}).v, SPEEDS)
    np.testing.assert_array_equal(Toy(v="v.npy").v, SPEEDS)
    np.testing.assert_allclose(Toy(v={"file": "v.npy", "unit": "m/s"}).v, np.array(SPEEDS) / 1e3)
    assert Toy(grid="grid.npy").grid.shape == (2, 3)


def test_defaults_are_arrays_and_components_compare_by_their_numbers(folder: Path) -> None:
    assert isinstance(Toy().r, np.ndarray)
    assert Toy(v=[1, 2]) == Toy(v="[1, 2] km/s") != Toy(v=[1, 3])
    toy = Toy(v="v.npy", table={"phi1": [1], "error": ["60 arcmin"]}, file="v.csv")
    assert pickle.loads(pickle.dumps(toy)) == toy
    assert Toy.model_validate_json(toy.model_dump_json()) == toy


def test_a_table_has_many_forms(folder: Path) -> None:
    inline = Toy(table={"phi1": [0.0, 1.0], "error": "[60, 120] arcmin"}).table
    assert (len(inline), inline.names) == (2, ("phi1", "error"))
    np.testing.assert_allclose(inline["error"], [1, 2])
    QTable({"phi1": [0, 60] * u.arcmin, "PHI2": [1, 2] * u.deg, "w": [1, 2]}).write(folder / "t.ecsv")
    file = Toy(table={"file": "t.ecsv", "columns": {"error": "PHI2"}}).table
    np.testing.assert_allclose(file["phi1"], [0, 1])
    np.testing.assert_allclose(file["w"], [1, 2])
    mixed = Toy(table={"phi1": [1, 2, 3, 4], "error": {"file": "v.csv", "column": "R", "unit": "deg"}}).table
    np.testing.assert_array_equal(mixed["error"], RADII)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"r": [8]}, r"found 1 number.*at least 2"),
        ({"r": [8, float("nan")]}, r"entry \[1\] is nan kpc, expected a finite number"),
        ({"r": [8, 7]}, r"entry \[1\] is 7, expected larger than the one before: sort"),
        ({"r": [-1, 7]}, r"entry \[0\] is -1 kpc, expected positive"),
        ({"r": [8, "9 km/s"]}, "expected a quantity in kpc.*found '9 km/s'"),
        ({"r": [8, [9, 10]]}, "not of one length"),
        ({"r": [[8, 9], [10, 11]]}, r"shape \(2, 2\), expected 1 dim"),
        ({"r": "[8, 9"}, "expected a list with a unit"),
        ({"r": "[8, 9] km/s"}, "expected a quantity in kpc"),
        ({"r": 8.0}, "found 8.0, expected a list"),
        ({"r": {"file": "none.ecsv", "column": "R"}}, "cannot read the file 'none.ecsv'.*No such file"),
        ({"r": {"file": "v.ecsv", "column": "r"}}, "no column 'r'. Did you mean 'R'"),
        ({"r": {"file": "v.ecsv"}}, "which column of 'v.ecsv'"),
        ({"r": {"file": "v.ecsv", "colum": "R"}}, "no key 'colum'. Did you mean 'column'"),
        ({"r": {"file": "v.ecsv", "column": "v_c"}}, "found the unit 'km/s', expected kpc"),
        ({"r": {"file": "v.ecsv", "column": "bare"}}, "gives no unit, expected one like kpc"),
        ({"r": {"file": "v.csv", "column": "R", "unit": "kpcs"}}, "found the unit 'kpcs', expected kpc"),
        ({"r": {"file": "v.txt", "column": "R"}}, "'.txt'"),
        ({"r": {"file": "bad.ecsv", "column": "R"}}, "'bad.ecsv' is no table in the format ECSV"),
        ({"r": {"file": "bad.fits", "column": "R"}}, "'bad.fits' is no table in the format FITS"),
        ({"r": {"file": "bad.npy"}}, "'bad.npy' is no array in numpy's format"),
        ({"r": {"file": "object.npy"}}, "'object.npy' is no array in numpy's format"),
        ({"r": {"file": "hole.ecsv", "column": "R"}}, "the value of row 2 is missing"),
        ({"r": {"file": "hole.ecsv", "column": "name"}}, "found 'a', expected numbers"),
        ({"r": {"file": 3}}, "expected { file ="),
        ({"table": {"phi1": [1]}}, "the column 'error' is missing"),
        ({"table": {"phi1": [1], "err": [1]}}, "no column 'err'. Did you mean 'error'"),
        ({"table": {"phi1": [1, 2], "error": [1]}}, "differ in length: phi1 2, error 1"),
        ({"table": {"phi1": [1], "error": ["1 kpc"]}}, "column 'error': expected a quantity in deg"),
        ({"table": "v.ecsv"}, "no column 'phi1'"),
        ({"table": 3}, "found 3, expected a file"),
        ({"table": {"file": "v.ecsv", "column": {}}}, "no key 'column'. Did you mean 'columns'"),
        ({"file": "none.dat"}, "cannot read the file 'none.dat'"),
        ({"file": "9" * 300}, "File name too long"),
        ({"file": 3}, "found 3, expected the name of a file"),
    ],
    ids=str,
)
def test_what_is_wrong_is_told(folder: Path, values: dict[str, Any], said: str) -> None:
    for name in ("bad.ecsv", "bad.fits", "bad.npy", "v.txt"):
        (folder / name).write_text("nothing\nof this kind: {")
    np.save(folder / "object.npy", np.array([1, None]), allow_pickle=True)
    (folder / "hole.ecsv").write_text(
        "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: R, unit: kpc, datatype: float64}\n"
        '# - {name: name, datatype: string}\nR name\n8 a\n"" b\n'
    )
    with pytest.raises(ValueError, match=said):
        Toy(**values)


@pytest.fixture
def run_file(folder: Path) -> Path:
    (folder / "window.py").write_text(PLUGIN)
    (folder / "sub").mkdir()
    QTable({"phi1": [0, 1] * u.deg, "error": [1, 1] * u.deg}).write(folder / "sub" / "t.ecsv")
    (folder / "notes.dat").write_text("notes")
    document = BASE | {
        "plugins": ["window.py"],
        "stripping": BASE["stripping"] | {"particles": 100},
        "sampler": {"walkers": 8, "steps": 2, "start_particles": 50},
        "observable": {
            "kind": "window",
            "r": {"file": "v.ecsv", "column": "R_pc"},
            "track": "sub/t.ecsv",
            "file": "notes.dat",
            "v": ["1 km/s", 2],
        },
    }
    (folder / "run.toml").write_text(sk.runfile.to_toml(document))
    return folder / "run.toml"


def test_the_run_file_keeps_the_names_and_knows_what_is_in_the_files(run_file: Path) -> None:
    spec = sk.load(run_file)
    assert set(spec.files) == {"v.ecsv", "sub/t.ecsv", "notes.dat"}
    assert spec.document["observable"]["r"] == {"file": "v.ecsv", "column": "R_pc"}
    assert spec.document["observable"]["v"] == ["1 km/s", 2]
    assert spec.document["observable"]["track"] == "sub/t.ecsv"
    (run_file.parent / "resolved.toml").write_text(spec.toml())
    again = sk.load(run_file.parent / "resolved.toml")
    assert again == spec
    assert again.digest() == spec.digest()
    observable = spec.bind().observable
    assert observable is not None
    np.testing.assert_allclose(observable.r, RADII)
    assert pickle.loads(pickle.dumps(spec)).bind().observable == observable
    assert spec.with_values({"observable.v": [3.0, 4.0]}).bind().observable.v.tolist() == [3.0, 4.0]


def test_a_digest_follows_what_is_in_a_file_and_not_its_name(run_file: Path) -> None:
    first, folder = sk.load(run_file), run_file.parent
    (folder / "notes.dat").rename(folder / "other.dat")
    run_file.write_text(run_file.read_text().replace("notes.dat", "other.dat"))
    assert sk.load(run_file).digest() == first.digest()
    (folder / "other.dat").write_text("changed")
    assert sk.load(run_file).digest() != first.digest()


def test_a_file_that_changes_is_noticed_by_workers_and_by_the_component(run_file: Path) -> None:
    spec, folder = sk.load(run_file), run_file.parent
    sent, file = pickle.dumps(spec), spec.bind().observable.file  # type: ignore[union-attr]
    assert file.read_text() == "notes"
    (folder / "notes.dat").write_text("changed")
    with pytest.raises(sk.SpecError, match=r"'notes.dat' has changed since"):
        pickle.loads(sent)
    with pytest.raises(sk.SpecError, match="has changed since"):
        file.read_bytes()
    (folder / "notes.dat").unlink()
    with pytest.raises(sk.SpecError, match="cannot read the data file"):
        file.read_bytes()


def test_a_run_copies_its_files_and_resumes_with_the_same_ones_alone(run_file: Path) -> None:
    folder, out = run_file.parent, run_file.parent / "out"
    (folder / "window.py").write_text("import neighbour\n" + PLUGIN)
    (folder / "neighbour.py").write_text("")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        sk.run(run_file, out, progress=False, products=False)
        assert (out / "data" / "t.ecsv").read_bytes() == (folder / "sub" / "t.ecsv").read_bytes()
        assert (out / "plugins" / "neighbour.py").exists()
        assert tomllib.loads((out / "run.toml").read_text())["observable"]["track"] == "data/t.ecsv"
        assert sk.load(out / "run.toml").digest() == sk.load(run_file).digest()
        sk.run(run_file, out, steps=3, resume=True, progress=False, products=False)
        table = (folder / "sub" / "t.ecsv").read_text()
        (folder / "sub" / "t.ecsv").write_text(table.replace("1.0 1.0", "1.0 2.0"))
        done = call("run", str(run_file), "-o", str(out), "--resume")
        assert done.exit_code == 2
        assert "the data file sub/t.ecsv" in done.stderr
        (folder / "sub" / "t.ecsv").unlink()
        done = call("run", str(run_file), "-o", str(out), "--resume")
        assert done.exit_code == 2
        assert "observable.track: cannot read the file 'sub/t.ecsv'" in done.stderr.replace("\n", " ")


def test_the_schema_and_the_reference_know_them(run_file: Path) -> None:
    registry = sk.components.load_registry([run_file.parent / "window.py"])
    schema = schema_with(registry)
    window = next(d for name, d in schema["$defs"].items() if "window" in name)
    assert window["properties"]["r"]["anyOf"][0]["type"] == "array"
    assert "file" in window["properties"]["track"]["anyOf"][1]["properties"]
    text = sk.report.listing(registry, "observable", "window")
    assert "phi1 deg, error deg, weight" in text
    assert "list or file" in text


def test_files_are_read_once(folder: Path) -> None:
    files = Files(folder)
    assert files.content("v.csv") is files.content("v.csv")
