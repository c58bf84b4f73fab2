"""Draws of the priors: their distribution, the noise, and a file that no number of workers or interruption changes."""

import fcntl
import os
import signal
import subprocess
import sys
import tomllib
from collections import namedtuple
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import kstest
from streamkit_simulate import archive, simulate
from streamkit_simulate.simulator import Simulator

from streamkit import ChainError, Model, Observable, OutOfDomain, Prediction, SpecError, StreamkitError, load
from streamkit.cli.main import main
from streamkit.errors import Interrupted

RUN = """
seed = 3
[potential]
kind = "logarithmic_halo"
v0 = { uniform = [200, 240] }
q = 0.9
[progenitor]
kind = "plummer"
mass = 2e4
radius = 0.03
x = 12
y = 0
z = 5
vx = 30
vy = { normal = [180, 5] }
vz = 20
lookback = "1.5 Gyr"
[stripping]
kind = "mlcs"
particles = 300
sigma = 1
[observable]
kind = "track"
frame = { pole = [34.6, 29.7], origin = [180.0, 50.0] }
kernel = "5 deg"
[observable.phi2]
phi1 = PLACES
phi2 = [0, 0, 0]
error = [0.5, 1.0, 2.0]
[observable.distance]
phi1 = PLACES
distance = [20, 20, 20]
error = [1, 1, 1]
"""
N = 12


@pytest.fixture(scope="module")
def spec():
    """A run file with data on the stream itself."""
    start = load(load_text(RUN.replace("PLACES", "[0, 1, 2]")))
    stream = Model(start).stream()
    phi1 = stream.seen(start.bind().observable.frame).lon
    places = np.round(np.percentile(phi1, [30, 50, 70]), 1).tolist()
    return load(load_text(RUN.replace("PLACES", str(places))))


def load_text(text):
    return tomllib.loads(text)


@pytest.fixture(scope="module")
def whole(spec, tmp_path_factory):
    """A file made by one process without a pause."""
    path = tmp_path_factory.mktemp("whole") / "sims.h5"
    simulate(spec, path, N, progress=False)
    return path


def read(path):
    with h5py.File(path) as file:
        return {name: file[name][()] for name in file if name != "particles"}


def test_parameters_have_the_distribution_of_the_priors(spec):
    simulator = Simulator(spec)
    theta = np.array([simulator.parameters(i) for i in range(3000)])
    for prior, values in zip(spec.priors, theta.T, strict=True):
        shares = (values - 200) / 40 if prior.name == "uniform" else values
        against = "uniform" if prior.name == "uniform" else ("norm", (180, 5))
        test = kstest(shares, "uniform") if against == "uniform" else kstest(shares, *against)
        assert test.pvalue > 0.01
    assert abs(np.corrcoef(theta.T)[0, 1]) < 4 / np.sqrt(3000)


def test_a_draw_is_the_stream_at_its_parameters(spec, whole):
    found, model = read(whole), Model(spec, fresh=True)
    for theta, mean in zip(found["theta"][:4], found["mean"][:4], strict=True):
        prediction = spec.bind(theta).observable.predict(model.stream(theta))
        assert np.array_equal(mean, prediction.mean)
    assert found["theta_names"].astype(str).tolist() == list(spec.names)
    assert found["theta_units"].astype(str).tolist() == ["km/s", "km/s"]
    assert found["x_names"].astype(str).tolist() == list(prediction.names)
    assert np.array_equal(found["x_observed"], [0, 0, 0, 20, 20, 20])
    assert np.array_equal(found["x_error"], [0.5, 1, 2, 1, 1, 1])


def test_the_noise_is_that_of_the_data(spec, tmp_path):
    simulate(spec.with_values({"stripping.particles": 60}), tmp_path / "sims.h5", 200, progress=False)
    found = read(tmp_path / "sims.h5")
    pull = (found["x"] - found["mean"])[found["why_not"] == b""] / found["x_error"]
    assert kstest(pull.ravel(), "norm").pvalue > 0.01
    correlation = np.corrcoef(pull.T) - np.eye(6)
    assert np.abs(correlation).max() < 4.5 / np.sqrt(len(pull))


def test_without_noise_the_data_are_the_predictions(spec, whole, tmp_path):
    simulate(spec, tmp_path / "sims.h5", N, noise=False, progress=False)
    found = read(tmp_path / "sims.h5")
    assert "mean" not in found
    assert np.array_equal(found["x"], read(whole)["mean"])


