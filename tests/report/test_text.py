"""Text for a terminal: no word is broken, however narrow."""

import pytest

from streamkit.report import columns

ROWS = [
    ("parameter", "median", "68 %", "95 %", "unit"),
    ("progenitor.pm_phi1_cosphi2", "-12.345", "-12.5 to -12.1", "-12.9 to -11.9", "mas/yr"),
    ("potential.halo.log_concentration", "1.234", "1.1 to 1.3", "1 to 1.4", "-"),
]


@pytest.mark.parametrize("wide", [60, 70, 80, 90, 120])
def test_no_word_is_broken_and_no_cell_is_lost(wide, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(wide))
    text = columns(ROWS)
    words = text.split()
    assert sorted(words) == sorted(word for row in ROWS for cell in row for word in cell.split())
    if wide == 120:
        assert len(text.splitlines()) == 3


def test_a_row_of_a_table_in_a_pipe_is_one_line(monkeypatch):
    monkeypatch.delenv("COLUMNS")
    rows = [*ROWS, ("remark", "1", "1", "1", "a long one " * 20)]
    lines = columns(rows).splitlines()
    assert [line.split() for line in lines] == [" ".join(row).split() for row in rows]
    assert "".join(columns([])) == ""
