"""A run in a directory: resume, refused checkpoints, the layout of a snapshot, the command."""

import os
import re
import shlex
import signal
import tomllib
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure
from PIL import Image
from streamkit_nbody import cli, runner, snapshot
from streamkit_nbody.gravity import NotFinite
from streamkit_nbody.plan import Options
from streamkit_nbody.runner import CHECKPOINT
from streamkit_nbody.simulation import Simulation

from streamkit import GYR, ChainError, load
from streamkit.cli.main import main
from streamkit.errors import Interrupted
from streamkit.nbody import read_snapshot
from streamkit.study.ablation import PRODUCTS

PACKAGE = Path(__file__).parent.parent
RUN = """
seed = 3
[potential]
kind = "tf"
v0 = { uniform = [200, 220] }
rs = 12
alpha = 0.45
[progenitor]
kind = "plummer"
mass = 5e7
radius = 0.85
x = 20
y = 0
z = 5
vx = 30
vy = 200
vz = 0
lookback = "0.15 Gyr"
[stripping]
kind = "mlcs"
sigma = 10
"""
N = 300


@pytest.fixture
def run_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(RUN)
    return "small.toml"


@pytest.fixture
def simulation(run_file):
    return Simulation.of(load(run_file), Options(particles=N))


def stopped(simulation, out, monkeypatch, record=6):
    """Run until a signal comes during a record."""
    advance = Simulation.advance

    def once(self, state):
        if state.record == record:
            os.kill(os.getpid(), signal.SIGTERM)
        return advance(self, state)

    with monkeypatch.context() as patch:
        patch.setattr(Simulation, "advance", once)
        with pytest.raises(Interrupted, match=r"stopped at 0\.070 of 0\.150 Gyr.*--resume") as caught:
            runner.run(simulation, out, progress=False)
    assert caught.value.exit_status == 128 + signal.SIGTERM


def contents(path):
    """Every attribute and dataset of a file, as bytes."""
    result = {}

    def visit(name, item):
        result.update({f"{name}@{key}": np.asarray(value).tobytes() for key, value in item.attrs.items()})
        if isinstance(item, h5py.Dataset):
            result[name] = item[()].tobytes()

    with h5py.File(path) as file:
        file.visititems(visit)
    return result


def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(simulation, tmp_path, monkeypatch):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    runner.run(simulation, whole, snapshots=3, progress=False)
    stopped(simulation, parts, monkeypatch)
    assert snapshot.read(parts / CHECKPOINT)[0].record == 7  # the block was finished first
    runner.run(simulation, parts, snapshots=3, resume=True, progress=False)
    names = sorted(path.name for path in whole.iterdir())
    assert names == ["checkpoint.hdf5", "run.toml", *(f"snapshot_{k:03d}.hdf5" for k in (1, 2, 3))]
    for name in ("checkpoint.hdf5", "snapshot_002.hdf5", "snapshot_003.hdf5"):
        assert contents(parts / name) == contents(whole / name)


def test_a_kill_loses_what_came_after_the_checkpoint_only(simulation, tmp_path, monkeypatch):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    monkeypatch.setattr(runner, "EVERY", 0.0)
    runner.run(simulation, whole, progress=False)

    def killed(self, state):
        if state.record == 5:
            raise KeyboardInterrupt  # nothing is written on the way out
        return advance(self, state)

    advance = Simulation.advance
    with monkeypatch.context() as patch:
        patch.setattr(Simulation, "advance", killed)
        with pytest.raises(KeyboardInterrupt):
            runner.run(simulation, parts, progress=False)
    runner.run(simulation, parts, resume=True, progress=False)
    assert contents(parts / CHECKPOINT) == contents(whole / CHECKPOINT)


def test_a_finished_run_is_resumed_to_itself(simulation, tmp_path):
    first = runner.run(simulation, tmp_path / "out", progress=False)
    again = runner.run(simulation, tmp_path / "out", resume=True, progress=False)
    assert np.array_equal(first.q, again.q)


def test_a_checkpoint_of_another_run_is_refused(simulation, run_file, tmp_path, monkeypatch):
    out = tmp_path / "out"
    stopped(simulation, out, monkeypatch)
    before = (out / CHECKPOINT).read_bytes()
    heavier = load(run_file).with_values({"progenitor.mass": "6e7 Msun"})
    for other, what in (
        (Simulation.of(heavier, Options(particles=N)), r"progenitor\.mass: 50000000\.0 -> 60000000\.0"),
        (Simulation.of(load(run_file), Options(particles=N + 1)), r"particles: 300 -> 301"),
        (Simulation.of(load(run_file), Options(particles=N, softening=0.2)), r"softening: 0\.\d+ -> 0\.2"),
    ):
        with pytest.raises(ChainError, match=rf"another run \(digest \w{{12}}.*{what}"):
            runner.run(other, out, resume=True, progress=False)
        assert (out / CHECKPOINT).read_bytes() == before