def test_particles_are_those_of_the_stream(spec, tmp_path):
    simulate(spec, tmp_path / "sims.h5", 2, particles=True, progress=False)
    with h5py.File(tmp_path / "sims.h5") as file:
        rows, theta = file["particles/stream"][:], file["theta"][:]
    stream = Model(spec, fresh=True).stream(theta[1])
    assert rows.shape == (2, 300, 7)
    assert np.allclose(rows[1, :, :3].T, stream.q, rtol=1e-6)
    assert np.allclose(rows[1, :, 3:6].T, stream.v, rtol=1e-6)
    assert np.array_equal(rows[1, :, 6] == 0, stream.bound)


@pytest.mark.parametrize("workers", [2, 3, ThreadPoolExecutor(1)])
def test_no_number_of_workers_changes_a_byte(spec, whole, tmp_path, workers):
    simulate(spec, tmp_path / "sims.h5", N, workers=workers, progress=False)
    assert (tmp_path / "sims.h5").read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_file_that_was_interrupted_is_continued_to_the_same_bytes(spec, whole, tmp_path, monkeypatch, workers):
    path, evaluate = tmp_path / "sims.h5", Simulator.evaluate
    parent = os.getpid()

    def once(self, point):
        if point[0] == 5:
            os.kill(parent, signal.SIGTERM)
        return evaluate(self, point)

    with monkeypatch.context() as patch:
        patch.setattr(Simulator, "evaluate", once)
        with pytest.raises(Interrupted, match=r"stopped after \d+ of 12 draws.*--resume"):
            simulate(spec, path, N, workers=workers, progress=False)
    done = int(read(path)["done"][0])
    assert 0 < done < N
    assert np.isnan(read(path)["x"][done:]).all()
    assert simulate(spec, path, N, resume=True, progress=False).new == N - done
    assert path.read_bytes() == whole.read_bytes()


def test_a_file_gets_more_draws(spec, whole, tmp_path):
    path = tmp_path / "sims.h5"
    simulate(spec, path, 5, progress=False)
    assert simulate(spec, path, N, resume=True, progress=False).new == N - 5
    found, wanted = read(path), read(whole)
    assert all(np.array_equal(found[name], wanted[name], equal_nan=name in ("x", "mean")) for name in wanted)
    assert simulate(spec, path, N, resume=True, progress=False).new == 0
    with pytest.raises(StreamkitError, match="has 12 of 12 draws; --draws 4 would make it shorter"):
        simulate(spec, path, 4, resume=True, progress=False)


def test_a_kill_leaves_a_file_that_is_continued(spec, whole, tmp_path):
    (tmp_path / "run.toml").write_text(spec.toml())
    code = (
        "import os, streamkit_simulate.runner as r\n"
        "r.EVERY = 0\n"
        "write = r.Archive.append\n"
        "def append(self, draws):\n"
        "    write(self, draws)\n"
        "    if self.done == 4: self.file['x'][4:7] = 7.0; self.file.flush(); os.kill(os.getpid(), 9)\n"
        "r.Archive.append = append\n"
        f"r.simulate('run.toml', 'sims.h5', {N}, progress=False)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL
    assert read(tmp_path / "sims.h5")["done"][0] == 4
    assert simulate(load(tmp_path / "run.toml"), tmp_path / "sims.h5", N, resume=True, progress=False).new == N - 4
    found, wanted = read(tmp_path / "sims.h5"), read(whole)
    assert np.array_equal(found["x"], wanted["x"])


class OfLightHosts(Observable):
    """The mean distance, measured in hosts up to 220 km/s only."""

    kind = "test_of_light_hosts"

    def data(self):
        return np.array([15.0, np.nan]), np.array([1.0, 1.0])

    def predict(self, stream):
        if stream.parameters["potential.v0"] > 220:
            return Prediction(("r", "unused"), np.full(2, np.nan), np.full(2, np.nan), "the host is heavy")
        return Prediction(("r", "unused"), np.array([stream.r.mean(), np.nan]), np.zeros(2))


def test_a_draw_without_a_stream_is_nan_with_its_reason(spec, tmp_path):
    light = load(spec.document | {"observable": {"kind": OfLightHosts.kind}}, components=[OfLightHosts])
    done = simulate(light, tmp_path / "sims.h5", 40, progress=False)
    found = read(tmp_path / "sims.h5")
    heavy = found["theta"][:, 0] > 220
    assert 10 < heavy.sum() < 30
    assert found["why_not"].tolist() == [b"the host is heavy" if each else b"" for each in heavy]
    assert found["x_names"].astype(str).tolist() == ["r"]  # nothing is compared with the other number
    assert np.array_equal(np.isnan(found["x"][:, 0]), heavy)
    assert done.reasons == {"the host is heavy": heavy.sum()}


def test_priors_without_any_stream_are_refused_with_the_commonest_reason(spec, tmp_path, monkeypatch):
    def none(self, inputs):
        raise OutOfDomain("no stream at all")

    monkeypatch.setattr(Model, "observe_all", none)
    with pytest.raises(StreamkitError, match=r"none of 1000 draws .*most often: no stream at all \(1000 draws\)"):
        simulate(spec, tmp_path / "none.h5", 3, progress=False)
    assert not (tmp_path / "none.h5").exists()


def test_another_run_file_or_option_is_refused_with_the_difference(spec, whole):
    before = whole.read_bytes()
    with pytest.raises(ChainError, match=r"potential.q: 0\.9 -> 0\.8"):
        simulate(spec.with_values({"potential.q": 0.8}), whole, N, resume=True, progress=False)
    with pytest.raises(ChainError, match="noise: true -> false"):
        simulate(spec, whole, N, noise=False, resume=True, progress=False)
    simulate(spec.with_values({"sampler.steps": 7}), whole, N, resume=True, progress=False)  # draws have no sampler
    assert whole.read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"no HDF5 at all", None])
