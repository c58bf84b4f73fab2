"""Exchanged columns of a table: the message asks for them if the exchange would fit."""

from __future__ import annotations

from pathlib import Path

import astropy.units as u
import pytest
from astropy.table import QTable

from streamkit.fields import Columns
from streamkit.fields.files import Files

PLACES = Columns(ra="deg", dec="deg").between("dec", -90, 90)
RIGHT = {"ra": [135.57, 140.2, 200.0], "dec": [-5.0, 10.0, 60.0]}


def message(value: object, folder: Path | None = None) -> str:
    with pytest.raises(ValueError, match="-90 to 90") as caught:
        PLACES.read(value, Files(folder) if folder else None)
    return str(caught.value)


def test_exchanged_right_ascension_and_declination_are_asked_for(tmp_path: Path) -> None:
    assert len(PLACES.read(RIGHT)) == 3
    swapped = {"ra": RIGHT["dec"], "dec": RIGHT["ra"]}
    wanted = "Are the columns 'dec' and 'ra' exchanged? All numbers of 'ra' are within -90 to 90"
    assert wanted in message(swapped)
    QTable({name: column * u.deg for name, column in swapped.items()}).write(tmp_path / "stars.ecsv")
    text = message("stars.ecsv", tmp_path)
    assert "column 'dec' of 'stars.ecsv': row 1 is 135.57 deg" in text
    assert wanted in text


def test_a_wrong_declination_alone_is_no_exchange() -> None:
    assert "exchanged" not in message(RIGHT | {"dec": [-5.0, 95.0, 60.0]})
