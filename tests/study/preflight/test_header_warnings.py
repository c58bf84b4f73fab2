"""A table of another stream is named by check where its header names another frame."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import streamkit as sk
from streamkit.study.preflight.header_warnings import header_warnings, unread_warnings

EXAMPLES = Path(__file__).parents[3] / "examples"
PAL5 = np.radians([229.0128, -0.1082])  # Odenkirchen+ 2002, AJ 124, 1497: the cluster, the origin of phi1


def warnings_of(path: Path, **tables: str) -> list[str]:
    spec = sk.load(path)
    if tables:
        spec = sk.load(spec.document | {"observable": spec.document["observable"] | tables})
    return [text for inputs in spec.bind_all().streams.values() for text in header_warnings(spec, inputs)]


def test_a_table_of_pal_5_in_the_run_file_of_gd_1(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES / "gd1")
    (text,) = warnings_of(Path("gd1.toml"), phi2="../pal5/phi2.ecsv")
    assert text.startswith("observable.phi2: the header of '../pal5/phi2.ecsv' says")
    assert "that its frame is 'Pal5PriceWhelan18'" in text
    assert "the observable has 'GD1Koposov10'" in text
    phi1 = float(re.search(r"phi1 = (\S+) deg", text)[1])  # type: ignore[index]
    (place,) = re.findall(r"\((-?[\d.]+), (-?[\d.]+)\) deg by the first", text)
    ra, dec = np.radians([float(number) for number in place])
    cosine = np.sin(dec) * np.sin(PAL5[1]) + np.cos(dec) * np.cos(PAL5[1]) * np.cos(ra - PAL5[0])
    assert np.degrees(np.arccos(cosine)) == pytest.approx(abs(phi1), abs=0.1)


@pytest.mark.parametrize("name", ["gd1/gd1.toml", "pal5/pal5.toml", "gd1_pal5/gd1_pal5.toml"])
def test_tables_in_their_own_frames(name: str) -> None:
    assert warnings_of(EXAMPLES / name) == []


def test_proper_motions_by_the_names_of_gaia_are_not_left_out_in_silence() -> None:
    """The table of the tutorial has pmra and pmdec: without their names the positions alone would be compared."""
    document = sk.load(EXAMPLES / "gd1" / "gd1.toml").document
    file = str(EXAMPLES / "tutorials" / "gd1_members.ecsv")
    observable = {"kind": "track", "frame": "GD1Koposov10", "kernel": "3 deg", "members": file}

    def told(members: object) -> list[str]:
        spec = sk.load(document | {"observable": observable | {"members": members}})
        return unread_warnings(spec, spec.bind_all().streams["stream"])

    (text,) = told(file)
    assert text.startswith("observable.members: pmra, pmra_error, pmdec, pmdec_error of ")
    given = 'columns = { pm_ra_cosdec = "pmra", pm_ra_cosdec_error = "pmra_error", pm_dec = "pmdec", pm_dec_error = '
    assert given in text
    names = {"pm_ra_cosdec": "pmra", "pm_dec": "pmdec"}
    names |= {f"{ours}_error": f"{theirs}_error" for ours, theirs in names.items()}
    assert told({"file": file, "columns": names}) == []
