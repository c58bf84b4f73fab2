"""The products of a run: what stands in the tables, and that every picture can be drawn from any run."""

import copy
import shutil

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable
from matplotlib.image import imread
from runfiles import FIT

import streamkit as sk
from streamkit.components import DO_NOT
from streamkit.fit import describe_results, products, write_products
from streamkit.fit.directory.claim import LITERATURE
from streamkit.fit.products import products_of
from streamkit.fit.samples.results import Results, draws_of, load_results
from streamkit.fit.show.export import paper_table
from streamkit.fit.show.figures import mass_profile, remark, rotation_curve
from streamkit.model import Model
from streamkit.report import draw_stream, save_picture
from streamkit.sample import Chain

TABLES = ("summary.ecsv", "mass_profile.ecsv", "diagnostics.ecsv", "predictions.ecsv", "goodness.ecsv")
PICTURES = (
    "corner.png", "mass_profile.png", "rotation_curve.png", "best_stream.png", "traces.png", "predictions.png",
    "priors.png",
)  # fmt: skip


@pytest.fixture(scope="module")
def run(finished_run):
    """Return the results of a small run with all its products."""
    return sk.load_results(finished_run)


def copy_of(run, out):
    """Return a copy of the run's directory without its products."""
    out.mkdir()
    for name in ("run.toml", "manifest.json", "chain.h5"):
        shutil.copy(run.directory / name, out / name)
    return out


def synthetic(chain, **changes):
    """Return results that hold this chain (steps, walkers, 2) of the two parameters of the small fit with changes."""
    document = copy.deepcopy(FIT) | {"sampler": {"walkers": chain.shape[1], "moves": "de"}} | changes
    spec = sk.load(document)
    stored = Chain(chain, np.zeros(chain.shape[:2]), None, np.ones(chain.shape[1]), {"status": "steps"})
    return Results(spec, draws_of(stored, spec, quick=False))


def read(run, name):
    return QTable.read(run.directory / name, format="ascii.ecsv")


def test_every_product_is_written(run):
    names = {path.name for path in run.directory.iterdir()} - {LITERATURE}
    assert names == {*TABLES, *PICTURES, "report.html", "run.toml", "manifest.json", "chain.h5"}
    assert names <= set(products_of(run.spec))
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
    for radii, found in (([50, -50], "found -50 kpc"), ([np.nan], "found nan kpc"), ([], r"shape \(0,\)")):
        with pytest.raises(ValueError, match=f"radii: {'found an array of ' * (radii == [])}{found}"):
            run.mass_profile(radii)


def test_the_diagnostics_count_every_call(run):
    table = read(run, "diagnostics.ecsv")
    assert table["count"][0] == 30 * 6 == run.calls
    assert sum(table["count"][1:-1]) == sum(run.reasons.values()) > 0
    assert (table["what"][-1], table["count"][-1]) == ("stuck walkers", len(run.stuck))
    assert any("outside the prior" in what for what in table["what"])


def test_a_report_can_be_written_again_from_the_chain_alone(run, tmp_path):
    out = copy_of(run, tmp_path / "copy")
    write_products(out)
    for name in TABLES:
        assert (out / name).read_bytes() == (run.directory / name).read_bytes()
    assert {path.name for path in out.iterdir()} == {path.name for path in run.directory.iterdir()} - {LITERATURE}


def test_walkers_that_disagree_have_not_converged_and_every_product_says_so():
    """4 of 8 walkers 30 sigma away: the autocorrelation time alone sees nothing."""
    sound = np.random.default_rng(0).standard_normal((1000, 8, 2)) * [1, 0.001] + [230, 0.35]
    apart = sound.copy()
    apart[:, 4:, 0] -= 30
    good, bad = synthetic(sound), synthetic(apart)
    assert good.converged
    assert remark(good) == ""
    assert good.note().startswith("1000 steps are")
    assert bad.draws.convergence.span > 500
    assert not bad.converged
    assert "R-hat is not below 1.02 for potential.v0" in bad.note()
    assert "potential.alpha" not in bad.note()
    assert remark(bad) == "not converged"
    table = bad.summary()
    assert table["r_hat"][0] > 1.5
    assert table["r_hat"][1] < 1.02
    assert table.meta["note"] == bad.note()
    assert bad.note() in " ".join(describe_results(bad).split())


