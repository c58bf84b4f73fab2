"""Runs the checks in a process of their own: what an author's code prints, breaks or never ends stays there."""

from __future__ import annotations

import contextlib
import io
import json
import multiprocessing
import os
import select
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable

LIMIT = 900.0  # seconds for all the checks of a component


def killed(work: Callable[[], object], when: Callable[[], bool], limit: float = 120.0) -> None:
    """Do work in a forked process that is killed once ``when`` is true, or after so many seconds."""
    process = multiprocessing.get_context("fork").Process(target=work)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*fork", category=DeprecationWarning)  # this process has threads
        process.start()
    until = time.monotonic() + limit
    while not when() and process.is_alive() and time.monotonic() < until:
        time.sleep(0.02)
    process.kill()
    process.join()


def in_a_process(work: Callable[[], list[str]], limit: float = LIMIT) -> list[str]:
    """Return the lines of ``work``, run in a forked process; one line that says so if that crashes or does not end.

    Where there is no fork, it runs here.
    """
    if not hasattr(os, "fork"):
        return work()
    sys.stdout.flush()
    sys.stderr.flush()
    inward, outward = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # threads of linear algebra, which survive a fork
        child = os.fork()
    if child == 0:
        _work_and_exit(work, outward)
    os.close(outward)
    with os.fdopen(inward, "rb") as pipe:
        ready = select.select([pipe], [], [], limit)[0]  # the lines come at once, or the end of a dead process
        text = pipe.read() if ready else b""
    if not ready:
        os.kill(child, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if not ready:
        return [f"ends: no result after {limit:.0f} s: is there a loop that does not end?"]
    if status < 0:
        return [f"survives: the interpreter crashed ({signal.Signals(-status).name}): look at compiled or C code"]
    if status or not text:
        return [f"survives: the process of the checks ended with status {status}: does the code call exit?"]
    return list(json.loads(text))


def _work_and_exit(work: Callable[[], list[str]], outward: int) -> None:
    status = 1
    try:
        lines = work()
        with os.fdopen(outward, "w", encoding="utf-8") as pipe:
            json.dump(lines, pipe)
        status = 0
    except BaseException as error:
        with contextlib.suppress(OSError), os.fdopen(outward, "w", encoding="utf-8") as pipe:
            json.dump([f"runs: {type(error).__name__}: {error}"], pipe)
            status = 0
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def printed(work: Callable[[], object]) -> str:
    """Return what a call prints to stdout and stderr, of Python and of compiled code alike."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(1), os.dup(2)]
    text = io.StringIO()
    with tempfile.TemporaryFile() as file:
        try:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
            with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
                work()
        finally:
            for target, source in enumerate(kept, start=1):
                os.dup2(source, target)
                os.close(source)
        file.seek(0)
        return text.getvalue() + file.read().decode(errors="replace")
