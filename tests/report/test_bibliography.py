"""What to cite: every reference of ours is an entry, and a run file cites what it uses and nothing else."""

import re
from pathlib import Path

import pytest
from astropy.table import QTable
from commands import call, refused
from runfiles import BASE, PLUGIN, changed

import streamkit as sk
from streamkit.builtin.samplers.ensemble.sampler import MOVES, Emcee
from streamkit.components import load_registry
from streamkit.fit import published_with
from streamkit.fit.show import literature
from streamkit.fit.show.literature import MILKY_WAY, keys_of, read_literature
from streamkit.report import save_table
from streamkit.report.bibliography import ALWAYS, FIT, _is_named, bibliography, cited
from streamkit.runfile import to_toml

ENTRIES = bibliography()
MILKY_WAY_FILE = Path(literature.__file__).with_name("milky_way.ecsv")
CLASSES = [
    entry.cls
    for kinds in load_registry().entries.values()
    for entry in kinds.values()
    if entry.cls.reference and entry.cls.__module__.split(".")[0].startswith("streamkit")
]
OURS = sorted({cls.reference for cls in CLASSES if not cls.bibtex})
WITH_THEIR_OWN = [cls for cls in CLASSES if cls.bibtex]


def keys(text):
    return re.findall(r"^@\w+\{([^,]+),$", text, re.MULTILINE)


def test_every_entry_is_whole_and_has_its_own_key():
    for key, entry in ENTRIES.items():
        assert entry.count("{") == entry.count("}"), key
        assert re.search(r"^  author = ", entry, re.MULTILINE), key
        assert re.search(rf"^  year = \{{{key[-4:]}\}},$", entry, re.MULTILINE), key
    cites = [key for moves in MOVES for key in Emcee(moves=moves).cites()]
    assert {*ALWAYS, *FIT, *cites} <= ENTRIES.keys()


@pytest.mark.parametrize("reference", OURS)
def test_every_paper_that_our_components_name_has_an_entry(reference):
    named = len(re.findall(r"(?<!\d)(?:1[89]|20)\d\d(?!\d)(?=, |\))", reference))
    assert sum(_is_named(entry, reference) for entry in ENTRIES.values()) == named > 0


@pytest.mark.parametrize("cls", WITH_THEIR_OWN)
def test_a_component_with_its_own_entries_names_them_in_its_reference(cls):
    entries = [
        dict(re.findall(r"(\w+) = \{*([^{}\n]+?)[},]*$", part, re.MULTILINE)) for part in cls.bibtex.split("@")[1:]
    ]
    places = [f"{e['year']}, {e['journal']} {e['volume']}, {e['pages'].partition('--')[0]}" for e in entries]
    assert any(place in cls.reference for place in places), places


def test_what_is_used_is_cited_and_nothing_else():
    text = cited(sk.load(BASE))
    assert {"streamkit", "Gibbons2014", "Plummer1911", *ALWAYS, *FIT, "terBraak2006"} <= set(keys(text))
    assert not {"Hernquist1990", "Goodman2010", "Kuepper2012"} & set(keys(text))
    assert len(keys(text)) == len(set(keys(text)))
    above = text[: text.index("@article{Gibbons2014")].rpartition("\n\n")[2]
    assert "potential = tf" in above
    assert "stripping = mlcs" in above
    assert sk.load(BASE).digest() in text


def test_a_run_file_without_free_parameters_has_no_sampler():
    document = changed("potential", "v0", 220)
    document["progenitor"] |= {"mass": 5e8, "lookback": 3}
    document["stripping"]["sigma"] = 10
    assert not set(FIT) & set(keys(cited(sk.load(document))))


def cored(tmp_path, lines):
    (tmp_path / "cored.py").write_text(PLUGIN.replace('    kind = "cored"\n', f'    kind = "cored"\n{lines}'))
    document = changed("potential", {"kind": "cored", "v": 200})
    path = tmp_path / "run.toml"
    path.write_text(to_toml({"plugins": ["./cored.py"], **document}))
    return path


def test_a_strangers_reference_is_a_note_and_its_bibtex_is_taken_as_it_is(tmp_path):
    text = call("cite", cored(tmp_path, '    reference = "Doe & Roe 2031, J. Imag. 1, 2_3"\n')).output
    assert r"note = {Doe \& Roe 2031, J. Imag. 1, 2\_3}" in text
    entries = "@article{Doe2031, year = 2031}\n\n@book{Roe2032,\n  title = {Us}\n}"
    text = call("cite", cored(tmp_path, f'    bibtex = """{entries}"""\n')).output
    assert "@article{Doe2031, year = 2031}" in text
    assert "@book{Roe2032,\n  title = {Us}\n}" in text
    assert "@misc{potential-cored" not in text


def test_a_directory_without_a_run_is_refused(tmp_path):
    assert "manifest.json" in refused("cite", tmp_path)


def test_the_model_behind_a_preset_is_cited_by_its_name():
    host = {"preset": "gala_v2", "halo": {"mass": {"uniform": [4e11, 7e11]}}}
    document = changed("potential", host)
    spec = sk.load(document)
    again = sk.load(spec.document)
    for each in (spec, again):
        text = cited(each)
        assert {"PriceWhelan2017", "Eilers2019", "DarraghFord2023"} <= set(keys(text))
        assert "the potentials of the preset 'gala_v2'" in text
        assert "gala_v1" not in text
    assert again.digest() == spec.digest()


def test_a_preset_without_its_name_is_cited_by_its_sections():
    """As in a directory of a run that was made before resolved run files kept the name."""
    named = sk.load(changed("potential", {"preset": "gala_v2", "halo": {"mass": {"uniform": [4e11, 7e11]}}}))
    sections = {name: section for name, section in named.document["potential"].items() if name != "preset"}
    spec = sk.load(changed("potential", sections))
    assert set(keys(cited(spec))) == set(keys(cited(named)))
    assert "the potentials of the preset 'gala_v2'" in cited(spec)
    assert spec.digest() == named.digest()
    numbers = [(name, field) for name, section in sections.items() for field in section if field in ("mass", "a", "rs")]
    other = {name: dict(section) for name, section in sections.items()}
    for name, field in numbers:
        other[name][field] = 1.0
    assert "preset" not in cited(sk.load(changed("potential", other)))
    del sections["nucleus"]
    assert "preset" not in cited(sk.load(changed("potential", sections)))


def test_published_values_beside_a_run_are_cited(tmp_path):
    """Every reference of the table that streamkit brings has its entry; one of a user's own table is a note."""
    table = read_literature(MILKY_WAY)
    keys_there = keys_of(table)
    assert set(keys_there.values()) <= ENTRIES.keys()
    for text, key in keys_there.items():
        entry = ENTRIES[key]
        assert text[-4:] in entry
        assert re.search(r"author = \{([^,]+),", entry)[1].replace("{\\'o}", "ó") == re.split(r"\+| &", text)[0]
        number = str(next(row["arxiv"] for row in QTable.read(MILKY_WAY_FILE) if row["reference"] == text))
        assert number in entry or key in ("Gibbons2014", "Erkal2019")
    own = table[:1].copy()
    own["reference"] = ["Erkal 2019, in prep."]
    assert set(keys_of(own).values()) == {""}
    text = cited(sk.load(BASE), keys_there | keys_of(own))
    assert "% published values of the host: Erkal+ 2019\n@article{Erkal2019" in text
    assert "note = {Erkal 2019, in prep.}" in text
    save_table(tmp_path / "literature.ecsv", table)
    assert published_with(tmp_path) == keys_there
    assert published_with(tmp_path / "none") == {}