def test_every_text_gives_the_verdict_of_all_checks():
    """A chain that has converged, on distances that no sample comes near: nothing says that it can be quoted."""
    chain = np.random.default_rng(0).standard_normal((1000, 8, 2)) * [1, 0.001] + [230, 0.35]
    distance = {"phi1": [-5, 5], "distance": [60, 61], "error": [1, 1]}
    far = synthetic(chain, observable=FIT["observable"] | {"distance": distance})
    assert not far.draws.lacks
    assert far.verdict == DO_NOT
    assert not far.converged
    for text in (far.note(), far._repr_html_(), describe_results(far), paper_table(far), far.to_arviz().attrs["note"]):
        said = " ".join(text.replace("%", "").split())
        assert "Do not quote numbers of this run. Failed checks: goodness of fit." in said
    assert "do not use" in repr(far)
    assert remark(far) == "do not use: goodness of fit"


def test_results_are_shown_in_a_few_lines(run):
    """On a terminal of 80 columns too, median and interval of every parameter stand there."""
    assert repr(run) == "<Results: 30 steps of 6 walkers, 2 parameters, do not use>"
    assert run.note() in run._repr_html_()
    assert "potential.alpha" in run._repr_html_()
    lines = run.summary().pformat(max_width=80, max_lines=-1)
    assert all(len(line) <= 80 for line in lines)
    for name, column in zip(run.names, run.samples.T, strict=True):
        (line,) = (line for line in lines if name in line)
        for percentile in (16, 50, 84):
            assert f"{np.percentile(column, percentile):.4g}" in line.split()
    profile = run.mass_profile([50.0])
    assert f"{profile['M'][0].value:.4g}" in " ".join(profile.pformat(max_width=80))


def test_the_mass_profile_is_computed_once(run, tmp_path, monkeypatch):
    asked, make = [], Results._make_profiles
    monkeypatch.setattr(products, "figures_of", lambda *_: {"mass.png": mass_profile, "rotation.png": rotation_curve})
    monkeypatch.setattr(Results, "_make_profiles", lambda self, radii: asked.append(len(radii)) or make(self, radii))
    truth = tmp_path / "truth.toml"
    truth.write_text('[potential]\nkind = "tf"\nv0 = 232\nrs = "12 kpc"\nalpha = 0.35\n')
    results = write_products(copy_of(run, tmp_path / "copy"), truth)
    describe_results(results)
    assert len(asked) == 2  # the radii of the table, and all others
    mass, _ = results.profiles(np.array([100.0, 50.0, 100.0]))
    assert (mass[:, 0] == mass[:, 2]).all()
    assert (mass[:, 0] > mass[:, 1]).all()


def test_a_picture_that_fails_costs_no_other(run, tmp_path, monkeypatch, caplog):
    def broken(_results, **_options):
        raise ZeroDivisionError("no ink")

    out = copy_of(run, tmp_path / "copy")
    (out / "corner.png").write_text("of another chain")
    monkeypatch.setattr(products, "corner", broken)
    results = write_products(out)
    names = {path.name for path in out.iterdir()} - {"run.toml", "manifest.json", "chain.h5"}
    assert names == {*PICTURES, "report.html", *TABLES} - {"corner.png"}
    assert results.failed == {"corner.png": "ZeroDivisionError: no ink"}
    assert [record.getMessage() for record in caplog.records] == [
        "Some products could not be made, all else was: corner.png (ZeroDivisionError: no ink)"
    ]
    assert read(results, "diagnostics.ecsv").meta["products that failed"] == results.failed


def test_a_run_of_one_step_has_a_report_too(tmp_path):
    run = sk.run(sk.load(FIT), out=tmp_path / "run", steps=1, progress=False)
    assert len(run.chain) == 1
    table = read(run, "summary.ecsv")
    assert np.isfinite(table["median"]).all()
    assert np.isnan(table["autocorrelation_time"]).all()
    assert np.isnan(table["r_hat"]).all()
    assert "too few" in table.meta["note"]


@pytest.mark.slow
def test_a_quick_look_says_so_everywhere(tmp_path):
    document = copy.deepcopy(FIT)
    document["stripping"] |= {"particles": 3000}
    document["sampler"]["start_particles"] = 500
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


@pytest.mark.slow
@pytest.mark.rendered
def test_a_stream_without_an_observable_can_be_drawn(tmp_path):
    stream = Model(sk.load(FIT)).stream()
    save_picture(tmp_path / "stream.png", draw_stream(stream))
    assert imread(tmp_path / "stream.png").shape[0] > 600


@pytest.mark.parametrize("missing", ["run.toml", "manifest.json", "chain.h5"])
def test_an_incomplete_directory_is_refused(run, tmp_path, missing):
    out = tmp_path / "copy"
    shutil.copytree(run.directory, out)
    (out / missing).unlink()
    with pytest.raises(sk.StreamkitError, match=missing.replace(".", r"\.")):
        load_results(out)


def test_there_is_no_run_in_no_directory(tmp_path):
    with pytest.raises(sk.ChainError, match="no such directory"):
        load_results(tmp_path / "nowhere")
