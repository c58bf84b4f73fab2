"""The engines that make calls: this process, worker processes, the ranks of an MPI job, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from streamkit.distribution import NAME
from streamkit.errors import StreamkitError
from streamkit.runfile import Engine


@contextmanager
def engine(settings: Engine) -> Iterator[int | Executor]:
    """Provide the workers of `Workers`: a number of processes, or an executor, which ends with the context.

    Raises StreamkitError without the package that it needs, or if it was launched wrongly.
    """
    if settings.kind == "mpi":
        with _mpi() as executor:
            yield executor
    elif settings.kind == "dask":
        with _dask(settings.workers, settings.scheduler) as executor:
            yield executor
    else:
        yield 1 if settings.kind == "serial" else settings.workers


def launcher(settings: Engine, executor: int | Executor | None = None) -> list[str]:
    """Return the first words of a command for an engine; for MPI these are the words of its launcher."""
    if settings.kind != "mpi":
        return ["streamkit"]
    ranks = slots(executor) + 1 if isinstance(executor, Executor) else 8
    return ["mpiexec", "-n", str(ranks), "python", "-m", "mpi4py.futures", "-m", "streamkit"]


def slots(executor: Executor) -> int:
    """Return the number of calls that an executor makes at a time; 2 if it has no such attribute."""
    for name in ("slots", "num_workers", "_max_workers"):
        if count := getattr(executor, name, 0):
            return int(count)
    return 2


def _package(module: str, extra: str) -> Any:
    try:
        return import_module(module)
    except (ImportError, RuntimeError) as error:  # mpi4py raises the latter without an MPI library
        reason = str(error).splitlines()[0]
        raise StreamkitError(
            f"engine {extra}: {module} cannot be imported ({reason}); pip install '{NAME}[{extra}]'"
        ) from None


@contextmanager
def _mpi() -> Iterator[Executor]:
    """The ranks of this job but the first, which is this one."""
    futures = _package("mpi4py.futures", "mpi")
    if getattr(import_module("mpi4py.futures._core"), "SharedPool", None) is None:
        command = " ".join([*launcher(Engine(kind="mpi")), "run", "RUN.toml", "--engine", "mpi"])
        raise StreamkitError(f"engine mpi: its ranks are not there, as it was launched in another way than `{command}`")
    with futures.MPIPoolExecutor() as executor:
        yield executor


@contextmanager
def _dask(workers: int, scheduler: str) -> Iterator[Executor]:
    """The workers of a running scheduler, or of a cluster on this machine, which replaces dead ones."""
    distributed = _package("distributed", "dask")
    try:
        client = (
            distributed.Client(scheduler, timeout=10)
            if scheduler
            else distributed.Client(n_workers=workers, threads_per_worker=1, dashboard_address=None)
        )
    except (OSError, ValueError) as error:
        raise StreamkitError(f"engine dask: no scheduler at {scheduler!r} ({error})") from None
    with client:
        executor = client.get_executor(pure=False)
        executor.slots = sum(client.nthreads().values())
        yield executor
