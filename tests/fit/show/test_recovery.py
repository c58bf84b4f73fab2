"""A fit beside the truth: deviations of a synthetic chain in closed form, the files, and which truths are refused."""

from __future__ import annotations

import copy
import shutil
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable
from commands import call, refused
from matplotlib.image import imread
from runfiles import FIT, PLUGIN

import streamkit as sk
from streamkit.fit import RECOVERY
from streamkit.fit.directory.claim import LITERATURE
from streamkit.fit.products import products_of
from streamkit.fit.samples.results import Results, draws_of, load_results
from streamkit.fit.show.recovery import RADII, largest, recovery_figure, recovery_table, true_host
from streamkit.model import Host
from streamkit.runfile import to_toml
from streamkit.sample import Chain

TRUE = '[potential]\nkind = "tf"\nv0 = 232\nrs = "12 kpc"\nalpha = 0.35\n'


def chain_of(v0: np.ndarray) -> Results:
    """The results of a run of tf hosts with these v0, in every step; rs = 12 kpc, alpha = 0.4."""
    document = copy.deepcopy(FIT)
    document["potential"]["alpha"] = 0.4
    document["sampler"]["walkers"] = len(v0)
    rng = np.random.default_rng(0)
    steps = np.array([rng.permutation(v0) for _ in range(30)])[..., None]
    spec, blobs = sk.load(document), np.zeros(steps.shape[:2])
    stored = Chain(steps, -steps[..., 0], blobs, np.ones(len(v0)), {"status": "steps"})
    return Results(spec, draws_of(stored, spec, quick=False))


def tf(v0: float) -> Host:
    halo = sk.load(FIT).registry.find("potential", "tf", "potential.kind")
    return Host({"potential": halo(v0=v0, rs=12.0, alpha=0.4)})


@pytest.mark.parametrize("true", [205.0, 210.0, 213.0, 240.0])
def test_deviations_of_a_synthetic_chain(true: float) -> None:
    """v0 evenly from 200 to 220 km/s: median 210, 68 % within 6.8. v_c is proportional to v0, M to its square."""
    table, sigma = recovery_table(chain_of(np.linspace(200, 220, 101)), tf(true)), 6.8
    assert table["r"].to_value(u.kpc).tolist() == list(range(10, 121, 5))
    low, high = 210 - sigma, 210 + sigma
    edge = high if true > 210 else low
    assert table["v_c_deviation"] == pytest.approx((210 - true) / sigma, abs=1e-6)
    assert table["M_deviation"] == pytest.approx((210**2 - true**2) / abs(edge**2 - 210**2), abs=1e-6)
    assert table["M_relative"] == pytest.approx((210 / true) ** 2 - 1)
    assert table["v_c_relative"] == pytest.approx(210 / true - 1)
    assert table["M_error"] == pytest.approx(0.5 * (high**2 - low**2) / true**2)
    r = np.arange(10.0, 121.0, 5.0)
    speed = true * (144 / (144 + r**2)) ** 0.1  # eq. 2 of the paper
    assert table["v_c_true"].to_value(u.km / u.s) == pytest.approx(speed)
    assert table["M_true"].to_value(u.Msun) == pytest.approx(r * speed**2 / sk.G)
    inside = (table["M_lo68"] <= table["M_true"]) & (table["M_true"] <= table["M_hi68"])
    assert np.array_equal(inside, np.abs(table["M_deviation"]) <= 1)


def test_the_largest_deviation_has_its_sign_and_radius() -> None:
    table = QTable({"r": [10, 20, 30] * u.kpc, "M_deviation": [0.5, -2.0, 1.0]})
    assert largest(table, "M") == (-2.0, 20.0)


def test_a_chain_that_never_moved_deviates_without_limit() -> None:
    table = recovery_table(chain_of(np.full(8, 210.0)), tf(200.0))
    assert (table["v_c_deviation"] == np.inf).all()


def test_the_true_host_is_the_sum_of_its_parts(tmp_path: Path) -> None:
    """Hernquist: M r^2 / (r + a)^2. NFW: 4 pi rho rs^3 (ln(1 + x) - x / (1 + x)), here by its scale mass."""
    path = tmp_path / "true.toml"
    path.write_text(
        '[potential.bulge]\nkind = "hernquist"\nmass = "3e10 Msun"\na = "500 pc"\n'
        '[potential.halo]\nkind = "nfw"\nmass = 5e11\nrs = 20\n'
    )
    host = true_host(path, sk.load(FIT))
    assert list(host.potentials) == ["bulge", "halo"]
    x = RADII / 20
    mass = 3e10 * RADII**2 / (RADII + 0.5) ** 2 + 5e11 * (np.log1p(x) - x / (1 + x))
    table = recovery_table(chain_of(np.linspace(200, 220, 8)), host)
    assert table["M_true"].to_value(u.Msun) == pytest.approx(mass, rel=1e-6)
    assert table.meta["truth"]["halo"] == {"kind": "nfw", "mass": 5e11, "rs": 20.0}


