"""What a run prints: masses with a word where nothing was measured, numbers to the digits of their errors."""

import re

import numpy as np
import pytest
from runfiles import FIT

import streamkit as sk
from streamkit.fit import describe_results, write_samples
from streamkit.fit.history import measured_radius
from streamkit.fit.judge.chain import R_HAT
from streamkit.fit.show.export import measured
from streamkit.fit.show.figures import reach
from streamkit.fit.show.text import _without_empty, radii_in_reach
from streamkit.report import decimals, describe_measured


@pytest.fixture(scope="module")
def results(finished_run):
    return sk.load_results(finished_run)


def rows_of(text, title):
    block = next(part for part in text.split("\n\n") if part.startswith(title))
    return [re.split(r"\s{2,}", line.strip()) for line in block.splitlines()[1:]]


def test_a_column_of_dashes_is_left_out():
    rows = [("parameter", "unit", "tau", "n_eff"), ("a", "-", "3", "-"), ("b", "kpc", "-", "-")]
    assert _without_empty(rows) == [row[:3] for row in rows]
    assert _without_empty(rows[:1]) == rows[:1]


def test_masses_beyond_data_and_streams_are_marked(results):
    low, high = reach(results)
    rows = {row[0]: row[-1] for row in rows_of(describe_results(results), "mass of the host")[1:]}
    assert rows["200 kpc"].startswith("extrapolated")
    for radius, last in rows.items():
        inside = low <= float(radius.split()[0]) <= high
        assert ("extrapolated" in last) != inside
    assert "100 kpc" in rows
    assert radii_in_reach(results)[-1] <= high


def test_the_progress_shows_the_mass_where_the_data_are():
    both = FIT | {"observable": {"kind": "apocentres", "leading": [57, 5], "trailing": [112, 15]}}
    assert measured_radius(sk.load(both)) == 110  # the trailing apocentre, 112 kpc
    near = FIT | {"observable": {"kind": "apocentres", "leading": [31.4, 1]}}
    assert measured_radius(sk.load(near)) == 31


def test_effective_samples_are_not_shown_where_walkers_disagree(results):
    bad = results.r_hat > R_HAT.limits[1]
    assert bad.any()  # 30 steps of 6 walkers
    head, *rows = rows_of(describe_results(results), "parameters")
    assert ("n_eff" in head) == (not bad.all())
    for row, wrong in zip(rows, bad, strict=True):
        assert bad.all() or (row[-1] == "-") == wrong


@pytest.mark.parametrize(("error", "digits"), [(0.15, 2), (0.0042, 4), (3.0, 1), (27.0, 0), (1e9, 0), (0.0, 2)])
def test_errors_have_two_digits(error, digits):
    assert decimals(error) == digits


class Fine(sk.Observable):
    """Two data, one with a small noise."""

    kind = "fine_noise"

    def data(self):
        return np.array([1.234567, -12.0]), np.array([0.15, 3.0])

    def predict(self, stream):
        raise NotImplementedError


def test_data_and_noise_are_shown_to_their_digits():
    prediction = sk.Prediction(("a", "b"), np.array([1.1, -15.0]), np.array([0.0012, 0.4]) ** 2)
    rows = [re.split(r"\s{2,}", line.strip()) for line in describe_measured("x", [Fine()], prediction).splitlines()[2:]]
    assert rows[0] == ["a", "1.1000", "0.0012", "1.23 +- 0.15", "+0.9 sigma"]  # data minus model
    assert rows[1] == ["b", "-15.00", "0.4", "-12.0 +- 3.0", "+1.0 sigma"]


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ((230.04, 225.0, 236.0), "$230.0^{+6.0}_{-5.0}$"),
        ((5.2e8, 4.0e8, 7.1e8), r"$5.2^{+1.9}_{-1.2} \times 10^{8}$"),
        ((-2.441, -2.46, -2.41), "$-2.441^{+0.031}_{-0.019}$"),
    ],
)
def test_a_number_for_a_paper(numbers, text):
    assert measured(*numbers) == text


def test_the_table_for_a_paper(results, tmp_path):
    (path,) = write_samples(results, tmp_path / "table.tex")
    lines = path.read_text().splitlines()
    assert lines[0].startswith("% ")  # it has not converged
    body = [line for line in lines if line.count(" & ") == 2]
    assert len(body) == 1 + 2 + len(radii_in_reach(results))
    assert all(line.endswith(r" \\") and line.count("$") % 2 == 0 for line in body)
    assert body[1].startswith("$v_0$ & $2")
