"""A preset: a published model of a galaxy, as named potentials that a run file may name together."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Preset:
    """A published model of a galaxy: ``preset = NAME`` in ``[potential]`` stands for its named potentials.

    It is no potential: the resolved run file holds its sections, so that each number may be changed or given a prior.

    Attributes
    ----------
    name
        What a run file calls it.
    reference
        The papers.
    sections
        Name -> section as a run file has it, with its ``kind``; numbers in the units of the fields.
    """

    name: str
    reference: str
    sections: Mapping[str, Mapping[str, Any]]

    def with_own(self, own: Mapping[str, Any]) -> dict[str, Any]:
        """Return the sections with a run file's own on top.

        One of a name that is there changes the fields it gives, or all of them if it names another kind; one of a
        new name is added.
        """
        merged: dict[str, Any] = copy.deepcopy({name: dict(section) for name, section in self.sections.items()})
        for name, section in own.items():
            known = merged.get(name, {})
            same = isinstance(section, Mapping) and section.get("kind", known.get("kind")) == known.get("kind")
            merged[name] = known | dict(section) if same else section
        return merged
