"""The process of a command: closed descriptors, and threads that do not end."""

import os
import subprocess
import sys
import time

import pytest
from runfiles import RUN

SCRIPT = """
import os, sys, threading, time
import click
from streamkit.cli import process
from streamkit.cli.main import main

process.PATIENCE = 0.5

class Knot:
    ends = 0
    def __init__(self):
        self.own = self  # a cycle
    def __del__(self):
        Knot.ends += 1

@main.command()
@click.argument("what")
def harm(what):
    global left_open
    if what == "knots":
        for _ in range(20_000 * 2):
            Knot()
        assert Knot.ends > 0
    if what.startswith("open "):
        left_open = open(what[5:], "w")
        left_open.write("written")
    if what == "close":
        os.close(1)
        os.close(2)
        assert os.open(os.devnull, os.O_RDONLY) == 1  # as any file would
    if what.startswith("close all"):
        os.closerange(0, 100)
    if what == "stay":
        threading.Thread(target=time.sleep, args=(1000,), name="theirs").start()
    if what == "end":
        threading.Thread(target=time.sleep, args=(0.1,)).start()
    if what.endswith("fail"):
        raise OSError(28, "No space left on device", "x.h5")
    click.echo("done")

sys.argv[0] = "streamkit"
main()
"""


def harmed(what, redirected=""):
    """Return the status, the output and the errors of a command that does something to its process."""
    command = f'exec "$0" "$@" {redirected}'
    done = subprocess.run(
        ["/bin/sh", "-c", command, sys.executable, "-c", SCRIPT, "harm", what],
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("what", ["close", "end"])
def test_what_does_no_harm(what):
    assert harmed(what) == (0, "done\n", "")


def test_cycles_are_freed_while_a_command_runs():
    assert harmed("knots") == (0, "done\n", "")


def test_a_file_that_a_plugin_leaves_open_is_written(tmp_path):
    assert harmed(f"open {tmp_path / 'left.txt'}") == (0, "done\n", "")
    assert (tmp_path / "left.txt").read_text() == "written"


def test_a_thread_that_is_left_does_not_keep_the_process():
    begin = time.monotonic()
    told = "streamkit: ended, though a thread of a plugin is still running (theirs)\n"
    assert harmed("stay") == (0, "done\n", told)
    assert time.monotonic() - begin < 180


@pytest.mark.parametrize("redirected", [">&-", "2>&-", "<&-", ">&- 2>&- <&-"])
def test_descriptors_that_the_shell_closed(redirected):
    seen = "" if ">&- " in f" {redirected} ".replace("2>&-", "") else "done\n"
    assert harmed("nothing", redirected) == (0, seen, "")
    status, output, errors = harmed("fail", redirected)
    assert (status, output) == (2, "")
    assert errors in ("", "streamkit: x.h5: cannot be read or written: No space left on device\n")
    assert bool(errors) == ("2>&-" not in redirected)


@pytest.mark.slow
def test_a_run_file_is_checked_without_streams(tmp_path):
    (tmp_path / "run.toml").write_text(RUN)
    command = 'exec "$0" -m streamkit check run.toml --draws 0 >&- 2>&- <&-'
    done = subprocess.run(["/bin/sh", "-c", command, sys.executable], cwd=tmp_path, timeout=300, check=False)
    assert done.returncode == 0


def test_a_message_that_nobody_reads_leaves_the_status():
    """The reader has closed its end; a plugin has closed the copies of the descriptors too."""
    read, write = os.pipe()
    process = subprocess.Popen([sys.executable, "-c", SCRIPT, "harm", "fail"], stdout=write, stderr=write)
    os.close(read)
    os.close(write)
    assert process.wait(200) == 2
    assert harmed("close all and fail") == (2, "", "")
