"""Another method on the test bench: ranks against closed forms, mock data and samples as files, bad samples."""

import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy.table import QTable
from click.testing import CliRunner
from itself import ERROR, MEAN, SD, WIDTH, exact_rank, itself

import streamkit as sk
from streamkit.cli.main import main
from streamkit.study.calibration import calibrate, calibrate_samples, calibration_products, read_truths, write_mocks
from streamkit.study.calibration.draw import make_draw
from streamkit.study.calibration.method import as_samples, read_samples
from streamkit.study.calibration.mocks import draw_mock

NAME = "potential.v0"
SAMPLES = 200


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    return itself(tmp_path_factory.mktemp("plugin"))


def posterior(mock, width=WIDTH, shift=0.0):
    """Return samples of the closed form, times a factor of its width and moved by a number of widths."""
    rng = np.random.default_rng(mock.index)
    return rng.normal(0.5 * (mock.values[0] + MEAN) + shift * WIDTH, width, (SAMPLES, 1))


def narrow(mock):
    return posterior(mock, width=0.5 * WIDTH)


def test_the_rank_of_an_exact_posterior_is_exact(spec):
    theta, mock = draw_mock(spec, spec, 3)
    assert mock.names == ("speed",)
    assert mock.errors == pytest.approx([ERROR])
    draw = make_draw(spec, 3, method=posterior)
    assert draw.truth == tuple(theta)
    assert draw.ranks[0] == pytest.approx(exact_rank(theta[0], mock.values[0]), abs=0.1)  # 3 sd of 200 samples
    assert draw.host_ranks[1] == pytest.approx(draw.ranks[0], abs=0.03)  # the mass rises with v0
    assert draw.calls == 0


def test_the_mock_data_are_those_of_our_own_fit(spec, monkeypatch):
    """Both methods are judged by the same data."""
    import streamkit.study.calibration.draw as module

    seen = []
    monkeypatch.setattr(module, "run", lambda spec, **_: seen.append(spec))
    monkeypatch.setattr(module, "rank_truth", lambda *_: None)
    make_draw(spec, 5)
    assert seen[0].bind().observable.speed[0] == draw_mock(spec, spec, 5)[1].values[0]


@pytest.mark.slow
def test_coverage_tells_a_right_method_from_a_narrow_one(spec, tmp_path):
    """Half the width: the 68 % interval is one of 38 % of the exact posterior."""
    right = calibrate(spec, tmp_path / "right", 60, method=posterior)
    wrong = calibrate(spec, tmp_path / "wrong", 60, method=narrow)
    assert right.coverage(0.68)[0] == pytest.approx(0.68, abs=0.15)  # 2.5 sd of 60 draws
    assert wrong.coverage(0.68)[0] == pytest.approx(0.38, abs=0.15)
    assert right.ranks[:, 0].mean() == pytest.approx(0.5, abs=0.1)
    assert [draw.truth for draw in right.draws] == [draw.truth for draw in wrong.draws]


def test_the_products_name_the_method(spec, tmp_path):
    products = calibration_products(calibrate(spec, tmp_path, 2, method=narrow))
    assert "The samples are of another method: narrow." in " ".join(products.text.split())
    assert products.header["method"] == "narrow"
    assert "converged" not in products.tables["calibration.ecsv"].colnames


def test_a_resumed_calibration_keeps_to_its_method(spec, tmp_path):
    first = calibrate(spec, tmp_path, 2, method=posterior)
    again = calibrate(spec, tmp_path, 3, resume=True, method=posterior)
    assert again.ranks[:2].tolist() == first.ranks.tolist()
    with pytest.raises(sk.StreamkitError, match="or to another method"):
        calibrate(spec, tmp_path, 3, resume=True, method=narrow)


def test_a_method_that_fails_is_named(spec, tmp_path):
    def broken(mock):
        raise ValueError("no network")

    with pytest.raises(sk.ComponentError, match=r"the method .*broken failed: ValueError .*no network"):
        calibrate(spec, tmp_path, 1, method=broken)
    with pytest.raises(sk.StreamkitError, match=r"broken cannot be sent to other processes .*one worker"):
        calibrate(spec, tmp_path, 1, workers=2, method=broken)


GOOD = np.linspace(150, 250, 50)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"potential.vo": GOOD}, "no samples of potential.v0. Did you mean 'potential.vo'"),
        ({}, "Found: nothing. Wanted: potential.v0"),
        ({NAME: np.append(GOOD, np.nan)}, "1 of 51 samples of potential.v0 are not finite"),
        ({NAME: GOOD[:5]}, "5 samples are too few"),
        ({NAME: ["a"] * 30}, "no array of numbers"),
        (GOOD, r"shape \(50,\), expected \(n, 1\)"),
        (np.ones((50, 2)), r"shape \(50, 2\), expected \(n, 1\): .* with potential.v0"),
        (None, "shape"),
    ],
)
def test_samples_that_cannot_be_ranked_are_refused(spec, given, text):
    with pytest.raises(sk.StreamkitError, match=f"^here: .*{text}"):
        as_samples(given, spec, "here")


def test_samples_outside_the_prior_are_refused_but_for_rounding(spec):
    bounded = spec.with_values({NAME: {"uniform": [100, 300]}})
    with pytest.raises(sk.StreamkitError, match=r"10 of 50 .*outside its prior, 100 to 300 km/s .*check the unit"):
        as_samples(np.append(GOOD[:40], np.full(10, 301.0))[:, None], bounded, "here")
    rounded = as_samples(np.append(GOOD, 300.00001)[:, None], bounded, "here")
    assert rounded.max() == 300.0


