"""A stranger's potential of under 40 lines, package files included: installed by pip, checked, and fitted."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.table import QTable
from commands import call, refused
from runfiles import FIT

import streamkit
from streamkit.runfile import to_toml

SOURCE = Path(__file__).parents[1] / "third_party"

RUN = to_toml(
    FIT
    | {"potential": {"kind": "jaffe", "mass": {"uniform": ["8e11 Msun", "1.2e12 Msun"]}, "a": "80 kpc"}}
    | {"stripping": FIT["stripping"] | {"sigma": {"uniform": ["5 km/s", "15 km/s"]}}}
)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A directory with the package's sources, and the package installed by pip in ``site`` beside them."""
    folder = tmp_path_factory.mktemp("jaffe")
    shutil.copytree(SOURCE, folder / "source")
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--disable-pip-version-check"]
    if importlib.util.find_spec("hatchling"):  # else pip fetches it for the build
        command.append("--no-build-isolation")
    run(folder, *command, "--target", folder / "site", folder / "source")
    (folder / "fit.toml").write_text(RUN)
    return folder


def start(folder, *command):
    """Run a command where the package is installed."""
    path = os.pathsep.join([str(folder / "site"), str(Path(streamkit.__file__).parent.parent)])
    environment = {**os.environ, "PYTHONPATH": path}
    arguments = [str(part) for part in command]
    return subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True)


def run(folder, *command):
    """Run a command that must succeed, and return what it prints."""
    done = start(folder, *command)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def beside(place, monkeypatch):
    """The directory as working directory, the package on the path of this process."""
    monkeypatch.syspath_prepend(place / "site")
    monkeypatch.chdir(place)


def test_it_takes_less_than_forty_lines():
    files = [file for file in SOURCE.iterdir() if file.is_file()]
    assert sorted(file.suffix for file in files) == [".py", ".py", ".toml"]
    assert sum(len(file.read_text().splitlines()) for file in files) < 40


@pytest.mark.usefixtures("beside")
def test_it_is_listed_with_its_supplier_and_units():
    out = call("plugins", "potential", "jaffe").stdout
    assert "streamkit-jaffe 0.1" in out
    rows = [line.split() for line in out.splitlines()]
    assert ["mass", "Msun"] in [row[:2] for row in rows]
    assert ["a", "kpc"] in [row[:2] for row in rows]


@pytest.mark.usefixtures("beside")
def test_a_run_file_with_it_is_checked_as_strictly_as_any(place):
    assert "streamkit-jaffe 0.1" in call("check", "fit.toml", "--draws", "0").stdout
    (place / "wrong.toml").write_text(RUN.replace('a = "80 kpc"', 'a = "80 km/s"'))
    told = refused("check", "wrong.toml")
    assert "potential.a" in told
    assert "kpc" in told


@pytest.mark.slow
def test_it_runs_through_a_whole_fit(place):
    """With two workers, so in fresh processes too. M(r) = mass r / (r + a) exactly (Jaffe 1983)."""
    run(place, sys.executable, "-m", "streamkit", "run", "fit.toml", "-o", "out", "--workers", "2", "--quiet")
    out = place / "out"
    products = {"chain.h5", "summary.ecsv", "mass_profile.ecsv", "run.toml", "corner.png"}
    assert products <= {file.name for file in out.iterdir()}
    summary = QTable.read(out / "summary.ecsv")
    profile = QTable.read(out / "mass_profile.ecsv")
    median = float(summary["median"][list(summary["parameter"]).index("potential.mass")])
    assert 8e11 < median < 1.2e12
    for radius in (50.0, 100.0, 150.0, 200.0):
        row = profile[np.flatnonzero(np.isclose(profile["r"].value, radius))[0]]
        assert row["M"].to_value("Msun") == pytest.approx(median * radius / (radius + 80.0), rel=1e-6)
    assert "streamkit-jaffe" in (out / "manifest.json").read_text()
