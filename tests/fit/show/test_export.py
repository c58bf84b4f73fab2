"""Samples for other programs: each is read back by the program itself, and holds the same numbers."""
import errno
import os
from pathlib import Path

import numpy as np
import pytest
import xarray
from astropy import units as u
from astropy.table import QTable
from commands import call, refused
from getdist import loadMCSamples

import streamkit as sk
from streamkit.fit import write_samples


@pytest.fixture(scope="module")
def run(finished_run):
    return sk.load_results(finished_run)


def test_samples_by_name(run):
    np.testing.assert_array_equal(run["potential.alpha"], run.samples[:, 1])
    with pytest.raises(KeyError, match=r"Did you mean 'potential\.alpha'"):
        run["potential.alfa"]


def test_a_data_frame_has_a_row_per_sample(run):
    frame = run.to_pandas()
    assert list(frame.columns) == ["walker", "step", *run.names, "ln_posterior"]
    np.testing.assert_array_equal(frame[list(run.names)], run.samples)
    assert frame["step"].min() == run.discard + 1
    assert frame["step"].max() == 30
    row = frame[(frame["walker"] == 4) & (frame["step"] == 30)].iloc[0]
    np.testing.assert_array_equal(row[list(run.names)], run.chain[29, 4])
    assert row["ln_posterior"] == run.log_prob[29, 4]


def test_netcdf_holds_walkers_as_chains_with_predictions_and_data(run, tmp_path):
    assert write_samples(run, tmp_path / "samples.nc") == [tmp_path / "samples.nc"]
    with xarray.open_datatree(tmp_path / "samples.nc", engine="h5netcdf") as tree:
        v0 = tree["posterior"]["potential.v0"]
        assert v0.dims == ("chain", "draw")
        assert v0.attrs["units"] == "km/s"
        np.testing.assert_array_equal(v0, run.kept[..., 0].T)
        np.testing.assert_array_equal(tree["sample_stats"]["lp"], run.log_prob[run.discard :].T)
        mean = tree["predictions"]["mean"]
        assert mean.dims == ("chain", "draw", "datum")
        np.testing.assert_array_equal(mean[3, 2], run.blobs["mean"][run.discard + 2, 3])
        np.testing.assert_array_equal(tree["constant_data"]["value"], [57, 112, 100])
        np.testing.assert_array_equal(tree["constant_data"]["error"], [5, 15, 8])
        assert tree.attrs["digest"] == run.spec.digest()


def test_a_full_disk_is_one_sentence(run, tmp_path, monkeypatch):
    """HDF5 itself is never there: it would end the process."""

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(sk.StreamkitError, match=r"cannot be written \(No space left on device\)$"):
        write_samples(run, tmp_path / "samples.nc")
    assert list(tmp_path.iterdir()) == []


def test_arviz_has_new_data_and_likelihoods_of_each_datum(run):
    """New data scatter about the predictions by the errors, and the ln likelihoods add up to that of the sample."""
    tree = run.to_arviz()
    errors = {"leading": 5.0, "trailing": 15.0, "precession": 8.0}
    assert list(tree["observed_data"].data_vars) == list(errors)
    for name, value in zip(errors, (57, 112, 100), strict=True):
        np.testing.assert_array_equal(tree["observed_data"][name], [value])
        assert tree["observed_data"][f"{name} datum"].values.tolist() == [name]
    draws = tree["posterior_predictive"].sizes["draw"]
    blobs = run.blobs[run.discard :].ravel()
    assert draws == min(len(blobs), 500)
    for row, (name, error) in enumerate(errors.items()):
        scores = (tree["posterior_predictive"][name].values[0, :, 0] - blobs["mean"][:, row]) / error
        assert scores.mean() == pytest.approx(0, abs=5 / np.sqrt(draws))
        assert scores.std() == pytest.approx(1, abs=4 / np.sqrt(draws))
    ln_each = tree["log_likelihood"]["data"]
    assert ln_each["data datum"].values.tolist() == list(errors)
    np.testing.assert_allclose(ln_each.sum("data datum").values[0], blobs["ln_likelihood"])


def test_leave_one_out_is_that_of_arviz(run):
    """Its estimate is never above the ln likelihood of the data that were fitted."""
    pytest.importorskip("xarray_einstats")  # arviz_stats needs it for trees
    from arviz_stats import loo

    tree = run.to_arviz()
    estimate = loo(tree, reff=1.0)
    assert np.isfinite(estimate.elpd)
    ln_each = tree["log_likelihood"]["data"].values[0]
    assert estimate.elpd <= np.log(np.exp(ln_each).mean(axis=0)).sum()


def test_getdist_reads_samples_labels_and_ranges(run, tmp_path):
    files = write_samples(run, tmp_path / "chain.txt")
    assert [file.suffix for file in files] == [".txt", ".paramnames", ".ranges"]
    read = loadMCSamples(str(tmp_path / "chain"), settings={"ignore_rows": 0})
    assert read.getParamNames().list() == list(run.names)
    np.testing.assert_allclose(read.samples, run.samples, rtol=1e-9)
    np.testing.assert_allclose(read.loglikes, -run.log_prob[run.discard :].ravel(), rtol=1e-9)
    np.testing.assert_allclose(read.getMeans(), run.samples.mean(axis=0), rtol=1e-9)
    assert read.ranges.getLower("potential.v0") == 215
    assert read.ranges.getUpper("potential.alpha") == 0.45
    assert read.getParamNames().labels() == ["v_0", r"\alpha"]


def test_a_table_has_units(run, tmp_path):
    write_samples(run, tmp_path / "samples.ecsv")
    table = QTable.read(tmp_path / "samples.ecsv")
    np.testing.assert_allclose(table["potential.v0"].to_value(u.km / u.s), run["potential.v0"])


def test_the_command_writes_and_refuses(run, tmp_path):
    done = call("export", run.directory, "-o", tmp_path / "samples.csv")
    assert str(tmp_path / "samples.csv") in done.output
    assert len((tmp_path / "samples.csv").read_text().splitlines()) == 1 + len(run.samples)
    assert "--force" in refused("export", run.directory, "-o", tmp_path / "samples.csv")
    assert call("export", run.directory, "-f", "-o", tmp_path / "samples.csv").exit_code == 0
    assert "must be one of .nc" in refused("export", run.directory, "-o", tmp_path / "samples.hdf5")
    (tmp_path / "chain.ranges").touch()
    assert "chain.ranges" in refused("export", run.directory, "-o", tmp_path / "chain.txt")
