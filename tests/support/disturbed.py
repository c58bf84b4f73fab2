"""Runs of the command that something happens to: each in a process of its own, and compared with one left alone.

The process is forked from this one, which has imported and compiled what a run needs, and enters the command where
``python -m streamkit`` does; only so are a thousand runs made within an hour. Cold ones are new interpreters.
"""

from __future__ import annotations

import ctypes
import mmap
import multiprocessing
import os
import resource
import signal
import struct
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import streamkit as sk
from streamkit.cli.main import main
from streamkit.sample import CHAIN, Chain, ChainFile, read_chain_file

RUN_FILE = """plugins = ["plugin.py"]
seed = {seed}
[potential]
kind = "{potential}"
v0 = {{ uniform = [215, 245] }}
rs = 12
alpha = {{ uniform = [0.25, 0.45] }}
[progenitor]
kind = "plummer"
mass = 6.4e8
radius = 0.85
x = 19.0
y = 0.0
z = -5.7
vx = 176.0
vy = 0.0
vz = 202.0
lookback = 0.05
[stripping]
kind = "mlcs"
particles = 8
[sampler]
walkers = 6
steps = 100000
tau_factor = 1e9
call_limit = 3
[observable]
kind = "distance"
table = "table.npy"
"""

PLUGIN = '''
import ctypes, os, signal, threading, time
from collections import Counter
from pathlib import Path
import numpy as np
from streamkit import Number, NumberArray, Observable, Potential, Prediction, Speed, Length, hookimpl

HARM, CALLS = Path("harm"), Counter()

class Bare(BaseException):
    """No Exception."""

def harm():
    """Do what the file says, from the stream of this process on that it names; what is passing is done once."""
    try:
        what, number, lasting, where = HARM.read_text().split()
    except OSError:
        return ""
    if CALLS[os.getpid()] < int(number) or (where == "worker" and os.getpid() == os.getsid(0)):
        return ""
    if lasting == "passing":
        HARM.unlink(missing_ok=True)
    if what == "exit":
        os._exit(3)
    if what == "abort":
        os.abort()
    if what == "segv":
        ctypes.string_at(0)
    if what == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "raise":
        raise Bare("no")
    if what == "never":
        time.sleep(1000)
    if what == "close":
        os.closerange(0, 200)
    if what == "thread":
        threading.Thread(target=time.sleep, args=(1000,), name="theirs").start()
    if what == "memory":
        np.ones(10**14)
    return what

class Harmful(Potential):
    """A logarithmic potential that does harm."""
    kind = "harmful"
    compiled = False
    v0: Speed
    rs: Length
    alpha: Number

    @staticmethod
    def prepare(v0):
        CALLS[os.getpid()] += 1
        return {}

    @staticmethod
    def acceleration(x, y, z, t, v0, rs, alpha):
        what = harm()
        k = -v0 * v0 / (x * x + y * y + z * z + rs * rs) * (1 + 0.1 * alpha)
        k = {"nan": np.nan, "complex": 1 + 1j}.get(what, 1.0) * k
        return k * x, k * y, k * z

class Distance(Observable):
    """The progenitor's distance from the centre, and how far the particles reach."""
    kind = "distance"
    table: NumberArray

    def data(self):
        return self.table[:2], self.table[2:]

    def predict(self, stream):
        return Prediction(("distance", "reach"), np.array([stream.orbit.r[-1], stream.r.max()]), np.array([0.0, 0.1]))

@hookimpl
def streamkit_components():
    return [Harmful, Distance]
'''
TABLE = np.array([20.0, 22.0, 1.0, 1.0])