def test_mocks_and_samples_travel_as_files(spec, tmp_path):
    """A method that reads nothing but the files gets the ranks of the callable."""
    mocks = tmp_path / "mocks"
    assert not write_mocks(spec, mocks, 3)
    truths = read_truths(mocks, spec)
    drawn = [draw_mock(spec, spec, index) for index in range(3)]
    samples = {}
    for index, (theta, mock) in enumerate(drawn):
        assert truths[index] == pytest.approx(theta)
        table = QTable.read(mocks / f"mock_00{index}.csv", format="ascii.csv")
        assert table["value"].tolist() == pytest.approx(mock.values.tolist())
        document = tomllib.loads((mocks / f"mock_00{index}.toml").read_text())
        assert document["observable"]["speed"][0] == mock.values[0]
        samples[index] = posterior(mock)
    QTable({"ln_p": np.zeros(SAMPLES), NAME: samples[0][:, 0]}).write(mocks / "samples_000.csv", format="ascii.csv")
    np.savez(mocks / "samples_001.npz", theta=samples[1], theta_names=[NAME])
    with h5py.File(mocks / "samples_002.h5", "w") as file:
        file[NAME] = samples[2][:, 0]
    ours = calibrate(spec, tmp_path / "callable", 3, method=posterior)
    theirs = calibrate_samples(spec, mocks, tmp_path / "files")
    assert theirs.ranks == pytest.approx(ours.ranks)
    assert theirs.method == "files in mocks"


def test_a_table_with_units_is_read_in_the_run_files(spec, tmp_path):
    QTable({NAME: GOOD / 1000}, units={NAME: "km/ms"}).write(tmp_path / "samples_000.ecsv")
    assert read_samples(tmp_path, 0, spec)[:, 0] == pytest.approx(GOOD)


def no_file(folder: Path) -> None:
    pass


def two_files(folder: Path) -> None:
    np.savez(folder / "samples_000.npz", **{NAME: GOOD})
    (folder / "samples_000.csv").write_text("")


def damaged(folder: Path) -> None:
    (folder / "samples_000.npz").write_bytes(b"no archive")


def unnamed(folder: Path) -> None:
    np.savez(folder / "samples_000.npz", theta=GOOD[:, None])


def text(folder: Path) -> None:
    (folder / "samples_000.csv").write_text(f"{NAME}\n" + "high\n" * 30)


def gap(folder: Path) -> None:
    (folder / "samples_000.csv").write_text(f"{NAME},x\n" + "200.0,1\n" * 30 + ",1\n")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (no_file, r"draw 0 has no samples of this draw: samples_000.csv, .ecsv, .npz or .h5"),
        (two_files, "both samples_000.csv and samples_000.npz, and one is wanted"),
        (damaged, "samples_000.npz: cannot be read"),
        (unnamed, r"theta has the shape \(50, 1\), and theta_names names 0 columns"),
        (text, "samples_000.csv: the samples are no array of numbers"),
        (gap, "samples_000.csv: 1 of 31 samples of potential.v0 are not finite"),
    ],
)
def test_files_that_cannot_be_read_are_told(spec, tmp_path, make, words):
    make(tmp_path)
    with pytest.raises(sk.StreamkitError, match=words):
        read_samples(tmp_path, 0, spec)


def test_mock_data_of_another_run_file_are_refused(spec, tmp_path):
    write_mocks(spec, tmp_path, 1)
    assert len(read_truths(tmp_path, spec.with_values({"sampler.steps": 7}))) == 1  # the sampler changes no data
    for other in (spec.with_values({"seed": 9}), spec.with_values({NAME: {"normal": [MEAN, 2 * SD]}})):
        with pytest.raises(sk.StreamkitError, match="belong to another run file"):
            calibrate_samples(other, tmp_path, tmp_path / "out")
    with pytest.raises(sk.StreamkitError, match="has mock data of 1 draws; 2 are wanted"):
        calibrate_samples(spec, tmp_path, tmp_path / "out", 2)
    with pytest.raises(sk.StreamkitError, match="holds no mock data; `streamkit calibrate --write-mocks"):
        calibrate_samples(spec, tmp_path / "nothing", tmp_path / "out")
    (tmp_path / "truths.ecsv").write_text("# %ECSV 1.0")
    with pytest.raises(sk.StreamkitError, match="is damaged"):
        read_truths(tmp_path, spec)


@pytest.mark.rendered
def test_the_command_writes_mocks_and_ranks_samples(spec, tmp_path):
    run, mocks, out = (str(tmp_path / name) for name in ("run.toml", "mocks", "out"))
    Path(run).write_text(spec.toml())

    def call(*options):
        return CliRunner().invoke(main, ["calibrate", run, *options])

    written = call("--draws", "2", "--write-mocks", mocks)
    assert written.exit_code == 0, written.output
    assert "samples_000.csv, .ecsv, .npz or .h5, with the columns potential.v0" in " ".join(written.output.split())
    assert call("--draws", "2", "--write-mocks", mocks).exit_code == 2
    assert "draw 0 has no samples" in call("--samples", mocks, "-o", out).output
    for index in range(2):
        np.savez(Path(mocks) / f"samples_00{index}.npz", **{NAME: GOOD})
    done = call("--samples", mocks, "-o", out)
    assert done.exit_code == 0, done.output
    assert "share of 2 draws" in done.output
    assert QTable.read(Path(out) / "calibration.ecsv")["samples"].tolist() == [50, 50]
    assert (Path(out) / "calibration.png").stat().st_size > 5000
    assert "give one" in call("--samples", mocks, "--write-mocks", mocks).output
    assert "continues fits" in call("--samples", mocks, "--resume").output
