"""The status of a run: its steps, whether it is running, its expected end, and the command that continues it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from streamkit.components import ChainSampler
from streamkit.errors import ChainError
from streamkit.fit.directory.claim import resume_command
from streamkit.fit.directory.integrity import (
    RUN_FILE,
    load_spec,
    read_chain,
    read_samples,
    run_file,
    warn_of_lost_calls,
)
from streamkit.fit.directory.manifest import manifest
from streamkit.fit.judge.verdicts import overall
from streamkit.fit.samples.draws import ENDED
from streamkit.fit.samples.results import Results, load_results
from streamkit.report import columns, is_locked, paragraph, seconds
from streamkit.runfile import DATA
from streamkit.sample import CHAIN, JOURNAL, SAMPLES, Chain, Weighted, calls_in, is_calls

KINDS = ("calls", "small_calls", "earlier_calls")  # how names of files of calls begin


def read_status(directory: Path, trust: bool = False) -> dict[str, Any]:
    """Return the status of a run, running or not, as values for JSON; None for a number that is unknown.

    Keys: state ("running", or `Results.status`), steps, calls and small_calls (of a sampler that makes no chain, with
    all and with few particles), streams (by name calls, small_calls, earlier_calls, and what the sampler said with its
    last samples, where each of several streams has calls of its own), most_steps, walkers, acceptance,
    effective_samples (the least), r_hat (the largest), verdict, note, last_alive and expected_end (seconds since 1970;
    the latter of a running run: it has converged, by the last look of its sampler, or reaches its number of steps or
    its time limit if that is sooner),
    and go_on (a command).

    Raises ChainError if there is no run, or if it has plugin files and no ``trust``.
    """
    options = manifest(directory)["options"]
    running = is_locked(directory)
    journals = [path for path in sorted(directory.iterdir()) if is_calls(path.name)]
    files = [*journals, *(path for name in (CHAIN, JOURNAL, SAMPLES) if (path := directory / name).exists())]
    status: dict[str, Any] = {
        "state": "running" if running else "unfinished",
        "steps": 0,
        "most_steps": options.get("steps"),
        "last_alive": max((path.stat().st_mtime for path in files), default=None),
        "go_on": resume_command(directory, options),
    }
    if not any(path.name in (CHAIN, JOURNAL) for path in files):
        counts = {path.name: calls_in(path) for path in journals}
        of_kind = Counter(dict.fromkeys(KINDS, 0))
        for name, count in counts.items():
            of_kind[name.partition(".")[0]] += count
        status |= {"calls": of_kind["calls"], "small_calls": of_kind["small_calls"]}
        if streams := _calls_of_each(counts):
            status["streams"] = streams
    has_run_file = (directory / RUN_FILE).exists()
    if has_run_file and not options["given"]:  # only Python can read a run with given classes
        load_spec(directory, trust=trust)
    try:
        results = load_results(directory, trust=trust)
    except ChainError as error:
        if has_run_file:
            run_file(directory, trust)
        if not any(path.name in (CHAIN, JOURNAL, SAMPLES) for path in files):
            return status
        status |= _bare(directory, running, str(error) if options["given"] else "")
        status["go_on"] = _go_on(directory, options, status)
        if status["steps"] and not options["given"]:
            raise  # there are samples, and something else is wrong
        return status
    if results.weighted is not None and status.get("calls"):
        warn_of_lost_calls(directory, results.weighted, status["calls"])
    for name, row in status.get("streams", {}).items():
        row["said"] = results.facts.get("data of the host" if name == DATA else f"stream {name}", "")
    steps = len(results.chain)
    level, sentence = overall(results.verdicts)
    status |= {
        "state": "running" if running else results.status,
        "steps": steps,
        "walkers": results.draws.record().get("walkers"),
        "acceptance": results.acceptance,
        "effective_samples": _plain(np.min(results.draws.trusted_ess)),
        "r_hat": _plain(np.max(results.r_hat)),
        "verdict": level,
        "sentence": sentence,
        "note": results.draws.note(),
    }
    status["go_on"] = _go_on(directory, options, status)
    if running and "walkers" in results.draws.record():
        status["expected_end"] = _expected_end(results, status, read_chain(directory).attributes)
    return status


def _go_on(directory: Path, options: dict[str, Any], status: Mapping[str, Any]) -> str:
    """Return the command that continues; a run that has reached its number of steps goes on to twice as many."""
    return resume_command(directory, options, 2 * status["steps"] if status["state"] == "steps" else None)


def _calls_of_each(counts: Mapping[str, int]) -> dict[str, dict[str, Any]]:
    """Return the calls of each of several streams by its name, from the calls of each file."""
    streams: dict[str, dict[str, Any]] = {}
    for file, count in counts.items():
        kind, _, name = file.removesuffix(".journal").partition(".")
        if name:
            row = streams.setdefault(unquote(name), dict.fromkeys(KINDS, 0) | {"said": ""})
            row[kind] = count
    return streams


def _bare(directory: Path, running: bool, why: str) -> dict[str, Any]:
    """Return the status of samples without their run file; ``why`` is given for a run with classes given in Python.

    ChainError for samples that cannot be read, unless the run is about to write them.
    """
    is_chain = any((directory / name).exists() for name in (CHAIN, JOURNAL))
    stored: Chain | Weighted
    try:
        stored = read_chain(directory) if is_chain else read_samples(directory)
    except ChainError:
        if running:
            return {}
        raise
    points = stored.chain if isinstance(stored, Chain) else stored.points
    bare: dict[str, Any] = {"steps": len(points)}
    if why and bare["steps"]:
        walkers = points.shape[1] if is_chain else None
        bare |= {"walkers": walkers, "sentence": "There is no verdict here.", "note": why}
        bare |= {} if running else {"state": stored.attributes.get("status", "unfinished")}
    return bare


def _expected_end(results: Results, status: dict[str, Any], attributes: dict[str, Any]) -> float | None:
    """Time when the run may end, as in its log: by the mean pace since the first step after a start or resumption."""
    since, first = attributes.get("since"), attributes.get("first", 0)
    steps, last, sampler = status["steps"], status["last_alive"], results.spec.sampler
    if since is None or steps <= first or status["most_steps"] is None or not isinstance(sampler, ChainSampler):
        return None
    most = sampler.model_copy(update={"steps": status["most_steps"]}).expected_steps(results.chain)
    end = float(last + (last - since) / (steps - first) * (most - steps))
    return min(end, attributes.get("deadline", 0.0) or np.inf)


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


STATES = {"running": "running now", "unfinished": "stopped before its end"}
STATES |= {status: f"ended {how}" for status, how in ENDED.items()}


def describe_status(directory: Path, status: dict[str, Any], now: float | None = None) -> str:
    """Return the result of `read_status` as text for a terminal, at a time in seconds since 1970."""
    now = time.time() if now is None else now
    rows = [("state", STATES[status["state"]])]
    weighted = "verdict" in status and status["walkers"] is None
    most = f" of at most {status['most_steps']}" if status["most_steps"] is not None else ""
    has_calls = bool(status.get("calls") or status.get("small_calls"))
    if weighted:
        rows.append(("samples", f"{status['steps']}"))
    elif not has_calls:
        rows.append(("steps", f"{status['steps']}{most}"))
    if has_calls:
        few = f", {status['small_calls']} with few" if status["small_calls"] else ""
        rows.append(("calls", f"{status['calls']} with all particles{few}"))
    if status["last_alive"] is not None:
        last = status["last_alive"]
        rows.append(("last alive", f"{_clock(last)}, {seconds(max(now - last, 0))} ago"))
    if status.get("expected_end") is not None:
        left = status["expected_end"] - now
        rows.append(("expected end", f"{_clock(status['expected_end'])}, in {seconds(max(left, 0))}"))
    for name, form in (("acceptance", ".2f"), ("effective_samples", ".0f"), ("r_hat", ".3f")):
        if status.get(name) is not None and not (weighted and name == "acceptance"):
            rows.append((name.replace("_", " ").replace("r hat", "R-hat"), f"{status[name]:{form}}"))
    parts = [f"{directory}\n{columns(rows)}"]
    if streams := status.get("streams"):
        parts.append("streams\n" + columns([_stream_row(name, row) for name, row in streams.items()]))
    if "note" in status:
        parts.append(paragraph(f"{status['sentence']} {status['note']}"))
    if status["state"] != "running":
        longer = ", with more steps" if status["state"] == "steps" else ""
        parts.append(f"to continue{longer}:\n  {status['go_on']}")
    return "\n\n".join(parts)


def _stream_row(name: str, row: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return the name of a stream, its calls by now, and what the sampler said of it with its last samples."""
    more = {"with few particles": row["small_calls"], "of an earlier run": row["earlier_calls"]}
    calls = ", ".join([f"{row['calls']} calls", *(f"{count} {what}" for what, count in more.items() if count)])
    return name, calls, row["said"] or "no samples yet"


def _clock(when: float) -> str:
    try:
        return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(when))
    except (OverflowError, ValueError, OSError):  # an impossible time, in a file that came from elsewhere
        return "an unknown time"
