"""The products of a run: what stands in the tables, and that every picture can be drawn from any run."""

import copy
import shutil

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable
from matplotlib.figure import Figure
from matplotlib.image import imread
from toys import FIT

import streamkit as sk
from streamkit.model import Model
from streamkit.report import save_stream
from streamkit.study.fit import write_products
from streamkit.study.fit.figures import mass_profile, remark, rotation_curve
from streamkit.study.fit.products import PRODUCTS
from streamkit.study.fit.results import Results

TABLES = ("summary.ecsv", "mass_profile.ecsv", "diagnostics.ecsv")
PICTURES = ("corner.png", "mass_profile.png", "rotation_curve.png", "best_stream.png", "traces.png")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Return the results of a small run with all its products."""
    return sk.run(sk.load(FIT), out=tmp_path_factory.mktemp("runs") / "run", steps=30, progress=False)


def read(run, name):
    return QTable.read(run.directory / name, format="ascii.ecsv")


def test_every_product_is_written(run):
    names = {path.name for path in run.directory.iterdir()}
    assert names == {*TABLES, *PICTURES, "run.toml", "manifest.json", "chain.h5"}
    assert names <= set(PRODUCTS)
    for name in PICTURES:
        pixels = imread(run.directory / name)
        assert min(pixels.shape[:2]) > 400
        assert pixels[..., :3].std() > 0.02  # not a blank page


def test_the_summary_holds_the_percentiles_of_the_samples(run):
    table = read(run, "summary.ecsv")
    assert list(table["parameter"]) == list(run.names) == ["potential.v0", "potential.alpha"]
    assert list(table["unit"]) == ["km/s", "1"]
    sigma = {"lo95": 2.5, "lo68": 16, "median": 50, "hi68": 84, "hi95": 97.5}
    for column, percentile in sigma.items():
        np.testing.assert_allclose(table[column], np.percentile(run.samples, percentile, axis=0), rtol=1e-5)
    for column in ("best", "autocorrelation_time", "effective_samples", "r_hat"):
        assert column in table.colnames
    assert table.meta["steps"] == 30
    assert "Not converged" in table.meta["note"]


def test_the_mass_profile_is_that_of_the_samples(run):
    table = read(run, "mass_profile.ecsv")
    r = table["r"].to_value(u.kpc)
    assert (r[0], r[-1]) == (5, 200)
    assert {50.0, 100.0, 150.0, 200.0} <= set(r)
    v0, alpha = run.samples.T
    v_c = v0 * (144 / (144 + 100.0**2)) ** (alpha / 4)  # eq. 2 of the paper, rs = 12 kpc
    row = table[r == 100.0]
    for name, q in (("v_c", 50), ("v_c_lo68", 16), ("v_c_hi68", 84), ("v_c_lo95", 2.5), ("v_c_hi95", 97.5)):
        assert row[name][0].to_value(u.km / u.s) == pytest.approx(np.percentile(v_c, q), rel=1e-5)
    mass = np.percentile(100 * v_c**2 / sk.G, 84)
    assert row["M_hi68"][0].to_value(u.Msun) == pytest.approx(mass, rel=1e-5)


def test_mass_profiles_take_quantities(run):
    one, two = run.mass_profile(100 * u.kpc), run.mass_profile([0.1] * u.Mpc)
    assert one["M"][0].unit == u.Msun
    assert one["M"][0] == two["M"][0]


def test_the_diagnostics_count_every_call(run):
    table = read(run, "diagnostics.ecsv")
    assert table["count"][0] == 30 * 6 == run.calls
    assert sum(table["count"][1:-1]) == sum(run.reasons.values()) > 0
    assert (table["what"][-1], table["count"][-1]) == ("stuck walkers", len(run.stuck))
    assert any("outside the prior" in what for what in table["what"])


def test_a_report_can_be_written_again_from_the_chain_alone(run, tmp_path):
    out = tmp_path / "copy"
    out.mkdir()
    for name in ("run.toml", "manifest.json", "chain.h5"):
        shutil.copy(run.directory / name, out / name)
    write_products(out)
    for name in TABLES:
        assert (out / name).read_bytes() == (run.directory / name).read_bytes()
    assert {path.name for path in out.iterdir()} == {path.name for path in run.directory.iterdir()}


def test_a_run_of_one_step_has_a_report_too(tmp_path):
    run = sk.run(sk.load(FIT), out=tmp_path / "run", steps=1, progress=False)
    table = read(run, "summary.ecsv")
    assert np.isfinite(table["median"]).all()
    assert np.isnan(table["autocorrelation_time"]).all()
    assert np.isnan(table["r_hat"]).all()
    assert "too few" in table.meta["note"]


def test_a_quick_look_says_so_everywhere(tmp_path):
    document = copy.deepcopy(FIT)
    document["stripping"]["particles"] = 3000
    run = sk.run(sk.load(document), out=tmp_path / "run", steps=2, quick=True, progress=False)
    assert run.quick
    assert run.spec.document["stripping"]["particles"] == 2000
    for name in TABLES:
        assert "QUICK LOOK" in read(run, name).meta["note"]
    assert "QUICK LOOK" in (run.directory / "run.toml").read_text()
    assert "QUICK LOOK" in remark(run)
    assert not run.converged
    with pytest.raises(sk.ChainError, match=r"stripping\.particles"):
        sk.run(sk.load(document), out=tmp_path / "run", resume=True, progress=False)


def test_pictures_can_be_drawn_into_given_axes(run):
    axes = Figure().subplots(1, 2)
    mass_profile(run, axes=axes[0])
    rotation_curve(run, axes=axes[1])
    for panel in axes:
        assert len(panel.collections) == 2  # the 68 % and the 95 % band
        assert "kpc" in panel.get_xlabel()


def test_a_stream_without_an_observable_can_be_drawn(tmp_path):
    stream = Model(sk.load(FIT)).stream()
    save_stream(stream, None, None, tmp_path / "stream.png")
    assert imread(tmp_path / "stream.png").shape[0] > 600


@pytest.mark.parametrize("missing", ["run.toml", "manifest.json", "chain.h5"])
def test_an_incomplete_directory_is_refused(run, tmp_path, missing):
    out = tmp_path / "copy"
    shutil.copytree(run.directory, out)
    (out / missing).unlink()
    with pytest.raises(sk.StreamkitError, match=missing.replace(".", r"\.")):
        Results(out)


def test_there_is_no_run_in_no_directory(tmp_path):
    with pytest.raises(sk.ChainError, match="no such directory"):
        Results(tmp_path / "nowhere")