@pytest.fixture
def run(finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run, alone in the working directory."""
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(finished_run, tmp_path / "run", ignore=shutil.ignore_patterns(LITERATURE)))


@pytest.mark.rendered("recovery")
def test_the_report_writes_and_prints_the_recovery(run: Path) -> None:
    Path("true.toml").write_text(TRUE)
    result = call("report", run, "--truth", "true.toml")
    assert result.exit_code == 0, result.output
    assert {path.name for path in run.iterdir()} == {*products_of(sk.load(FIT)), *RECOVERY}
    table = QTable.read(run / "recovery.ecsv")
    assert table.meta["truth"]["potential"]["v0"] == 232
    v0, alpha = load_results(run).samples.T
    v_c = np.median(v0 * (144 / (144 + 100.0**2)) ** (alpha / 4))
    row = table[table["r"] == 100 * u.kpc]
    assert row["v_c"][0].to_value(u.km / u.s) == pytest.approx(v_c, rel=1e-6)
    deviation, radius = largest(table, "M")
    assert f"largest deviation of M: {deviation:+.2f} sigma at {radius:g} kpc" in result.stdout
    assert f"{row['M_true'][0].value / 1e11:.2f}" in result.stdout
    lines = [line.replace(str(run), "run") for line in result.stdout.splitlines()]  # a path cannot be wrapped
    assert all(len(line) <= 100 for line in lines)
    assert imread(run / "recovery.png")[..., :3].std() > 0.02


def test_a_whole_run_file_is_a_truth_and_a_plugin_is_found_beside_it(run: Path) -> None:
    there = Path("elsewhere")
    there.mkdir()
    (there / "cored.py").write_text(PLUGIN)
    host = {"kind": "cored", "v": 200.0, "core": 2.0}
    document = {"plugins": ["cored.py"]} | FIT | {"potential": host, "progenitor": {"kind": "not looked at"}}
    (there / "true.toml").write_text(to_toml(document))
    assert call("report", run, "--truth", there / "true.toml").exit_code == 0
    table = QTable.read(run / "recovery.ecsv")
    r = table["r"].value
    assert table["M_true"].value == pytest.approx(200.0**2 * r**3 / (r**2 + 4) / sk.G, rel=1e-6)


def test_the_recovery_of_another_run_goes_before_the_first_step(run: Path) -> None:
    for name in RECOVERY:
        (run / name).touch()
    sk.run(sk.load(FIT), out=run, steps=1, force=True, progress=False, products=False)
    assert not set(RECOVERY) & {path.name for path in run.iterdir()}


@pytest.mark.slow
def test_a_run_that_replaces_another_takes_its_recovery_away(run: Path) -> None:
    Path("true.toml").write_text(TRUE)
    call("report", run, "--truth", "true.toml")
    sk.run(sk.load(FIT), out=run, steps=2, force=True, progress=False)
    assert {path.name for path in run.iterdir()} == set(products_of(sk.load(FIT)))


def test_the_picture_draws_both_over_the_truth() -> None:
    figure = recovery_figure(chain_of(np.linspace(200, 220, 101)), tf(205.0))
    mass, speed, mass_difference, speed_difference = figure.axes
    true = next(line for line in mass.lines if line.get_label() == "true")
    r, m = true.get_data()
    assert m == pytest.approx(r * 205**2 * (144 / (144 + r**2)) ** 0.2 / sk.G / 1e11)
    assert len(mass.collections) == len(speed_difference.collections) == 2  # the 68 % and the 95 % band
    assert mass_difference.lines[0].get_ydata() == pytest.approx(100 * ((210 / 205) ** 2 - 1))
    assert speed_difference.lines[0].get_ydata() == pytest.approx(100 * (210 / 205 - 1))
    assert speed.get_ylim()[0] > 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "true.toml: cannot read the run file: No such file"),
        ("a = ", "true.toml: not valid TOML"),
        ("", "true.toml: the section [potential] is missing, which holds the true host; it is empty"),
        ('[halo]\nkind = "tf"', "the section [potential] is missing, which holds the true host; found halo"),
        (TRUE.replace("v0 = 232", "v0 = { uniform = [200, 240] }"),
         "true.toml: the true host needs numbers, found a prior at potential.v0"),
        (TRUE.replace('"tf"', '"tff"'), "Did you mean 'tf'?"),
        (TRUE.replace("alpha", "alhpa"), "true.toml: potential.alhpa: the potential 'tf' has no field 'alhpa'."),
        (TRUE.replace("12 kpc", "12 km/s"), "true.toml: potential.rs"),
        ("plugins = 3\n" + TRUE, "true.toml: plugins: found 3, expected a list"),
        ('plugins = ["gone.py"]\n' + TRUE, "gone.py"),
    ],
)  # fmt: skip
def test_a_truth_that_cannot_be_used_is_refused_and_nothing_is_written(
    run: Path, text: str | None, message: str
) -> None:
    if text is not None:
        Path("true.toml").write_text(text)
    before = {path.name: path.stat().st_mtime_ns for path in run.iterdir()}
    assert message in " ".join(refused("report", run, "--truth", "true.toml").split())
    assert {path.name: path.stat().st_mtime_ns for path in run.iterdir()} == before
