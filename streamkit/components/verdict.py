"""Verdicts: the outcome of a check of a run, and the rule that turns a number into it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

FINE, LOOK, DO_NOT = LEVELS = ("fine", "look here", "do not use")  # from good to bad


@dataclass(frozen=True)
class Verdict:
    """The outcome of one check of a run.

    Attributes
    ----------
    subject
        The quantity that was checked.
    level
        "fine", "look here" or "do not use".
    value
        The value of the quantity, in a few characters.
    sentence
        The meaning of the value, and the next thing to do.
    rule
        The thresholds, and their source.
    """

    subject: str
    level: str
    value: str
    sentence: str
    rule: str


@dataclass(frozen=True)
class Check:
    """A quantity with two thresholds: `judge` turns a value of it into a `Verdict`.

    Attributes
    ----------
    subject
        The quantity.
    limits
        The last value that is "fine", and the last one that is not "do not use".
    rule
        The thresholds in words, and their source.
    larger_is_worse
        Whether values above the limits are bad; by default values below them are.
    """

    subject: str
    limits: tuple[float, float]
    rule: str
    larger_is_worse: bool = False

    def level(self, value: float) -> str:
        """Return the level of a value; NaN is "do not use"."""
        fine, usable = (value <= end if self.larger_is_worse else value >= end for end in self.limits)
        return FINE if fine else LOOK if usable else DO_NOT

    def judge(self, value: float, shown: str, sentences: Mapping[str, str]) -> Verdict:
        """Return the verdict on a value, which a page shows as ``shown``, with the sentence of its level."""
        level = self.level(value)
        return Verdict(self.subject, level, shown, sentences[level], self.rule)
