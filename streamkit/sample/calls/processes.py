"""Worker processes with a pipe each. A death is detected at once, holds no lock, and its call is repeated."""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import pickle
import signal
import threading
import warnings
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.util import Finalize
from time import monotonic
from typing import Any

from streamkit.errors import StreamkitError, message_of
from streamkit.sample.calls.threads import one_thread

TRIES = 3  # number of worker deaths in a call after which the call is abandoned
DEATHS = 30  # number of consecutive worker deaths, also before a call begins, after which a call is abandoned
BEGUN = b"begun"  # message of a worker that begins a call
POLL = 1.0  # seconds between two checks of silent processes
# Seconds after which a worker that has not begun its call counts as blocked: a fork may inherit a lock.
WAKING = 120.0
PATIENCE = 2.0  # seconds in which an idle worker must end by itself


class WorkerDied(StreamkitError):  # noqa: N818  a public name
    """Worker processes died (killed, or out of memory) again and again in the same call."""

    def __init__(self, message: str = "") -> None:
        super().__init__(
            message
            or "worker processes died again and again in the same call (killed, or out of memory): try fewer "
            "workers, or fewer particles"
        )


class CallTimeout(StreamkitError):  # noqa: N818  a public name
    """A call took longer than its limit."""


@dataclass(eq=False)
class _Call:
    future: _Result
    content: bytes
    tries: int = 0


@dataclass(eq=False)
class _Worker:
    process: Any
    pipe: Connection
    call: _Call | None = None
    begun: bool = False
    since: float = field(default_factory=monotonic)


class _Result(Future[Any]):
    """A result whose executor works while the caller waits for it, without a thread."""

    def __init__(self, executor: Processes) -> None:
        super().__init__()
        self._executor = executor

    def result(self, timeout: float | None = None) -> Any:
        """Return the result or raise the error of the call; TimeoutError after ``timeout`` seconds without one."""
        self._executor.work(self.done, timeout)
        return super().result(0)


