"""The lock on an output directory: one run at a time, the true reason, and nothing left behind."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import pytest
from forked import forked

from streamkit import ChainError
from streamkit.report import contents, is_locked, locked, replace_whole
from streamkit.sample import pool

HOLD = """
import sys
from pathlib import Path
from streamkit.report import locked
with locked(Path(sys.argv[1])):
    pass
"""


@contextmanager
def held(directory: Path) -> Iterator[BaseProcess]:
    """Another process that holds the directory."""
    begun = Pipe()
    process = forked(hold, directory, begun[1])
    assert begun[0].poll(60)
    yield process
    process.kill()
    process.join()


def hold(directory: Path, begun: Connection) -> None:
    with locked(directory):
        begun.send("held")
        begun.poll(None)


def test_another_process_is_refused_until_the_first_is_killed(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with held(out) as process:
        assert contents(out) == []
        with pytest.raises(ChainError, match="out: another run is writing here right now"), locked(out):
            pass
        process.kill()
        process.join()
    assert contents(out) == []
    with locked(out):
        (out / "table").write_text("1")
    assert [path.name for path in out.iterdir()] == ["table"]


def test_one_process_is_refused_twice_too(tmp_path: Path) -> None:
    with locked(tmp_path):
        for _ in range(2):  # a refusal does not end the first one's lock
            with pytest.raises(ChainError, match="another run is writing"), locked(tmp_path):
                pass
    with locked(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (errno.EACCES, "Permission denied"),
        (errno.EROFS, "Read-only file system"),
        (errno.ENOSPC, "No space left on device"),
        (errno.EDQUOT, "Disk quota exceeded"),
    ],
)
def test_a_lock_that_cannot_be_written_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, reason: str
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(code, os.strerror(code))

    out = tmp_path / "deep" / "out"
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(ChainError, match=f"out: cannot be locked for writing: {reason}"), locked(out):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="locks of another kind")
def test_a_file_system_without_locks_left_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", refuse)
    with pytest.raises(ChainError, match="cannot be locked for writing: No locks available"), locked(tmp_path):
        pass


def test_what_is_no_directory(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with (
        pytest.raises(ChainError, match="file: is a file, and the output needs a directory"),
        locked(tmp_path / "file"),
    ):
        pass
    with pytest.raises(ChainError, match="out: cannot be made: Not a directory"), locked(tmp_path / "file" / "out"):
        pass
    assert (tmp_path / "file").read_text() == "mine"


def test_a_directory_that_was_made_and_not_used_is_taken_away(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    for out in (tmp_path / "a" / "b", tmp_path / "mine"):
        with pytest.raises(ZeroDivisionError), locked(out):
            raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    with locked(tmp_path / "a" / "b"):
        (tmp_path / "a" / "b" / "chain").write_text("1")
    assert (tmp_path / "a" / "b" / "chain").exists()


def test_worker_processes_do_not_give_the_lock_away(tmp_path: Path) -> None:
    with locked(tmp_path):
        with pool(2) as executor:
            assert list(executor.map(abs, [-1, -2])) == [1, 2]
        other = subprocess.run([sys.executable, "-c", HOLD, tmp_path], capture_output=True, text=True)
        assert "another run is writing here right now" in other.stderr


def test_a_descriptor_that_a_plugin_closed_does_not_hide_the_end(tmp_path: Path) -> None:
    with locked(tmp_path):
        there = [fd for fd in Path("/proc/self/fd").iterdir() if fd.exists()]
        (mine,) = [fd for fd in there if fd.samefile(tmp_path / ".streamkit.lock")]
        os.close(int(mine.name))
    with locked(tmp_path):
        pass


def test_nothing_is_written_through_a_link_at_the_place_of_a_temporary_file(tmp_path: Path) -> None:
    mine, out = tmp_path / "mine", tmp_path / "summary.ecsv"
    mine.write_text("mine")
    (tmp_path / ".summary.part.ecsv").symlink_to(mine)
    replace_whole(out, lambda part: part.write_text("new"))
    assert (mine.read_text(), out.read_text(), out.is_symlink()) == ("mine", "new", False)
    (tmp_path / ".summary.part.ecsv").write_text("what a kill left")
    replace_whole(out, lambda part: part.write_text("newer"))
    assert out.read_text() == "newer"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "summary.ecsv"]


def test_a_lock_that_is_a_link_leaves_the_other_file_alone(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".streamkit.lock").symlink_to(mine)
    is_locked(tmp_path / "out")
    with pytest.raises(ChainError, match="cannot be locked for writing"), locked(tmp_path / "out"):
        pass
    assert mine.read_text() == "mine"


def test_a_lock_that_another_process_has_for_a_moment_is_waited_for(tmp_path: Path) -> None:
    with held(tmp_path) as process:
        end = threading.Timer(0.3, process.kill)
        end.start()
        with locked(tmp_path):
            pass