def test_directories_that_are_not_this_run(simulation, tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.txt").write_text("dear")
    for options in ({}, {"resume": True}, {"force": True}):
        with pytest.raises(ChainError, match=r"not empty \(found thesis\.txt\)"):
            runner.run(simulation, out, progress=False, **options)
    (out / "thesis.txt").unlink()
    stopped(simulation, out, monkeypatch)
    with pytest.raises(ChainError, match="holds a run already"):
        runner.run(simulation, out, progress=False)
    (out / "thesis.txt").write_text("dear")
    runner.run(simulation, out, force=True, progress=False)
    assert (out / "thesis.txt").read_text() == "dear"
    (tmp_path / "file").write_text("")
    with pytest.raises(ChainError, match="is a file"):
        runner.run(simulation, tmp_path / "file", progress=False)


def test_a_checkpoint_that_is_damaged_or_changed(simulation, tmp_path, monkeypatch):
    out = tmp_path / "out"
    stopped(simulation, out, monkeypatch)
    whole = (out / CHECKPOINT).read_bytes()
    (out / CHECKPOINT).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ChainError, match=r"checkpoint\.hdf5: cannot be read as a checkpoint"):
        runner.run(simulation, out, resume=True, progress=False)
    (out / CHECKPOINT).write_bytes(whole)
    with h5py.File(out / CHECKPOINT, "r+") as file:
        file["Run"].attrs["content"] = file["Run"].attrs["content"].replace("50000000.0", "60000000.0")
    with pytest.raises(ChainError, match="does not match its digest"):
        runner.run(simulation, out, resume=True, progress=False)


def test_a_run_that_loses_a_particle_says_where_the_rest_is(simulation, tmp_path, monkeypatch):
    advance = Simulation.advance

    def broken(self, state):
        v = np.where(state.record == 4, np.nan, state.v)
        return advance(self, replace(state, v=v))

    monkeypatch.setattr(Simulation, "advance", broken)
    with pytest.raises(NotFinite, match=r"300 of 300 particles are not finite.*0\.040 Gyr is in .*checkpoint\.hdf5"):
        runner.run(simulation, tmp_path / "out", progress=False)
    assert snapshot.read(tmp_path / "out" / CHECKPOINT)[0].record == 4


def test_the_layout_of_a_snapshot(simulation, tmp_path):
    last = runner.run(simulation, tmp_path / "out", progress=False)
    with h5py.File(tmp_path / "out" / "snapshot_001.hdf5") as file:
        header, particles, track = file["Header"].attrs, file["PartType1"], file["Progenitor"]
        for place in (header, file["Parameters"].attrs):
            assert place["UnitLength_in_cm"] == pytest.approx(3.0857e21, rel=1e-4)
            assert place["UnitMass_in_g"] == pytest.approx(1.988e33, rel=1e-3)
            assert place["UnitVelocity_in_cm_per_s"] == 1e5
        assert header["NumPart_ThisFile"].tolist() == header["NumPart_Total"].tolist() == [0, N, 0, 0, 0, 0]
        assert header["MassTable"].tolist() == [0] * 6  # so that readers take Masses
        assert header["Time"] == pytest.approx(0.15 * GYR)
        assert header["TimeBeforeToday"] == pytest.approx(0.0, abs=1e-12)
        assert particles["Coordinates"].shape == particles["Velocities"].shape == (N, 3)
        assert np.array_equal(particles["Coordinates"][:], last.q.T)
        assert particles["Masses"][:].sum() == pytest.approx(5e7)
        assert particles["ParticleIDs"][:].tolist() == list(range(N))
        assert particles["Coordinates"].attrs["unit"] == "kpc"
        stripping = particles["StrippingTime"][:]
        assert 10 < (stripping >= 0).sum() < N
        assert set(stripping[stripping < 0]) == {-1.0}
        assert (stripping[particles["Bound"][:] == 1] == -1).all()
        assert track.attrs["BoundMass"] == track["BoundMass"][-1] == last.track.mass[-1]
        assert track["Times"][-1] == header["Time"]
        assert np.array_equal(track["Coordinates"][-1], track.attrs["Position"])
        assert track["Velocities"].shape == track["Coordinates"].shape == (len(track["Times"]), 3)


def test_streamkit_reads_the_snapshot(simulation, tmp_path):
    last = runner.run(simulation, tmp_path / "out", progress=False)
    result = read_snapshot(tmp_path / "out" / "snapshot_001.hdf5")
    assert result.q == pytest.approx(last.q, rel=1e-12)
    assert result.v == pytest.approx(last.v, rel=1e-12)
    stripped = ~last.bound & (last.gap > 0)
    assert np.array_equal(np.isnan(result.t_strip), ~stripped)
    assert result.t_strip[stripped] == pytest.approx(last.t_strip[stripped] - 0.15 * GYR, abs=1e-9)
    assert np.array_equal(result.winding, last.winding(simulation.plane))
    assert result.core[0, -1] == 0
    assert result.core[1:, -1] == pytest.approx(np.concatenate([last.track.q[:, -1], last.track.v[:, -1]]), rel=1e-12)