def test_a_foreign_file_is_refused(spec, tmp_path, content):
    path = tmp_path / "sims.h5"
    if content is None:
        with h5py.File(path, "w") as file:
            file["theta"] = np.zeros(3)
    else:
        path.write_bytes(content)
    with pytest.raises(ChainError, match="is no file of streamkit simulate, or a damaged one"):
        simulate(spec, path, N, resume=True, progress=False)


def test_what_cannot_be_made_is_refused_before_a_draw(spec, tmp_path, monkeypatch):
    path = tmp_path / "sims.h5"
    fixed = spec.with_values({"potential.v0": 220, "progenitor.vy": 180})
    with pytest.raises(SpecError, match="no field has a prior"):
        simulate(fixed, path, N, progress=False)
    bare = load({key: value for key, value in spec.document.items() if key != "observable"})
    with pytest.raises(SpecError, match=r"there is no observable.*--particles"):
        simulate(bare, path, N, progress=False)
    simulate(bare, tmp_path / "bare.h5", 2, particles=True, progress=False)
    assert read(tmp_path / "bare.h5")["x"].shape == (2, 0)
    with pytest.raises(StreamkitError, match=r"the directory '.*nowhere' does not exist"):
        simulate(spec, tmp_path / "nowhere" / "sims.h5", N, progress=False)
    with pytest.raises(StreamkitError, match="is a directory"):
        simulate(spec, tmp_path, N, progress=False)
    with pytest.raises(StreamkitError, match=r"the file is HDF5, and its suffix must be \.h5 or \.hdf5"):
        simulate(spec, tmp_path / "sims.npz", N, progress=False)
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(archive.shutil, "disk_usage", lambda _path: usage(10**6, 0, 10**6))
    with pytest.raises(StreamkitError, match=r"10000 draws take 3\.19 MB and the disk has 1 MB left, room for 29\d\d"):
        simulate(spec, path, 10000, progress=False)
    assert not path.exists()


def test_two_commands_do_not_write_into_one_file(spec, whole):
    layout = archive.Layout((), (), (), np.empty(0), np.empty(0), True, {}, {})
    with whole.open("rb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)  # as HDF5 does in another process
        with pytest.raises(ChainError, match="another command is writing"), archive.opened(whole, layout):
            pass


def test_the_command_tells_size_time_and_draws_without_a_stream(spec, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(spec.toml())
    done = CliRunner().invoke(main, ["simulate", "run.toml", "--draws", "3"])
    assert done.exit_code == 0, done.stderr
    assert "run-sims.h5: 3 draws, each with 2 parameters, 6 numbers: 936 B" in done.stdout
    assert "Every draw has a stream" in done.stdout
    again = CliRunner().invoke(main, ["simulate", "run.toml", "--draws", "3"])
    assert (again.exit_code, again.stdout) == (2, "")
    assert "the file exists; --resume continues it, --force replaces it" in again.stderr
    more = CliRunner().invoke(main, ["simulate", "run.toml", "--draws", "5", "--resume", "-q", "--workers", "2"])
    assert (more.exit_code, more.stdout) == (0, "")
    assert len(read("run-sims.h5")["x"]) == 5
    both = CliRunner().invoke(main, ["simulate", "run.toml", "--resume", "--force"])
    assert both.exit_code == 2
    assert "give one of them" in both.stderr
