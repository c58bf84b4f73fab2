"""What a run keeps of its calls and steps, in memory or in the files of its directory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from streamkit.sample.store.chain import CHAIN
from streamkit.sample.store.chain_file import ChainFile, ChainMemory
from streamkit.sample.store.evaluation_cache import CALLS, SMALL_CALLS, EvaluationCache
from streamkit.stream import Array


@dataclass(frozen=True)
class Storage:
    """The evaluations of a run, and the steps of its chain; by default in memory."""

    evaluations: EvaluationCache = field(default_factory=EvaluationCache)
    small: EvaluationCache = field(default_factory=EvaluationCache)  # those of small streams
    chain: ChainMemory = field(default_factory=ChainMemory)
    is_chain: bool = False  # whether the samples are the steps of a chain; else they are weighted


def chain_storage(directory: Path | None, notes: Mapping[str, Any], resumes: bool) -> Storage:
    """Return the storage of a chain with notes beside it; one that ``resumes`` continues the steps in the directory.

    Raises ChainError for a chain that cannot be read.
    """
    chain = ChainMemory() if directory is None else ChainFile(directory / CHAIN)
    chain.note(**notes)
    if isinstance(chain, ChainFile) and resumes:
        chain.load()
    return Storage(chain=chain, is_chain=True)


def calls_storage(directory: Path | None, digest: str, d: int, values: Array, small: bool) -> Storage:
    """Return the storage of a sampler that repeats its calls when it resumes: those in the directory cost nothing.

    The run with this digest has d parameters and the data ``values`` (m,), NaN where one is not compared. Calls with
    ``small`` streams are stored too if asked for.

    Raises ChainError for calls that cannot be read, or of a run with another digest.
    """
    if directory is None:
        return Storage()
    small_calls = directory / SMALL_CALLS if small else None
    full, few = (EvaluationCache(path, digest, d, values) for path in (directory / CALLS, small_calls))
    return Storage(full, few)
