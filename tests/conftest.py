"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from matplotlib.figure import Figure
from PIL import Image
from runfiles import APOCENTRES, FIT, PUBLISHED, RUN, schema_with
from shortened import SEARCH, WHOLE_SEARCH, set_search, shorten_walks, take_few_steps

import streamkit as sk
from streamkit.cli.process import NEW_OBJECTS
from streamkit.components import load_registry
from streamkit.runfile import to_toml
from streamkit.sample import one_thread

collect_ignore = ["third_party"]  # a package of its own: test_third_party.py installs it and runs its test


# The interpreters that tests start, and the workers of xdist, read modules that another one has compiled.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Threads of linear algebra in several workers of xdist, and in processes that tests start, only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
one_thread()

# Imports and compilations make objects that stay: as in a command, searches for garbage among them are rare.
gc.set_threshold(NEW_OBJECTS)


# Files that take longest: with `--dist loadfile` they begin first, or one worker ends minutes after the others.
LONGEST = (
    "test_conformance.py", "test_populations.py", "test_emulator.py", "test_factored_run.py", "test_passages.py",
    "test_factored.py", "test_emulator_run.py", "test_moving_frame.py", "test_products.py", "test_families.py",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


def pytest_configure(config: pytest.Config) -> None:
    """Compile the loops in the first worker of xdist; the others wait, and read the machine code that it has saved.

    From a cold cache that takes a minute, which two workers that begin together would each take.
    """
    config.option.loadscopereorder = False  # xdist would begin with the files that have most tests
    if hasattr(config, "workerinput"):
        with FileLock(Path(tempfile.gettempdir()) / f"streamkit-{config.workerinput['testrunuid']}.lock"):
            spec = sk.load(FIT)
            sk.Posterior(spec).evaluate(spec.centre())


def pytest_unconfigure() -> None:
    """End the process without a search for garbage."""
    gc.freeze()


@pytest.fixture(autouse=True)
def hundred_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Text is as wide as the terminal, of which a test process may have any."""
    monkeypatch.setenv("COLUMNS", "100")


class Pictures:
    """Which pictures are rendered: those whose file names contain one of ``names``, or all."""

    def __init__(self) -> None:
        self.names: tuple[str, ...] = ()
        self.all = False

    @contextmanager
    def rendered(self, *names: str) -> Iterator[None]:
        """Render these pictures; all if no name is given."""
        before = self.names, self.all
        self.names, self.all = names, not names
        yield
        self.names, self.all = before


@pytest.fixture(autouse=True, scope="session")
def pictures() -> Iterator[Pictures]:
    """Every picture is made and its file written, but empty: rendering takes most of the time of a report.

    A test that looks at pictures is marked ``rendered``, with parts of their file names if it does not look at all.
    """
    chosen, render, pixel = Pictures(), Figure.savefig, BytesIO()
    Image.new("RGB", (1, 1), "white").save(pixel, format="png")

    def write(self: Figure, file: Any, **options: Any) -> None:
        if chosen.all:
            render(self, file, **options)
        elif not isinstance(file, str | Path):
            file.write(pixel.getvalue())
        elif any(name in Path(file).name for name in chosen.names):
            render(self, file, **options)
        elif Path(file).suffix == ".png":
            Path(file).write_bytes(pixel.getvalue())
        else:
            render(Figure(), file, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", write)
        yield chosen


@pytest.fixture(autouse=True)
def rendered_pictures(request: pytest.FixtureRequest, pictures: Pictures) -> Iterator[None]:
    """Render the pictures that the test's marker ``rendered`` names."""
    marker = request.node.get_closest_marker("rendered")
    if marker is None:
        yield
    else:
        with pictures.rendered(*marker.args):
            yield


@pytest.fixture
def short_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """For checks of run files that others look at: few trial streams."""
    monkeypatch.setattr("streamkit.study.preflight.draws.BUDGET", 0.5)


@pytest.fixture(autouse=True, scope="session")
def short_search() -> Iterator[None]:
    """Searches for a start are short: they take most of the time of a run of few steps.

    In processes that tests start they are as long as a user's.
    """
    with pytest.MonkeyPatch.context() as patch:
        set_search(patch, SEARCH)
        yield


@pytest.fixture
def whole_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search of users, for its own tests and for numbers that depend on it."""
    set_search(monkeypatch, WHOLE_SEARCH)


@pytest.fixture
def short_walks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short walks of the emulator, whose samples have the moments of its posterior roughly."""
    shorten_walks(monkeypatch)


@pytest.fixture
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some steps of the emulator, whose samples nobody looks at."""
    take_few_steps(monkeypatch)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt here and in new processes, where pytest was started with SIGINT ignored too.

    The background of a shell script is such a place.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def run_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small run file, alone in the working directory."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.toml"
    path.write_text(RUN)
    return path


@pytest.fixture
def fit_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The run file of `runfiles.FIT`, alone in the working directory."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "fit.toml"
    path.write_text(to_toml(FIT))
    return path


@pytest.fixture(scope="session")
def schema() -> dict[str, Any]:
    """The JSON Schema of run files with few potentials and all other components: that of all takes two seconds."""
    return schema_with(load_registry(), "hernquist", "logarithmic_halo")


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory, pictures: Pictures) -> Path:
    """The directory of a run of `runfiles.APOCENTRES` with 30 steps, all products and published values.

    To be read, or copied. The first worker of xdist that asks for it makes it for all.
    """
    place = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        place = place.parent
    out, made = place / "finished", place / "finished.made"
    with FileLock(place / "finished.lock"):
        if not made.exists():
            (place / "published.csv").write_text(PUBLISHED)
            results = sk.run(sk.load(APOCENTRES), out=out, steps=30, progress=False, products=False)
            with pictures.rendered():
                sk.fit.write_products(results, literature=place / "published.csv")
            made.touch()
    return out
