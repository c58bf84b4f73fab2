"""The citations of a run file as BibTeX: its components, its sampler and the packages it uses."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

from streamkit.components import Component, Preset
from streamkit.distribution import VERSION
from streamkit.report.latex import latex_escaped
from streamkit.runfile import Spec

ALWAYS = {
    "Harris2020": "NumPy",
    "Virtanen2020": "SciPy",
    "Lam2015": "numba, the compiled loop",
    "Astropy2013": "astropy",
    "Astropy2018": "astropy",
    "Astropy2022": "astropy",
    "Hunter2007": "matplotlib, the pictures",
}
FIT = {"ForemanMackey2016": "corner, a picture of a fit"}


@cache
def bibliography() -> dict[str, str]:
    """Return the entries that streamkit brings, by key."""
    text = files("streamkit.report").joinpath("references.bib").read_text(encoding="utf-8")
    entries = [f"@{part.strip()}" for part in re.split(r"^@", text, flags=re.MULTILINE)[1:]]
    return {key_of(entry): entry for entry in entries}


def key_of(entry: str) -> str:
    """Return the key of a BibTeX entry."""
    return entry.partition("{")[2].partition(",")[0].strip()


def cited(spec: Spec, published: Mapping[str, str] | None = None) -> str:
    """Return BibTeX of exactly what a run file uses, each entry below a comment that says what for.

    ``published`` are the references of published values that are shown beside a run, such as "Erkal+ 2019", each with
    the key of its entry, or with an empty text: it is then a note.

    A component's `bibtex` is used unchanged. Without one, its `reference` is looked up among streamkit's entries; a
    reference without an entry becomes a note. A run file without free parameters has no sampler.
    """
    uses: dict[str, list[str]] = {}
    entries = dict(bibliography())
    used = [(_of_component(cls), f"{path} = {cls.kind} ({supplier})") for path, cls, supplier in spec.components()]
    if (preset := _preset_of(spec)) is not None:
        what = f"the potentials of the preset {preset.name!r}: {preset.reference}"
        used.append((_named(preset.reference, f"preset-{preset.name}"), what))
    for number, (reference, key) in enumerate((published or {}).items(), 1):
        entry = entries.get(key) or _note(key := f"published-{number}", reference)
        used.append(([(key, entry)], f"published values of the host: {reference}"))
    for papers, what in used:
        for key, entry in papers:
            entries.setdefault(key, entry)
            uses.setdefault(key, []).append(what)
    software = dict(ALWAYS)
    if spec.names:
        software |= spec.sampler.cites() | FIT
    for key, what in software.items():
        uses.setdefault(key, []).append(what)
    head = f"% What {spec.source} uses. The sources of your data are not in it: cite them too."
    parts = [f"{head}\n{_own(spec)}"]
    parts += ["\n".join([*(f"% {what}" for what in dict.fromkeys(whats)), entries[key]]) for key, whats in uses.items()]
    return "\n\n".join(parts) + "\n"


def _preset_of(spec: Spec) -> Preset | None:
    """Return the preset that a run file names, or whose sections it has.

    Older resolved run files lack the name of the preset. A run file without the name has a preset if it has all
    sections of the preset, of the same kinds, with more than half of the numbers: the user may have changed the other
    numbers, or given them priors.
    """
    presets, potentials = spec.registry.presets, spec.sections.potentials
    if (name := spec.document["potential"].get("preset")) is not None:
        return presets.get(name)

    def share(preset: Preset) -> float:
        sections = preset.sections
        if any(key not in potentials or potentials[key].cls.kind != sections[key]["kind"] for key in sections):
            return 0.0
        same = [
            getattr(potentials[key].centre, field) == value
            for key, section in sections.items()
            for field, value in section.items()
            if field != "kind"
        ]
        return float(sum(same) / len(same))

    best = max(presets.values(), key=share, default=None)
    return best if best is not None and share(best) > 0.5 else None


def _own(spec: Spec) -> str:
    return (
        "@misc{streamkit,\n  author = {{The streamkit developers}},\n  title = {{streamkit}},\n"
        f"  version = {{{VERSION}}},\n  note = {{run digest {spec.digest()}}},\n}}"
    )


def _of_component(cls: type[Component]) -> list[tuple[str, str]]:
    """Return keys and entries of the papers that a component follows."""
    if cls.bibtex.strip():
        parts = re.split(r"^\s*@", cls.bibtex, flags=re.MULTILINE)[1:]
        return [(key_of(part), f"@{part.strip()}") for part in parts]
    return _named(cls.reference, f"{cls.role}-{cls.kind}") if cls.reference else []


def _named(reference: str, other: str) -> list[tuple[str, str]]:
    """Return keys and entries of the papers in a reference; a note of the key ``other`` if none of them is known."""
    key = other.replace("_", "-")
    papers = [(key, entry) for key, entry in bibliography().items() if _is_named(entry, reference)]
    return papers or [(key, _note(key, reference))]


def _note(key: str, reference: str) -> str:
    return f"@misc{{{key},\n  note = {{{latex_escaped(reference)}}},\n}}"


def _is_named(entry: str, reference: str) -> bool:
    """Return whether a reference names an entry: by journal, volume and page, or a book by its title or authors."""
    field = dict(re.findall(r"^\s*(\w+) = \{+(.*?)\}+,$", entry, flags=re.MULTILINE))
    if "journal" in field:
        place = re.escape(f"{field['journal']} {field['volume']}, {field['pages']}")
        return re.search(rf"(?<!\w){place}(?!\w)", reference) is not None
    families = [author.partition(",")[0] for author in field["author"].split(" and ")]
    named = f"{' & '.join(families)} {field['year']}"
    return entry.startswith("@book") and (field["title"] in reference or named in reference)