class Processes(Executor):
    """A `concurrent.futures.Executor` of processes that may die at any time.

    The processes of the standard library share one queue. A process that is killed while it holds the lock of the queue
    blocks all others, and the interrupted call is unknown. Here each process has its own pipe. No thread is started, so
    that a replacement can be forked at any time. Work proceeds while the caller waits in ``result`` or `work`;
    `concurrent.futures.wait` and ``as_completed`` would wait for ever.

    The processes are forked at once where the platform has fork. That takes milliseconds and does not import the
    caller's main module. They ignore SIGINT and SIGTERM, which their parent handles, and end with their parent.
    """

    def __init__(
        self,
        count: int,
        initializer: Callable[..., object] = lambda: None,  # called in each process first
        initargs: tuple[Any, ...] = (),
        limit: float = math.inf,  # longest call in seconds; then its process is killed, and `CallTimeout` raised
    ) -> None:
        method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
        self._context: Any = multiprocessing.get_context(method)
        self._prepare, self.limit = (initializer, initargs), limit
        self._calls: deque[_Call] = deque()
        self._deaths = 0
        self._workers: list[_Worker] = []
        for _ in range(count):
            self._workers.append(self._start())
        self._end = Finalize(self, _end, args=(self._workers,), exitpriority=10)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a process call the function; it and its arguments are pickled."""
        if not self._end.still_active():
            raise RuntimeError("these processes have been shut down")
        call = _Call(_Result(self), pickle.dumps((fn, args, kwargs)))
        self._calls.append(call)
        self._dispatch()
        return call.future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, after their work is done or at once."""
        if self._end.still_active():
            if not cancel_futures:
                self.work(lambda: not self._calls and not any(worker.call for worker in self._workers))
            calls = [*self._calls, *(worker.call for worker in self._workers if worker.call)]
            self._end()
            for call in calls:
                if not call.future.cancel() and not call.future.done():
                    call.future.set_exception(StreamkitError("the processes were shut down"))
            self._calls.clear()

    def work(self, enough: Callable[[], bool], timeout: float | None = None) -> None:
        """Distribute calls and receive results until ``enough()``, until all is done, or for ``timeout`` seconds."""
        end = math.inf if timeout is None else monotonic() + timeout
        while not enough():
            self._dispatch()
            busy = [worker for worker in self._workers if worker.call]
            now = monotonic()
            if not busy or now >= end:
                return
            soon = min(end, now + POLL, *(self._due(worker) for worker in busy)) - now
            ready = wait([item for w in busy for item in (w.pipe, w.process.sentinel)], max(soon, 0.0))
            for worker in busy:
                call = worker.call
                if call is None:
                    continue
                if worker.pipe in ready or worker.process.sentinel in ready or worker.process.exitcode is not None:
                    self._receive(worker, call)
                elif monotonic() >= self._due(worker):
                    self._overdue(worker, call)

    def _due(self, worker: _Worker) -> float:
        """Return the time at which a busy worker has to end."""
        return worker.since + (self.limit if worker.begun else WAKING)

    def _start(self) -> _Worker:
        mine, theirs = self._context.Pipe()
        others = (
            [mine, *(worker.pipe for worker in self._workers)] if self._context.get_start_method() == "fork" else []
        )
        process = self._context.Process(target=_serve, args=(theirs, others, *self._prepare))
        with warnings.catch_warnings():
            # Python 3.12 also warns of the threads of numpy's linear algebra, which survive a fork
            warnings.filterwarnings("ignore", message=".*fork", category=DeprecationWarning)
            process.start()
        theirs.close()  # the pipe then ends with the process
        return _Worker(process, mine)

    def _dispatch(self) -> None:
        """Send a call to every idle process."""
        for worker in list(self._workers):
            while self._calls and worker.call is None and worker in self._workers:
                call = self._calls.popleft()
                if not call.future.running() and not call.future.set_running_or_notify_cancel():
                    continue
                try:
                    worker.pipe.send_bytes(call.content)
                except OSError:  # the worker died while it was idle: this is no failure of the call
                    self._calls.appendleft(call)
                    self._replace(worker)
                else:
                    worker.call, worker.begun, worker.since = call, False, monotonic()

    def _receive(self, worker: _Worker, call: _Call) -> None:
        """Receive a result, or detect the death of the worker."""
        try:
            if not worker.pipe.poll():  # the worker may still be dying, or one of its children may keep the pipe open
                if worker.process.exitcode is None:
                    return
                raise EOFError
            reply = worker.pipe.recv_bytes()
            if reply == BEGUN:
                worker.begun, worker.since = True, monotonic()
                return
            fine, value = pickle.loads(reply)  # noqa: S301  our own process
        except Exception:
            self._died(worker, call)
            return
        worker.call, self._deaths = None, 0
        if fine:
            call.future.set_result(value)
        else:
            call.future.set_exception(value)

    def _died(self, worker: _Worker, call: _Call) -> None:
        call.tries += worker.begun
        self._deaths += 1
        self._replace(worker)
        if call.tries < TRIES and self._deaths < DEATHS:
            self._calls.appendleft(call)
        else:
            call.future.set_exception(WorkerDied())

    def _overdue(self, worker: _Worker, call: _Call) -> None:
        if not worker.begun:
            self._died(worker, call)
            return
        self._replace(worker, quietly=True)
        call.future.set_exception(CallTimeout(f"a call took longer than {self.limit:g} s"))

    def _replace(self, worker: _Worker, quietly: bool = False) -> None:
        """Kill a process, and start another one in its place."""
        worker.pipe.close()
        worker.process.kill()
        worker.process.join()
        if not quietly:
            code = worker.process.exitcode
            how = f"signal {-code}" if code < 0 else f"exit status {code}"
            logging.getLogger("streamkit").warning(
                "Worker process %d died (%s: killed, or out of memory?); another one takes its place and makes its "
                "call again.", worker.process.pid, how,
            )  # fmt: skip
        place = self._workers.index(worker)
        del self._workers[place]  # the new process must not inherit its closed pipe
        self._workers.insert(place, self._start())


def _end(workers: list[_Worker]) -> None:
    """End the processes: idle ones end by themselves, busy ones are killed."""
    for worker in workers:
        worker.pipe.close()
        if worker.call is not None:
            worker.process.kill()
    end = monotonic() + PATIENCE
    for worker in workers:
        worker.process.join(max(end - monotonic(), 0.0))
        worker.process.kill()
        worker.process.join()


def _serve(pipe: Connection, others: list[Connection], initializer: Callable[..., object], initargs: Any) -> None:
    """Run a worker: make calls until the pipe ends. Threads that a plugin started are not waited for."""
    for other in others:
        other.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles signals
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    try:
        one_thread()
        initializer(*initargs)
        while True:
            fn, args, kwargs = pickle.loads(pipe.recv_bytes())  # noqa: S301  our own parent
            pipe.send_bytes(BEGUN)
            try:
                reply = True, fn(*args, **kwargs)
            except BaseException as error:
                reply = False, _sendable(error)
            pipe.send_bytes(pickle.dumps(reply))
    except (EOFError, OSError):
        os._exit(0)
    except BaseException:
        os._exit(1)


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _sendable(error: BaseException) -> Exception:
    """Return an error that can be pickled and does not end the parent: the error itself, or its message."""
    if isinstance(error, Exception):
        try:
            pickle.loads(pickle.dumps(error))  # noqa: S301
        except Exception:
            return StreamkitError(f"{type(error).__name__}: {message_of(error)}")
        return error
    return StreamkitError(f"a component raised {type(error).__name__}: {message_of(error)}".rstrip(": "))
