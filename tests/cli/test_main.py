"""The command line as its users meet it."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from astropy.table import QTable
from commands import call, refused

import streamkit as sk
from streamkit.components import Registry, load_registry

EXAMPLES = Path(__file__).parents[2] / "examples"
HEAVY = ("numba", "astropy", "emcee", "matplotlib", "scipy", "h5py")


def test_help_is_light_and_names_every_command() -> None:
    code = (
        "import sys\nfrom streamkit.cli.main import main\n"
        "main(['--help'], standalone_mode=False)\n"
        f"print('HEAVY', sorted(set({HEAVY!r}) & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "HEAVY []" in done.stdout
    for name in ("check", "stream", "run", "report", "plugins", "schema"):
        assert f"\n  {name} " in done.stdout


def test_python_m_streamkit() -> None:
    start = [sys.executable, "-m", "streamkit"]
    done = subprocess.run([*start, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"streamkit {sk.__version__}\n")
    done = subprocess.run([*start, "check", "none.toml"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("streamkit: none.toml: cannot read")


def test_check_shows_components_parameters_orbit_and_cost(run_file: Path) -> None:
    result = call("check", run_file.name, "--draws", "4")
    assert result.exit_code == 0
    assert max(map(len, result.stdout.splitlines())) <= 100
    for text in (
        "potential   tf          streamkit",
        "progenitor.mass  log_uniform(3e+08, 9e+08)",
        "pericentre",
        "completed apocentres",
        "of 4 draws",
        "8 walkers x at most 4 steps = 32 calls",
        "one call",
        "warnings",
    ):
        assert text in result.stdout, text


def test_stream_prints_observables_counts_and_parameters(run_file: Path) -> None:
    result = call(
        "stream", run_file, "--set", "progenitor.mass=6.4e8 Msun",
        "--set", "stripping.progenitor_gravity=false",
    )  # fmt: skip
    assert result.exit_code == 0
    rows = [line.split() for line in result.stdout.splitlines()]
    assert ["potential.v0", "210", "km/s", "prior's", "centre"] in rows
    assert ["progenitor.mass", "6.4e+08", "Msun", "set"] in rows
    assert ["stripping.progenitor_gravity", "false", "set"] in rows
    arms = [int(row[2]) for row in rows if row[1:2] == ["arm"]]
    bound, fraction = next(row[1:] for row in rows if row[:1] == ["bound"])
    assert sum(arms) + int(bound) == 400
    assert fraction == f"({int(bound) / 400:.1%})"
    assert any(row[:1] == ["precession"] and row[-1] == "sigma" for row in rows)


@pytest.mark.parametrize("name", ["s.ecsv", "s.hdf5", "s.fits"])
def test_stream_files_hold_the_particles_and_how_to_make_them_again(run_file: Path, name: str) -> None:
    result = call("stream", run_file, "--set", "progenitor.mass=5e8", "-o", name)
    assert result.exit_code == 0, result.stderr
    table = QTable.read(run_file.parent / name)
    assert len(table) == 400
    assert {
        "x", "y", "z", "vx", "vy", "vz", "t_release", "t_strip", "winding", "phase", "arm", "bound",
    } <= set(table.colnames)  # fmt: skip
    meta = {key.lower(): value for key, value in table.meta.items()}
    assert meta["seed"] == 7
    assert meta["run_file"] == "small.toml"
    assert meta["streamkit_version"] == sk.__version__
    assert meta["run_digest"] == sk.load(run_file).with_values({"progenitor.mass": 5e8}).digest()
    again = sk.load(json.loads(meta["run"]) if isinstance(meta["run"], str) else meta["run"])
    np.testing.assert_array_equal(sk.Model(again).stream().q[0], table["x"].to_value("kpc"))


@pytest.mark.rendered
def test_plot_writes_a_picture(run_file: Path) -> None:
    assert call("stream", run_file, "--plot", "s.png").exit_code == 0
    assert (run_file.parent / "s.png").read_bytes()[:4] == b"\x89PNG"


def test_track_writes_a_table_in_a_frame(run_file: Path) -> None:
    """Its means are those of the stream's own track."""
    given = "--track", "t.ecsv", "--frame", "SagittariusLaw10", "--set", "progenitor.mass=5e8"
    result = call("stream", run_file, *given)
    assert result.exit_code == 0, result.output
    table = QTable.read(run_file.parent / "t.ecsv")
    stream = sk.Model(sk.load(run_file).with_values({"progenitor.mass": 5e8})).stream()
    expected = stream.track("SagittariusLaw10")
    np.testing.assert_array_equal(table["phi1"].to_value("deg"), expected.phi1)
    np.testing.assert_allclose(table["distance"].to_value("kpc"), expected["distance"])


def test_plugins_lists_everything_and_describes_one() -> None:
    listing = call("plugins").stdout
    text = call("plugins", "--help").stdout
    for role in ("potential", "stripping", "integrator", "observable", "data", "sampler"):
        assert f"{role}\n" in listing
        assert role in text
    assert max(map(len, listing.splitlines())) <= 100
    one = call("plugins", "potential", "tf").stdout
    assert "Gibbons, Belokurov & Evans 2014, MNRAS 445, 3788" in one
    rows = [line.split() for line in one.splitlines()]
    assert ["v0", "km/s", "required", ">", "0"] in [row[:5] for row in rows]
    assert "Circular velocity at the centre." in one
    assert ["alpha", "-", "required", ">=", "0,", "<=", "1"] in [row[:7] for row in rows]


def test_a_plugin_that_failed_to_load_is_listed(monkeypatch: pytest.MonkeyPatch) -> None:

    whole = load_registry()
    broken = Registry(whole.entries, ("streamkit-odd 1.0, entry point 'odd' (ImportError: no odd)",))
    monkeypatch.setattr("streamkit.components.load_registry", lambda: broken)
    assert f"failed to load\n  {broken.failed[0]}" in call("plugins").stdout


def test_plugins_lists_the_packages_with_their_contract() -> None:
    listing = call("plugins").stdout
    assert f"packages, for contract {sk.CONTRACT}\n  streamkit {sk.__version__}" in listing
    assert f"contract {sk.CONTRACT}\n" in listing


def test_run_then_report_then_refuse_to_overwrite(fit_file: Path) -> None:
    done = call("run", fit_file)
    assert done.exit_code == 0, done.stderr
    directory = fit_file.parent / "fit"
    texts = ("4 steps of 6 walkers", "Not converged", "potential.v0", "200 kpc", "acceptance", "chain.h5")
    for text in texts:
        assert text in done.stdout, done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 100
    names = {path.name for path in directory.iterdir()}
    assert {"run.toml", "chain.h5", "summary.ecsv", "mass_profile.ecsv", "corner.png"} <= names
    tomllib.loads((directory / "run.toml").read_text())

    chain = (directory / "chain.h5").read_bytes()
    assert "--resume" in refused("run", fit_file)
    assert (directory / "chain.h5").read_bytes() == chain

    (directory / "corner.png").unlink()
    again = call("report", directory)
    assert again.exit_code == 0
    assert (directory / "corner.png").exists()

    other = fit_file.with_name("other.toml")
    other.write_text(fit_file.read_text().replace("seed = 3", "seed = 8"))
    assert "seed: 3 -> 8" in refused("run", other, "-o", directory, "--resume")
    assert (directory / "chain.h5").read_bytes() == chain

    (directory / "chain.h5").write_bytes(chain[: len(chain) // 3])
    assert "chain.h5" in refused("report", directory)
