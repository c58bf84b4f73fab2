"""What a run keeps of its calls and steps, in memory or in the files of its directory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

from streamkit.runfile import Spec
from streamkit.sample.store.chain import CHAIN
from streamkit.sample.store.chain_file import ChainFile, ChainMemory
from streamkit.sample.store.evaluation_cache import CALLS, EARLIER_CALLS, SMALL_CALLS, EvaluationCache
from streamkit.sample.store.journal import JOURNAL
from streamkit.sample.store.weighted import SAMPLES
from streamkit.stream import Array


@dataclass(frozen=True)
class Storage:
    """The evaluations of a run, and the steps of its chain; by default in memory."""

    evaluations: EvaluationCache = field(default_factory=EvaluationCache)
    small: EvaluationCache = field(default_factory=EvaluationCache)  # those of small streams
    earlier: EvaluationCache = field(default_factory=EvaluationCache)  # those of an earlier run, which serve this one
    chain: ChainMemory = field(default_factory=ChainMemory)
    is_chain: bool = False  # whether the samples are the steps of a chain; else they are weighted
    factors: Mapping[str, Storage] = field(default_factory=dict)  # those of each stream alone, by its name

    @property
    def all(self) -> list[Storage]:
        """All storages: that of the whole run, and those of the factors."""
        return [self, *self.factors.values()]

    @property
    def calls(self) -> int:
        """The number of evaluations, those of the factors included."""
        return sum(len(each.evaluations) for each in self.all)

    @property
    def files(self) -> list[str]:
        """The names of the files with evaluations: its own, and those of the factors."""
        names = {"": self} | dict(self.factors)
        return [calls_files(name)[0] for name, each in names.items() if len(each.evaluations)]

    @property
    def small_calls(self) -> int:
        """The number of evaluations of small streams, those of the factors included."""
        return sum(len(each.small) for each in self.all)

    @property
    def reasons(self) -> dict[str, int]:
        """Evaluations without a likelihood, by reason."""
        return dict(sum((Counter(each.evaluations.reasons) for each in self.all), Counter()))

    def write(self) -> None:
        """Write all evaluations to the disk; ChainError if it is full."""
        for each in self.all:
            each.small.write()
            each.evaluations.write()


def chain_storage(directory: Path | None, notes: Mapping[str, Any], resumes: bool) -> Storage:
    """Return the storage of a chain with notes beside it; one that ``resumes`` continues the steps in the directory.

    Raises ChainError for a chain that cannot be read.
    """
    chain = ChainMemory() if directory is None else ChainFile(directory / CHAIN)
    chain.note(**notes)
    if isinstance(chain, ChainFile) and resumes:
        chain.load()
    return Storage(chain=chain, is_chain=True)


def calls_storage(
    directory: Path | None, digest: str, d: int, values: Array, small: bool, factor: str = ""
) -> Storage:
    """Return the storage of a sampler that repeats its calls when it resumes: those in the directory cost nothing.

    The run with this digest has d parameters and the data ``values`` (m,), NaN where one is not compared. Calls with
    ``small`` streams are stored too if asked for. Those of a factor have files of their own.

    Raises ChainError for calls that cannot be read, or of a run with another digest.
    """
    if directory is None:
        return Storage()
    calls, small_calls, earlier = calls_files(factor)
    paths = directory / calls, directory / small_calls if small else None, directory / earlier
    full, few, before = (EvaluationCache(path, digest, d, values) for path in paths)
    return Storage(full, few, before)


def is_calls(name: str) -> bool:
    """Return whether this is the name of a file of calls, with all particles or with few."""
    begin, _, end = name.partition(".")
    return any(begin == Path(each).stem and end.endswith("journal") for each in (CALLS, SMALL_CALLS, EARLIER_CALLS))


def stores_of(spec: Spec) -> tuple[str, ...]:
    """Return the names of all files of chains, samples and calls that a run of this spec may write."""
    calls = [name for factor in ("", *(each.name for each in spec.factors)) for name in calls_files(factor)]
    return (CHAIN, JOURNAL, SAMPLES, *calls)


def calls_files(factor: str = "") -> tuple[str, str, str]:
    """Return the names of the files of calls: with all particles, with few, of an earlier run; of a factor or a run."""
    name = f".{quote(factor, safe='')}" if factor else ""
    full, small, earlier = (each.replace(".", f"{name}.") for each in (CALLS, SMALL_CALLS, EARLIER_CALLS))
    return full, small, earlier
