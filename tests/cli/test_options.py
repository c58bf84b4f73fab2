"""What the commands print for programs, and for nobody; PDFs; texts as wide as the terminal."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from commands import call, refused
from PIL import Image
from runfiles import RUN

import streamkit as sk
from streamkit.report import as_json, columns, paragraph

LITERATURE = "quantity,radius,value,error_minus,error_plus,reference\nM,50,2.7e11,1e10,1e10,Doe 2031\n"


def record(*args):
    done = call(*args, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_numbers_that_json_has_not_are_null():
    assert json.loads(as_json({"a": [math.nan, 1.5], "b": (math.inf, True, "x")})) == {
        "a": [None, 1.5],
        "b": [None, True, "x"],
    }


def test_check_as_json_and_quietly(run_file: Path):
    found = record("check", run_file, "--draws", "2")
    spec = sk.load(run_file)
    assert found["digest"] == spec.digest()
    assert list(found["parameters"]) == list(spec.names)
    assert found["parameters"]["potential.v0"] == {"prior": "uniform(190, 230)", "centre": 210, "unit": "km/s"}
    assert found["prior_draws"]["draws"] == 2
    (stream,) = found["streams"].values()
    assert stream["pericentres"][0] < stream["apocentres"][0]
    assert found["cost"]["most_calls"] == 32
    done = call("check", run_file, "--draws", "0", "-q")
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout == "" or done.stdout.startswith("warnings")


def test_another_kind_drops_fields_with_a_remark(run_file: Path):
    run_file.write_text(RUN.replace("particles = 400", "particles = 400\nsigma = '8 km/s'"))
    done = call("check", run_file, "--draws", "0", "-q", "--set", "stripping.kind=restricted_nbody")
    assert done.exit_code == 0, done.output
    assert f"{run_file}: dropped stripping.sigma: the new kind has no such field" in done.stderr


def test_data_on_the_host_are_in_the_json_of_a_stream(run_file: Path):
    run_file.write_text(f"{RUN}[data.speed]\nkind = 'circular_velocity'\nradius = 8\nv_c = [230, 5]\n")
    _, found = record("stream", run_file)
    assert found["data"] == "speed"
    expected = sk.model.Host(sk.load(run_file).bind().potentials).circular_velocity(np.array([8.0]))[0]
    assert found["observables"]["v_c"] == {
        "model": pytest.approx(expected), "own_noise": 0.0, "data": 230.0, "error": 5.0
    }  # fmt: skip


def test_a_stream_as_json_is_what_python_gives(run_file: Path):
    (found,) = record("stream", run_file)
    spec = sk.load(run_file)
    made, prediction = sk.Model(spec).observe(spec.bind())
    assert (found["leading"], found["trailing"]) == ((made.arm == 1).sum(), (made.arm == -1).sum())
    for name, mean in zip(prediction.names, prediction.mean, strict=True):
        assert found["observables"][name]["model"] == pytest.approx(mean)
    assert found["observables"][prediction.names[0]]["data"] in {57.0, 96.2, 95.0}
    assert call("stream", run_file, "-q", "-o", "s.ecsv").output == ""
    assert (run_file.parent / "s.ecsv").exists()


def test_the_components_as_json():
    every = record("plugins")
    assert {"potential", "stripping", "integrator", "observable"} <= {each["role"] for each in every}
    (nfw,) = record("plugins", "potential", "nfw")
    (mass,) = (each for each in nfw["parameters"] if each["name"] == "mass")
    assert (mass["unit"], mass["required"], mass["allowed"]) == ("Msun", True, "> 0")
    assert "nothing is called 'potentail'" in refused("plugins", "potentail", "--json")
    assert "use 'streamkit reference potential nfw'" in refused("reference", "potential.nfw")


@pytest.mark.slow
def test_a_fit_as_json_with_pdfs_beside_literature(fit_file: Path):
    where = fit_file.parent / "out"
    (fit_file.parent / "others.csv").write_text(LITERATURE)
    found = record("run", fit_file, "-o", where, "--steps", "2", "--pdf", "--literature", "others.csv")
    results = sk.load_results(where)
    assert found["steps"] == 2
    assert found["verdict"] == "do not use"
    assert found["parameters"]["rows"][0]["median"] == pytest.approx(float(results.summary()["median"][0]))
    assert found["mass_profile"]["units"]["M"] == "solMass"
    assert (where / "literature.ecsv").exists()
    for picture in where.glob("*.png"):
        assert picture.with_suffix(".pdf").read_bytes()[:5] == b"%PDF-", picture
    manifest = json.loads((where / "manifest.json").read_text())
    assert manifest["options"]["arguments"] == ["--steps", "2", "--literature", "others.csv", "--pdf"]
    before = (where / "corner.pdf").stat().st_mtime_ns
    assert call("report", where, "-q").output == ""
    assert (where / "corner.pdf").stat().st_mtime_ns > before
    sk.run(fit_file, where, steps=1, force=True, progress=False, products=False)
    assert not list(where.glob("*.pdf"))


def test_literature_that_cannot_be_read_is_told_before_the_run(fit_file: Path):
    assert "no such file" in refused("run", fit_file, "-o", "out", "--literature", "none.csv")
    assert "(expected ECSV, CSV, FITS or VOTable)" in refused("run", fit_file, "-o", "out", "--literature", fit_file)
    assert not (fit_file.parent / "out").exists()


def test_the_studies_as_json(run_file: Path):
    found = record("ablate", run_file, "--vary", "stripping.kind=mlcs,streakline", "-o", "a", "--pdf", "--column")
    assert found["stopped"] == ""
    assert all(table["rows"] for table in found["tables"].values())
    assert list((run_file.parent / "a").glob("*.pdf"))
    for picture in (run_file.parent / "a").glob("*.png"):
        with Image.open(picture) as image:
            assert image.width / image.info["dpi"][0] < 7.2, picture


def test_texts_are_as_wide_as_the_terminal(monkeypatch):
    rows = [("name", "word " * 60)]
    for wide in (70, 100, 150):
        monkeypatch.setenv("COLUMNS", str(wide))
        assert wide - 10 < max(map(len, columns(rows).splitlines())) <= wide
        assert max(map(len, paragraph("word " * 60).splitlines())) <= min(wide, 100)