def write_run(folder: Path, potential: str = "tf", seed: int = 3) -> Path:
    """Write the run file of a stream of a millisecond, with its plugin and its table; return it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plugin.py").write_text(PLUGIN)
    np.save(folder / "table.npy", TABLE)
    (folder / "run.toml").write_text(RUN_FILE.format(potential=potential, seed=seed))
    return folder / "run.toml"


def undisturbed(folder: Path, steps: int) -> Chain:
    """Return the chain of the run in a folder that nothing happens to, made in this process, in one go."""
    out = folder / "undisturbed"
    sk.run(folder / "run.toml", out, steps=steps, products=False, progress=False)
    return read_chain_file(out / CHAIN)


def differs(found: Chain, wanted: Chain) -> str:
    """Return what differs between two chains as far as both go, bit for bit; empty if nothing does."""
    steps = min(len(found.chain), len(wanted.chain))
    for name in ("chain", "log_prob", "blobs") if steps else ():
        if getattr(found, name)[:steps].tobytes() != getattr(wanted, name)[:steps].tobytes():
            return name
    return ""


class Disturbed:
    """One command in a process and a session of its own.

    Parameters
    ----------
    folder
        Where it is called.
    arguments
        Those of ``streamkit``.
    before
        Called in the new process first: it may take something away from it.
    cold
        Whether it is a new interpreter, whose steps are read off its files.
    """

    def __init__(
        self, folder: Path, *arguments: str, before: Callable[[], None] | None = None, cold: bool = False
    ) -> None:
        self.began, self._told = time.monotonic(), b""
        self._arguments, self._folder, self._before = arguments, folder, before
        self._shared = mmap.mmap(-1, 8)
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        if cold:
            process: Any = subprocess.Popen(
                [sys.executable, "-m", "streamkit", *arguments], cwd=folder, stdin=subprocess.DEVNULL,
                stdout=self._write, stderr=self._write, start_new_session=True,
            )  # fmt: skip
            self._status = process.poll
        else:
            process = multiprocessing.get_context("fork").Process(target=self._call)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # of threads of linear algebra
                process.start()
            self._status = lambda: process.exitcode
        self.pid = process.pid
        os.close(self._write)

    def _call(self) -> None:
        os.setsid()
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # it ends with this process, on Linux: PR_SET_PDEATHSIG
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
        for number in (1, 2):
            os.dup2(self._write, number)
        os.closerange(3, 100)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.chdir(self._folder)
        append = ChainFile.append

        def told(chain: ChainFile, *args: Any) -> None:
            append(chain, *args)
            self._shared[:] = struct.pack("q", chain.iteration)

        ChainFile.append = told  # type: ignore[method-assign]
        if self._before is not None:
            self._before()
        sys.argv = ["streamkit", *self._arguments]
        main()

    @property
    def steps(self) -> int:
        """Steps that the run has taken as finished."""
        return int(struct.unpack("q", self._shared[:])[0])

    @property
    def status(self) -> int | None:
        """The exit status, None while it runs; that of a signal is negative."""
        result: int | None = self._status()
        return result

    @property
    def text(self) -> str:
        """What it has printed."""
        with suppress(BlockingIOError):
            while more := os.read(self._read, 1 << 16):
                self._told += more
        return self._told.decode(errors="replace")

    @property
    def workers(self) -> list[int]:
        """Its processes."""
        with suppress(OSError):
            return [int(pid) for pid in Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()]
        return []

    def close_pipe(self) -> None:
        """Read nothing any more."""
        os.close(self._read)
        self._read = os.open(os.devnull, os.O_RDONLY)

    def wait(self, enough: Callable[[], bool], limit: float) -> bool:
        """Wait until it is enough or the command has ended; False if neither is so within so many seconds."""
        end = time.monotonic() + limit
        while not enough() and self.status is None:
            if time.monotonic() > end:
                return False
            time.sleep(0.005)
        return True

    def signal(self, number: int, group: bool = False) -> None:
        """Send a signal to it, or to its workers too, as a terminal does."""
        with suppress(ProcessLookupError):
            (os.killpg if group else os.kill)(self.pid, number)

    def ended(self, limit: float) -> bool:
        """Wait for its end and for that of its workers; if they take longer end them, and return False."""
        fine = self.wait(lambda: False, limit)
        end = time.monotonic() + limit
        while fine and time.monotonic() < end:
            try:
                os.killpg(self.pid, 0)
            except ProcessLookupError:
                return True
            time.sleep(0.01)
        self.signal(signal.SIGKILL, group=True)
        self.wait(lambda: False, 60)
        return False