@pytest.mark.slow
def test_a_model_is_compared_with_the_snapshot(simulation, run_file, tmp_path, monkeypatch):
    """From the file that a run leaves to every table and picture of an ablation, which are not rendered here."""
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, **options: Image.new("RGB", (1, 1)).save(file, "png"))
    runner.run(simulation, tmp_path / "out", progress=False)
    done = CliRunner().invoke(
        main, ["ablate", run_file, "-o", "compared", "-q", "--set", "stripping.particles=400",
               "--vary", "stripping.kind=mlcs,streakline", "--reference", "out/snapshot_001.hdf5"],
    )  # fmt: skip
    assert (done.exit_code, done.stderr) == (0, "")
    assert {path.name for path in Path("compared").iterdir()} == set(PRODUCTS) - {"sky.png"}


@pytest.fixture
def call(monkeypatch, capsys):
    """Run the script `streamkit-nbody`; return its status and what it prints on both streams."""

    def script(*arguments):
        monkeypatch.setattr("sys.argv", ["streamkit-nbody", *arguments])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        return caught.value.code, *capsys.readouterr()

    return script


def test_the_package_brings_the_command():
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    point = EntryPoint("nbody", project["entry-points"]["streamkit.commands"]["nbody"], "streamkit.commands")
    assert point.load() is cli.nbody
    assert project["scripts"] == {"streamkit-nbody": "streamkit_nbody.cli:main"}


def test_the_command(run_file, call):
    status, printed, _ = call(run_file, "--particles", str(N), "--set", "potential.v0=205", "-o", "out")
    assert status == 0
    said = re.sub(r"\s+", " ", printed)
    for text in ("5e+07 Msun in 300 particles", "bound mass", "binding energy", "kpc and"):
        assert text in said, text
    assert Path("out/snapshot_001.hdf5").is_file()
    assert load("out/run.toml").bind().potentials["potential"].v0 == 205
    status, _, complaint = call(run_file, "--particles", str(N), "-o", "out", "--resume", "-q")
    assert status == 2
    assert "potential.v0: 205.0 -> 210.0" in complaint
    assert call(run_file, "--resume", "--force")[::2] == (
        2, "streamkit: --resume continues the run in DIR and --force replaces it: give one of them. "
        "See 'streamkit nbody --help'.\n"
    )  # fmt: skip
    assert "no such option" in call(run_file, "--particle-count", "3")[2].lower()
    assert "cannot read the run file" in call("absent.toml")[2]


HOST = """\
from streamkit import Potential, Speed, hookimpl

class Flat(Potential):
    kind = "flat"
    v0: Speed
    compiled = False

    @staticmethod
    def acceleration(x, y, z, t, v0):
        r2 = x * x + y * y + z * z
        return -v0 * v0 * x / r2, -v0 * v0 * y / r2, -v0 * v0 * z / r2

@hookimpl
def streamkit_components():
    return [Flat]
"""


def with_host(fields):
    return re.sub(r"\[potential\].*\[progenitor\]", f"[potential]\n{fields}\n[progenitor]", RUN, flags=re.DOTALL)


def test_a_host_in_python_without_potential_energy(run_file, call):
    Path("flat_host.py").write_text(HOST)
    text = with_host('kind = "flat"\nv0 = 200')
    Path("flat.toml").write_text('plugins = ["flat_host.py"]\n' + text)
    status, printed, _ = call("flat.toml", "--particles", str(N), "-o", "elsewhere/out")
    assert status == 0
    assert "not monitored: the potential flat gives no potential energy" in re.sub(r"\s+", " ", printed)
    assert load("elsewhere/out/run.toml").bind().potentials["potential"].v0 == 200


def test_a_progenitor_that_cannot_be_followed_is_a_message(run_file, call):
    Path("point.toml").write_text(with_host('kind = "kepler"\nmass = 1e12'))
    at_centre = [f"--set=progenitor.{name}=0" for name in ("x", "z", "vx", "vy")]
    status, _, complaint = call("point.toml", *at_centre)
    assert status == 2
    assert "point.toml: there is no such simulation: the orbit of the progenitor is not finite" in complaint


def test_the_commands_of_the_readme_parse():
    text = (PACKAGE / "README.md").read_text(encoding="utf-8")
    lines = [shlex.split(line) for line in re.findall(r"^\$ streamkit nbody (.*)$", text, re.MULTILINE)]
    assert lines
    for line in lines:
        cli.nbody.make_context("nbody", line)
