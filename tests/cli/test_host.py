"""The command `host`: the numbers of closed forms, a posterior's intervals, bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.table import QTable
from commands import call, refused
from pictures import assert_readable
from runfiles import RUN

import streamkit as sk
from streamkit.fit import draw_host, prior_profiles
from streamkit.model import moving_objects


@pytest.fixture
def run_file(tmp_path: Path) -> Path:
    path = tmp_path / "run.toml"
    path.write_text(RUN)
    return path


def test_the_profile_of_a_truncated_flat_host(run_file: Path) -> None:
    """`M = r v_c^2 / G`, and the tables that are written are those that are printed."""
    given = "--set", "potential.v0=210", "--radii", "10,50"
    table, orbits = run_file.with_name("host.ecsv"), run_file.with_name("orbits.ecsv")
    result = call("host", run_file, *given, "--json", "-o", table, "--orbits", orbits)
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    r = np.array([10.0, 50.0])
    v_c = 210 * 12**0.225 / (12**2 + r**2) ** 0.1125
    rows = record["profile"]["rows"]
    assert [row["v_c"] for row in rows] == pytest.approx(v_c.tolist())
    assert [row["M"] for row in rows] == pytest.approx((r * v_c**2 / sk.G).tolist())
    np.testing.assert_allclose(QTable.read(table)["v_c"].to_value("km/s"), v_c)
    (today,) = record["objects"]["rows"]
    assert today["r"] == pytest.approx(np.sqrt(19.155535**2 + 0.0278852**2 + 5.7149425**2))
    assert QTable.read(orbits)["t"].min().to_value("Gyr") == pytest.approx(-3.77)


def test_the_text_defines_every_column(run_file: Path) -> None:
    text = " ".join(call("host", run_file).stdout.split())
    for words in ("Gauss's law", "gala's mass_enclosed", "escape speed to infinity", "last pericentre"):
        assert words in text


def test_draws_of_the_priors_have_the_percentiles_of_their_closed_form(run_file: Path) -> None:
    """v_c is v0 times a function of the radius, and v0 is uniform from 190 to 230 km/s."""
    picture = run_file.with_name("prior.png")
    result = call("host", run_file, "--radii", "10,50", "--draws", "800", "--json")
    assert result.exit_code == 0, result.output
    for row in json.loads(result.stdout)["profile"]["rows"]:
        factor = 12**0.225 / (12**2 + row["r"] ** 2) ** 0.1125
        assert [row["v_c_lo68"], row["v_c"], row["v_c_hi68"]] == pytest.approx(
            factor * (190 + 40 * np.array([0.16, 0.5, 0.84])), abs=1.5 * factor
        )
    assert call("host", run_file, "--draws", "20", "--plot", picture).exit_code == 0
    assert picture.is_file()
    spec, r = sk.load(run_file), np.array([10.0, 50.0])
    drawn = prior_profiles(spec, r, 20)
    lines = draw_host(sk.host_table(spec, r, 20), {}, drawn=drawn).axes[0].lines
    assert sum(np.array_equal(line.get_ydata(), one) for line in lines for one in drawn["M"]) == 12


def test_draws_need_priors(run_file: Path, finished_run: Path) -> None:
    assert "--draws shows the priors of a run file" in refused("host", finished_run, "--draws", "5")
    settings = "--set", "potential.v0=210", "--set", "progenitor.mass=5e8"
    assert "the run file has no free parameter" in refused("host", run_file, *settings, "--draws", "5")


@pytest.mark.rendered
def test_a_posterior_has_intervals(finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mass is that of the run's own profile."""
    result = call("host", finished_run, "--radii", "20", "--json", "--plot", tmp_path / "host.png")
    assert result.exit_code == 0, result.output
    (row,) = json.loads(result.stdout)["profile"]["rows"]
    results = sk.load_results(finished_run)
    expected = results.mass_profile([20])
    assert (row["M_lo68"], row["M"], row["M_hi68"]) == pytest.approx(
        tuple(expected[name].to_value("Msun")[0] for name in ("M_lo68", "M", "M_hi68"))
    )
    figure = draw_host(
        sk.host_table(results, [5, 10, 30]), moving_objects(results.spec, results.best()), "not converged"
    )
    assert_readable(figure, monkeypatch, ("95 %", "68 %", "median", "stream"))


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["--radii", "10,zero"], "expected numbers above 0 and up to 1e+06 kpc"),
        (["--radii", "1e300"], "expected numbers above 0 and up to 1e+06 kpc"),
        (["--radii", "-1"], "expected numbers above 0 and up to 1e+06 kpc"),
        (["-o", "host.csv"], "'host.csv'"),
        (["--set", "potential.v=1"], "Did you mean 'potential.v0'?"),
        ([f"--set=progenitor.{name}=0" for name in ("y", "z", "vy", "vz")], "there is no orbit"),
    ],
)
def test_bad_options(run_file: Path, options: list[str], wanted: str) -> None:
    assert wanted in " ".join(refused("host", run_file, *options).split())
