"""The errors streamkit raises on purpose. Each message says where, what was found and what is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class StreamkitError(Exception):
    """Base of every error that streamkit explains to its user."""


class SpecError(StreamkitError):
    """A run file (or the mapping given in its place) is not valid."""


class PluginError(StreamkitError):
    """A plugin could not be loaded, clashes with another, or breaks a component's contract."""


class ComponentError(StreamkitError):
    """A component failed while computing: its name, the reason and the parameters are in the message."""


class ChainError(StreamkitError):
    """An output directory or chain file cannot be used as asked."""


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


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Return ``" Did you mean 'x'?"`` for the closest allowed name, or an empty string."""
    close = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.5)
    return f" Did you mean {close[0]!r}?" if close else ""
