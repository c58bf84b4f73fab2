"""Every file that a run's directory holds of its run is checked wherever it is read."""

from __future__ import annotations

import json
import logging
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import call, refused
from forging import forging

import streamkit as sk

ARCHIVE = Path(__file__).parents[2] / "data" / "runs_0.1.0.zip"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of streamkit 0.1.0, and in ``new`` the same one as today's code leaves it."""
    folder = tmp_path_factory.mktemp("integrity")
    with zipfile.ZipFile(ARCHIVE) as archive:
        archive.extractall(folder)
    run_file = folder / "chain" / "run.toml"
    sk.run(run_file, folder / "new", steps=4, progress=False, products=False)
    return folder


@pytest.fixture(params=["chain", "new"])
def directory(whole: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    shutil.copytree(whole / "chain", tmp_path / "original")  # with the right run file
    return Path(shutil.copytree(whole / request.param, tmp_path / "out"))


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1, text
    path.write_text(text.replace(old, new))


def readers(directory: Path) -> dict[str, Callable[[], str]]:
    """Return the commands that read a directory, each as a call that returns why it is refused."""
    return {
        "report": lambda: refused("report", directory, "--trust"),
        "status": lambda: refused("status", directory, "--trust"),
        "export": lambda: refused("export", directory, "--trust", "-o", directory / "samples.csv"),
        "cite": lambda: refused("cite", directory, "--trust"),
        "resume": lambda: refused("run", directory.parent / "original" / "run.toml", "-o", directory, "--resume", "-q",
                                  "--steps", "30"),
    }  # fmt: skip


def files_of(directory: Path) -> dict[Path, bytes]:
    """Return the files below a directory, without the bytecode that Python writes beside a plugin."""
    files = (path for path in directory.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path: path.read_bytes() for path in files}


def check_all_refuse(directory: Path, *words: str) -> None:
    """Check that all commands and the call in Python refuse the directory, with these words, and change nothing."""
    before = files_of(directory)
    for name, reader in readers(directory).items():
        message = reader()
        assert all(word in message for word in words), f"{name}: {message}"
    with pytest.raises(sk.StreamkitError) as caught:
        sk.load_results(directory, trust=True)
    assert all(word in str(caught.value) for word in words)
    assert files_of(directory) == before


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("run.toml", b'rs = "12', b'rs = "13', ("run.toml: has changed since the run began", "manifest.json")),
        ("run.toml", None, b"", ("run.toml",)),
        ("plugins/distance.py", b"np.array([0.0, 0.1])", b"np.array([0.0, 0.2])",
         ("distance.py", "has changed since the run began")),
        ("data/table.npy", np.float64(1.0).tobytes(), np.float64(1.5).tobytes(),
         ("data/table.npy", "has changed since the run began")),
    ],
    ids=["run file", "emptied run file", "plugin", "data file"],
)  # fmt: skip
def test_an_edited_file_is_refused(
    directory: Path, name: str, old: bytes | None, new: bytes, words: tuple[str, ...]
) -> None:
    content = (directory / name).read_bytes()
    changed = content.replace(content if old is None else old, new)
    assert changed != content
    (directory / name).write_bytes(changed)
    check_all_refuse(directory, *words)


def test_the_length_of_the_chain_and_comments_may_be_edited(directory: Path) -> None:
    edit(directory / "run.toml", "steps = 8", "steps = 90  # more")
    assert call("status", directory, "--trust").exit_code == 0
    assert sk.load_results(directory, trust=True).spec.document["sampler"]["steps"] == 90


def test_edited_limits_do_not_change_what_is_said_of_convergence(
    whole: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    directory = Path(shutil.copytree(whole / "new", tmp_path / "out"))
    run_file, about = directory / "run.toml", directory / "manifest.json"
    text, manifest = run_file.read_text(), about.read_text()
    run_file.write_text(text.replace("r_hat = 1.02", "r_hat = 9.0"))

    def largest() -> float:
        caplog.clear()
        return sk.load_results(directory, trust=True).draws.convergence.largest_r_hat  # type: ignore[attr-defined]

    assert largest() == 1.02
    assert "run.toml: has been edited since the run began or was resumed" in caplog.text
    assert "sampler.r_hat: 1.02 -> 9.0" in caplog.text
    assert "Convergence is judged by the former" in caplog.text
    # a former version did not note the limits, but the checksum of the file
    about.write_text(json.dumps({key: value for key, value in json.loads(manifest).items() if key != "limits"}))
    assert largest() == 9.0
    assert "run.toml: has been edited since the run began or was resumed" in caplog.text
    sk.run(run_file, directory, steps=5, resume=True, progress=False, products=False)
    assert largest() == 9.0
    assert not caplog.text


def test_a_quick_look_stays_one(directory: Path) -> None:
    """Its samples know it too."""
    with forging(directory / "chain.h5") as file:
        file.attrs["quick"] = True
    assert sk.load_results(directory, trust=True).note().startswith("QUICK LOOK")


def test_a_file_of_calls_beside_a_chain_is_no_part_of_it(directory: Path) -> None:
    (directory / "calls.journal").write_bytes(b"something else")
    steps = len(sk.load_results(directory, trust=True).chain)
    assert call("status", directory, "--trust").exit_code == 0
    sk.run(directory / "run.toml", directory, steps=steps + 1, resume=True, progress=False, products=False)
    assert len(sk.load_results(directory, trust=True).chain) == steps + 1


def test_a_lost_journal_is_mentioned(directory: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Not that of a run at its end, whose steps are all in the chain file."""
    (directory / "chain.journal").unlink(missing_ok=True)
    steps = len(sk.load_results(directory, trust=True).chain)
    assert "chain.journal" not in caplog.text
    with forging(directory / "chain.h5") as file:
        file.attrs["goes_on"] = True
    said = f"chain.journal: is missing or empty, and the run was not at its end. Steps after step {steps} are lost"
    sk.load_results(directory, trust=True)
    assert said in caplog.text
    caplog.clear()
    sk.run(directory / "run.toml", directory, steps=steps + 1, resume=True, progress=False, products=False)
    assert said in caplog.text
    caplog.clear()
    sk.load_results(directory, trust=True)
    assert not caplog.text


def test_a_later_version_reads_the_run_file_that_has_not_changed(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """It may have a default that the run did not have: the digest is another one, and the file is the same."""
    directory = Path(shutil.copytree(whole / "new", tmp_path / "out"))
    about = json.loads((directory / "manifest.json").read_text())
    digest = sk.Spec.digest
    monkeypatch.setattr(sk.Spec, "digest", lambda spec, suppliers=None: f"later {digest(spec, suppliers)}")
    results = sk.load_results(directory, trust=True)
    assert len(results.chain) == 4
    edit(directory / "run.toml", 'rs = "12', 'rs = "13')
    with pytest.raises(sk.ChainError, match=r"run\.toml: has changed since the run began"):
        sk.load_results(directory, trust=True)
    about["components"]["potential"] = "tf from streamkit 0.0.9"
    edit(directory / "run.toml", 'rs = "13', 'rs = "12')
    (directory / "manifest.json").write_text(json.dumps(about))
    with caplog.at_level(logging.WARNING, "streamkit"):
        sk.load_results(directory, trust=True)
    assert "the run was made with streamkit 0.0.9, and is read with streamkit" in caplog.text
