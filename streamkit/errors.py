"""The errors streamkit raises on purpose. Each message says where, what was found and what is allowed."""

from __future__ import annotations

import difflib
import errno
import signal
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path


class StreamkitError(Exception):
    """Base of every error that streamkit explains to its user."""


class SpecError(StreamkitError):
    """A run file (or the mapping given in its place) is not valid."""


class PluginError(StreamkitError):
    """A plugin could not be loaded, clashes with another, or breaks a component's contract."""


class ComponentError(StreamkitError):
    """A component failed while computing: its name, the reason and the parameters are in the message."""


class ChainError(StreamkitError):
    """An output directory or chain file cannot be used."""


class OutOfDomain(StreamkitError):  # noqa: N818  a statement about the parameters, not a fault
    """There is no stream, or no observable, at these parameters. The only error that becomes ln p = -inf.

    Parameters
    ----------
    reason
        A short constant sentence without numbers: runs count their rejections by it.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class Interrupted(StreamkitError):  # noqa: N818  a request, not a fault
    """The run was stopped by Ctrl-C or SIGTERM. The message says where the finished part is.

    Attributes
    ----------
    exit_status
        Exit status of a command: 130 after Ctrl-C, 143 after SIGTERM.
    """

    def __init__(self, message: str, signum: int = signal.SIGINT) -> None:
        super().__init__(message)
        self.exit_status = 128 + int(signum)


SHORTEST = 3  # letters of a name that names which begin with it are found by


MOST_NAMED = 3  # names that a hint has at most


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Return ``" Did you mean 'x'?"`` for the closest allowed name, or an empty string.

    A few names that have all words of the given one, or begin with it, are named together: 'pm_error' may be that of
    two columns, and 'gd-1' is 'GD1Koposov10'.
    """
    folded = {each.lower(): each for each in allowed}
    words = set(name.lower().split("_"))
    having = [each for key, each in folded.items() if words <= set(key.split("_"))]
    if len(words) > 1 and 1 < len(having) <= MOST_NAMED and name.lower() not in folded:
        return f" Did you mean {' or '.join(map(repr, having))}?"
    close = difflib.get_close_matches(name.lower(), folded, n=1, cutoff=0.75)
    if not close and len(name) >= SHORTEST:
        close = sorted((each for each in folded if _squeezed(each).startswith(_squeezed(name))), key=len)[:MOST_NAMED]
    close = close or difflib.get_close_matches(name.lower(), folded, n=1, cutoff=0.5)
    return f" Did you mean {' or '.join(repr(folded[each]) for each in close)}?" if close else ""


def _squeezed(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


def expect_file(path: Path) -> None:
    """Raise OSError for a directory, a pipe (reading it would block) or a device (it may have no end)."""
    try:
        mode = path.stat().st_mode  # one look: another process may remove the file at any time
    except OSError:  # reported when the file is opened
        return
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, f"it is a {'directory' if stat.S_ISDIR(mode) else 'device or pipe'}")


def printable(text: str) -> str:
    """Return a text without control characters, which a terminal would obey: a ``?`` in the place of each."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def message_of(error: BaseException) -> str:
    """Return the message of an exception; a class of exceptions in a plugin may fail to give one."""
    try:
        return str(error)
    except Exception:
        return "its message cannot be shown"


def brief(error: BaseException) -> str:
    """Return the message of a library's exception as one short line; some messages quote the whole file.

    For pydantic's exceptions it is the first fault: where, what is expected, what was found.
    """
    from pydantic import ValidationError  # here, for commands that read nothing

    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        where, found = ".".join(map(str, first["loc"])), f"{first['input']!r:.80}"
        told = "is missing" if first["type"] == "missing" else first["msg"].removeprefix("Value error, ")
        more = "" if told == "is missing" or found in told else f", found {found}"
        return printable(f"{f'{where}: ' if where else ''}{told}{more}")
    return printable(" ".join(message_of(error).split()))[:200] or type(error).__name__


@contextmanager
def blamed(component: str) -> Iterator[None]:
    """Turn any exception of a component (``stripping mlcs``) into a `ComponentError`.

    KeyboardInterrupt and streamkit's own errors pass. Changes of numpy's handling of floating-point errors are undone.

    Raises ComponentError with the component, the exception, and the function it came from; the exception is its cause.
    """
    from numpy import errstate  # here, for commands that compute nothing

    try:
        with errstate():
            yield
    except (StreamkitError, KeyboardInterrupt):
        raise
    except BaseException as error:
        text = f"{type(error).__name__} in {_culprit(error)}: {message_of(error)}".rstrip(": \n")
        raise ComponentError(f"{component} failed: {text}") from error


LIBRARIES = ("numpy", "scipy", "numba", "astropy", "pydantic", "contextlib")


def _culprit(error: BaseException) -> str:
    """Name the function in which an exception was raised: the innermost one outside installed libraries."""
    place = "a component"
    trace = error.__traceback__
    while trace is not None:
        code, module = trace.tb_frame.f_code, trace.tb_frame.f_globals.get("__name__", "")
        if module.split(".")[0] not in LIBRARIES:
            place = f"{module}.{code.co_qualname}"
        trace = trace.tb_next
    return place
