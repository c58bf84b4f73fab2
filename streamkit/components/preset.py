"""A preset: a published model of a galaxy, as named potentials that a run file may name together."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Preset:
    """A published model of a galaxy: ``preset = NAME`` in ``[potential]`` adds its named potentials to the host.

    A preset is no component: the resolved run file has its name and all its sections, so that each number can be
    changed or get a prior.

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

    def merged_with(self, sections: Mapping[str, Any]) -> dict[str, Any]:
        """Return the sections of the preset, changed and extended by those of a run file.

        A section with the name of a section of the preset replaces the fields that it gives, or the whole section if
        its kind differs. A section with a new name is added.
        """
        merged: dict[str, Any] = copy.deepcopy({name: dict(section) for name, section in self.sections.items()})
        for name, section in sections.items():
            published = merged.get(name, {})
            same = isinstance(section, Mapping) and section.get("kind", published.get("kind")) == published.get("kind")
            merged[name] = published | dict(section) if same else section
        return merged
