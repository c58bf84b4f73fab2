"""Bad input and interruptions: one paragraph, a status, no traceback, nothing overwritten."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from astropy.table import QTable
from commands import call, refused
from runfiles import RUN

import streamkit as sk
from streamkit.fit.directory.manifest import MANIFEST
from streamkit.fit.runner import Interrupted


def test_an_existing_file_needs_force(run_file: Path) -> None:
    kept = run_file.parent / "s.ecsv"
    kept.write_text("mine")
    assert "the file exists; add --force" in refused("stream", run_file, "-o", kept)
    assert kept.read_text() == "mine"
    assert call("stream", run_file, "-o", kept, "--force").exit_code == 0
    assert len(QTable.read(kept)) == 400
    assert [path.name for path in run_file.parent.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["-o", "s.csv"], ["'s.csv'", ".ecsv, .hdf5", "found '.csv'", "Did you mean '.ecsv'?"]),
        (["-o", "no/where.ecsv"], ["directory 'no' does not exist"]),
        (["--plot", "s.txt"], ["--plot", ".png, .pdf, .svg"]),
        (["--track", "t.csv"], ["--track", ".ecsv, .png"]),
        (["--track", "t.ecsv", "--frame", "GD1"], ["--frame", "no frame 'GD1'"]),
        (["--set", "progenitor.mass"], ["'progenitor.mass'", "PATH=VALUE"]),
        (["--set", "seed=1", "--set", "seed=2"], ["seed", "given twice"]),
        (["--set", "zz=1"], ["there is no field 'zz'. Sections: sun, ", "potential", "stripping"]),
        (["--set", "progenitor.mas=6.4e8"], ["'progenitor.mas'", "Did you mean 'progenitor.mass'?"]),
        (["--set", "progenitor.mass=6.4e8 km"], ["progenitor.mass", "6.4e8 km", "Msun"]),
        (["--set", "progenitor.mass=-1"], ["progenitor.mass", "-1", "greater than 0"]),
        (["--set", "stripping.kind=mlc"], ["'mlc'", "Did you mean 'mlcs'?"]),
        (["--set", "stripping.progenitor_gravity=yes"], ["progenitor_gravity", "'yes'", "true or false"]),
    ],
)
def test_bad_options_of_stream(run_file: Path, options: list[str], wanted: list[str]) -> None:
    message = refused("stream", run_file, *options)
    for text in wanted:
        assert text in message
    assert list(run_file.parent.iterdir()) == [run_file]


def test_no_stream_is_said_and_not_thrown(run_file: Path) -> None:
    """An unbound progenitor still has particles; the observable says why it has no value."""
    result = call("stream", run_file, "--set", "progenitor.vx=2000")
    assert result.exit_code == 0
    assert "no value" in result.stdout


def test_a_body_whose_orbit_cannot_be_followed_is_told_with_the_run_file(run_file: Path) -> None:
    place = "x = 0\ny = 0\nz = 0\nvx = -57\nvy = -226\nvz = 221\n"
    run_file.write_text(f'{run_file.read_text()}\n[body.lmc]\nkind = "hernquist"\nmass = 1.4e11\na = 10\n{place}')
    reason = "the body lmc passes too near the Galactic centre to be followed"
    wanted = f"{run_file}: there is no stream at the prior's centre: {reason}"
    assert wanted in refused("check", run_file, "--draws", "0", "-q")


def test_bad_run_files(run_file: Path) -> None:
    for old, new, wanted in (
        ('kind = "tf"', 'kind = "ft"', ["potential", "'ft'", "Installed", "tf"]),
        ("particles = 400", "particle = 400", ["stripping", "'particle'", "Did you mean 'particles'?"]),
        ('rs = "12 kpc"', 'rs = "12 km/s"', ["potential.rs", "12 km/s", "kpc"]),
        ('["190 km/s", "230 km/s"]', '["230 km/s", "190 km/s"]', ["potential.v0", "230", "190"]),
        ('"3e8 Msun"', '"-3e8 Msun"', ["progenitor.mass", "-3e+08"]),
        ("seed = 7", "version = 99", ["version", "99"]),
        ("seed = 7", "seed = ", ["not valid TOML"]),
        ('lookback = "3.77 Gyr"', "lookback = 3 Gyr", ['A quantity needs quotes: "3 Gyr"']),
        ('"190 km/s", "230 km/s"', '190 km/s, "230 km/s"', ['A quantity needs quotes: "190 km/s"']),
        ('leading = ["57.0 kpc", "1.0 kpc"]', 'leading = ["57.0 kpc"]', ["observable.leading", "57.0 kpc"]),
    ):
        run_file.write_text(RUN.replace(old, new))
        for command in ("check", "stream", "run"):
            message = refused(command, run_file)
            for text in ("small.toml", *wanted):
                assert text in message, (command, message)
    assert list(run_file.parent.iterdir()) == [run_file]


def test_missing_data_cannot_be_run(run_file: Path) -> None:
    kept = RUN[: RUN.index("leading")] + RUN[RUN.index("[sampler]") :]
    run_file.write_text(kept)
    assert "datum" in refused("run", run_file)
    assert list(run_file.parent.iterdir()) == [run_file]
    assert call("check", run_file, "--draws", "0").exit_code == 0


@pytest.mark.parametrize(
    ("args", "wanted"),
    [
        (["chek", "x.toml"], ["'chek'", "Did you mean 'check'?", "plugins, reference, report"]),
        (["check"], ["RUN.toml", "streamkit check --help"]),
        (["run", "x.toml", "--worker", "2"], ["--worker", "--workers"]),
        (["run", "x.toml", "--workers", "0"], ["--workers", "0"]),
        (["run", "x.toml", "--resume", "--force"], ["--resume", "--force", "one of them"]),
        (["report", "nowhere"], ["nowhere"]),
        (["plugins", "potentials"], ["'potentials'", "Did you mean 'potential'?"]),
        (["plugins", "potential", "nfv"], ["'nfv'", "Did you mean 'nfw'?"]),
        (["plugins", "tf"], ["streamkit plugins potential tf"]),
        (["reference", "smapler"], ["'smapler'", "Did you mean 'sampler'?", "sun, potential"]),
        (["reference", "tf"], ["streamkit reference potential tf"]),
        (["reference", "potential", "nfv"], ["'nfv'", "Did you mean 'nfw'?"]),
        (["reference", "progenitor", "plumer"], ["'plumer'", "Did you mean 'plummer'?"]),
        (["reference", "sun", "tf"], ["[sun] has no kinds"]),
    ],
)
def test_bad_arguments(args: list[str], wanted: list[str]) -> None:
    message = refused(*args)
    for text in wanted:
        assert text in message


@pytest.mark.parametrize(("error", "status"), [(KeyboardInterrupt(), 130), (Interrupted("stopped", 15), 143)])
def test_an_interrupted_run_has_the_status_of_its_signal(
    run_file: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int
) -> None:
    def stop(*_args: Any, **_options: Any) -> None:
        raise error

    monkeypatch.setattr("streamkit.fit.run", stop)
    result = call("run", run_file)
    assert result.exit_code == status
    assert "streamkit: " in result.stderr
    assert "Traceback" not in result.stderr


def test_an_unexpected_exception_shows_itself(run_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_args: Any, **_options: Any) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("streamkit.fit.run", fail)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        call("run", run_file)


def test_a_directory_in_place_of_a_product_is_left_alone(run_file: Path) -> None:
    directory = run_file.parent / "run"
    (directory / "chain.h5").mkdir(parents=True)
    (directory / MANIFEST).write_text("{}")
    assert "chain.h5 is a directory, expected a file" in refused("run", run_file, "-o", directory, "--force")
    assert sorted(path.name for path in directory.iterdir()) == ["chain.h5", MANIFEST]


def test_what_the_system_refuses_is_one_paragraph(run_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_args: Any, **_options: Any) -> None:
        raise PermissionError(13, "Permission denied", "run/chain.h5")

    monkeypatch.setattr("streamkit.fit.run", fail)
    assert refused("run", run_file) == "streamkit: run/chain.h5: cannot be read or written: Permission denied\n"


def test_the_chain_of_another_run_is_refused(fit_file: Path) -> None:
    one, two = fit_file.parent / "one", fit_file.parent / "two"
    sk.run(fit_file, one, steps=1, progress=False, products=False)
    fit_file.write_text(fit_file.read_text().replace("seed = 3", "seed = 8"))
    sk.run(fit_file, two, steps=1, progress=False, products=False)
    strange = (one / "chain.h5").read_bytes()
    (two / "chain.h5").write_bytes(strange)
    for args in (["report", two], ["run", fit_file, "-o", two, "--resume", "--steps", "2"]):
        assert "two/chain.h5: is the chain of another run" in refused(*args)
    assert (two / "chain.h5").read_bytes() == strange
