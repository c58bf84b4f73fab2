"""The page of a run: whole in itself, with the answer, the verdicts and what was run; and published values."""

import base64
import re
import shutil
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable, Table
from html_page import Page
from matplotlib.image import imread
from runfiles import FIT

import streamkit as sk
from streamkit.fit import write_products
from streamkit.fit.judge.verdicts import LEVELS, overall
from streamkit.fit.show.flattening import flattening
from streamkit.fit.show.literature import beside_literature, read_literature
from streamkit.fit.show.page import embedded, page_text

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture(scope="module")
def run(finished_run):
    """Return a small run with its products, and published values in its page."""
    return sk.load_results(finished_run)


@pytest.fixture(scope="module")
def page(run):
    return Page((run.directory / "report.html").read_text(encoding="utf-8"))


def test_the_page_needs_no_other_file_and_no_network(run, page):
    for tag, attributes in page.tags:
        assert tag not in ("script", "link", "iframe", "object")
        for name in ("src", "href"):
            if name in attributes:
                assert attributes[name].startswith(("data:image/png;base64,", "#")), attributes[name]
    css = (run.directory / "report.html").read_text(encoding="utf-8").split("</style>")[0]
    assert "url(" not in css
    assert "@import" not in css
    ids = {attributes.get("id") for _, attributes in page.tags}
    assert {a["href"][1:] for tag, a in page.tags if tag == "a"} <= ids


def test_the_page_shows_every_picture_and_says_what_it_is(run, page):
    assert "products that failed" not in QTable.read(run.directory / "diagnostics.ecsv").meta
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 8
    for attributes in pictures:
        assert attributes["alt"]
        pixels = imread(BytesIO(base64.b64decode(attributes["src"].partition(",")[2])), format="png")
        assert pixels[..., :3].std() > 0.02


def test_the_stars_of_a_catalogue_are_on_the_page(run, page, tmp_path):
    """A run of single stars has their picture in its directory; it stands in the answer, beside the streams."""
    there = shutil.copytree(run.directory, tmp_path / "run")
    shutil.copy(there / "best_stream.png", there / "members.png")
    shown = Page(page_text(sk.load_results(there)))
    pictures = [attributes["alt"] for tag, attributes in shown.tags if tag == "img"]
    assert len(pictures) == 9
    assert pictures[pictures.index("The stars of the catalogue by their probability to be a member") - 1].startswith(
        "The best sample"
    )
    assert "The numbers are in members.ecsv." in shown.text
    assert "members.ecsv" not in page.text


def test_what_a_reader_must_see_is_not_beyond_the_right_edge(run, page):
    """A mass is called extrapolated beside its radius, the first cell of a row; a long prior is wrapped, as text is."""
    html = (run.directory / "report.html").read_text(encoding="utf-8")
    first_cells = re.findall(r"<tr><td[^>]*>([\d.]+) kpc(<span[^>]*>extrapolated</span>)?</td>", html)
    assert {float(radius) for radius, _ in first_cells} >= {50.0, 100.0, 200.0}
    assert page.text.count("extrapolated") == sum(bool(word) for _, word in first_cells) > 0
    (prior,) = {tuple(words.split()) for words in re.findall(r'<td class="([^"]*prior[^"]*)">', html)}
    unbroken = " ".join(re.findall(r"([^{}]*){[^{}]*nowrap", html.split("</style>")[0]))
    assert "td.n" in unbroken
    assert not [word for word in prior if f"td.{word}" in unbroken]


def test_the_page_holds_the_answer(run, page):
    summary, masses = run.summary(), run.mass_profile([30, 50, 100, 200])
    for row in summary:
        assert row["parameter"] in page.text
        for column in ("median", "lo68", "hi68", "lo95", "hi95"):
            assert f"{row[column]:.4g}" in page.text
    for row in masses:
        assert f"{row['M'].to_value('1e11 Msun'):.2f}" in page.text
        assert f"{row['v_c'].to_value('km/s'):.0f}" in page.text


def test_the_page_holds_every_verdict_with_its_rule(run, page):
    found = run.verdicts
    level, sentence = overall(found)
    assert level == LEVELS[-1]  # 30 steps
    assert sentence in page.text
    assert run.draws.note() in page.text
    for verdict in found:
        for text in (verdict.subject, verdict.value, verdict.rule):
            assert text in page.text, text
        words = re.sub(r"\W+", " ", verdict.sentence)
        assert words.strip() in re.sub(r"\W+", " ", page.text)


def test_the_page_says_what_was_run(run, page):
    assert run.spec.digest() in page.text
    for path, cls, supplier in run.spec.components():
        assert {path, cls.kind, supplier} <= set(re.split(r"\s(?=\S)", page.text)) | {supplier}
        assert supplier in page.text
    assert '[potential]\nkind = "tf"' in "".join(page.words)
    for reason, count in run.reasons.items():
        assert f"{reason} {count}" in page.text


def test_published_values_stand_beside_the_runs_own(run, page):
    low, middle, high = np.percentile(run.profiles(np.array([100.0]))[0], [16, 50, 84])
    (row, _) = beside_literature(run, read_literature(run.directory / "literature.ecsv"))
    assert row["ours"] == pytest.approx(middle)
    facing = np.hypot(middle - low, 0.8e11) if middle > 4.1e11 else np.hypot(high - middle, 0.7e11)
    assert row["deviation"] == pytest.approx((middle - 4.1e11) / facing)
    assert "a <b>bold</b> guess" in page.text  # as text
    assert "4.10 +0.80 −0.70" in page.text
    assert f"{row['deviation']:+.1f} sigma" in page.text


def test_a_later_report_shows_the_published_values_too(run, tmp_path):
    before = (run.directory / "report.html").read_text(encoding="utf-8")
    out = shutil.copytree(run.directory, tmp_path / "run")
    (out / "report.html").unlink()
    write_products(out)
    assert "Gibbons+ 2014" in (out / "report.html").read_text(encoding="utf-8")
    assert len(before) > 50_000


FLATTENED = """quantity,radius,z,value,error_minus,error_plus,reference
q_Phi,12.5,6.7,0.95,0.04,0.04,Bovy+ 2016 at GD-1
q_Phi,8.4,16.8,0.94,0.05,0.05,Bovy+ 2016 at Pal 5
q_rho,20,,0.82,0.13,0.25,Malhan & Ibata 2019
M,20,,2.5e11,0.2e11,0.2e11,Malhan & Ibata 2019
"""


@pytest.mark.slow
def test_published_flattenings_stand_beside_those_at_the_same_places(tmp_path):
    """Of a logarithmic potential of R^2 + z^2 / q^2 the flattening is q everywhere."""
    (tmp_path / "published.csv").write_text(FLATTENED)
    halo = {"kind": "logarithmic_halo", "v0": 220, "q": {"uniform": [0.8, 0.96]}}
    results = sk.run(sk.load(FIT | {"potential": halo}), steps=10, progress=False)
    table = read_literature(tmp_path / "published.csv")
    found = beside_literature(results, table)
    middle, high = np.percentile(results.samples[:, list(results.spec.names).index("potential.q")], [50, 84])
    for row in found[:2]:
        assert row["ours"] == pytest.approx(middle, rel=1e-3)
        assert row["ours_plus"] == pytest.approx(high - middle, rel=1e-2)
        assert row["deviation"] == pytest.approx((middle - row["value"]) / np.hypot(high - middle, row["error_minus"]))
    assert np.isnan(found["ours"][2])
    text = Page(page_text(results, table)).text
    assert "q of the potential, (R, z) = (8.4, 16.8) kpc" in text
    assert "q of the halo's density, 20 kpc" in text
    drawn = flattening(results, table)
    (axes,) = drawn.axes
    names = axes.get_legend_handles_labels()[1]
    assert [name for name in names if "Bovy" in name] == ["Bovy+ 2016 at GD-1", "Bovy+ 2016 at Pal 5"]
    assert "this run, at the places of these" in names
    at = [line.get_xdata()[0] for line in axes.lines if line.get_marker() in "sD"]
    assert at == pytest.approx([np.hypot(12.5, 6.7), np.hypot(8.4, 16.8)])


def test_a_picture_that_cannot_be_read_is_left_out():
    assert embedded(b"") == ""


def test_published_values_are_converted(tmp_path):
    table = Table({"quantity": ["M", "M"], "radius": [0.1, 0.2], "reference": ["G14", "G14"]})
    table["radius"].unit = "Mpc"
    for name, values in {"value": [4.1, 5.6], "error_minus": [0.7, 1.2], "error_plus": [0.7, 1.2]}.items():
        table[name] = values
        table[name].unit = u.Unit("1e11 Msun")
    table.write(tmp_path / "table.ecsv")
    found = read_literature(tmp_path / "table.ecsv")
    np.testing.assert_allclose(found["radius"], [100, 200])
    np.testing.assert_allclose(found["error_plus"], [0.7e11, 1.2e11])


@pytest.mark.parametrize(
    "path", [*sorted(EXAMPLES.glob("*/literature.ecsv")), Path("milky_way")], ids=lambda path: path.parent.name
)
def test_the_published_values_of_the_examples_and_our_own_are_values_of_the_milky_way(path):
    table = read_literature(path)
    shape = table[[name.startswith("q_") for name in table["quantity"]]]
    assert ((shape["value"] > 0.8) & (shape["value"] < 1.2)).all()
    table = table[[not name.startswith("q_") for name in table["quantity"]]]
    speed = np.where(table["quantity"] == "v_c", table["value"], np.sqrt(4.30092e-6 * table["value"] / table["radius"]))
    assert (speed > 100).all()
    assert (speed < 260).all()
    assert all(any(letter.isdigit() for letter in reference) for reference in table["reference"])


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("quantity", "mass", r"row 1: the quantity must be M, v_c, q_Phi or q_rho, found 'mass'"),
        ("quantity", "q_Phi", "row 1: q_Phi is that at a radius and a height z in kpc, other than 0; found z = nan"),
        ("quantity", "q_phi", "Did you mean 'q_Phi'?"),
        ("radius", -8.0, "row 1: radius must be a positive number, found -8"),
        ("error_plus", -1.0, "error_plus"),
        ("value", "much", "'value' is not usable"),
        ("reference", None, "the column 'reference' is missing"),
    ],
)
def test_a_table_that_is_none_of_published_values_is_refused(tmp_path, column, value, message):
    row = {"quantity": "M", "radius": 100.0, "value": 4e11, "error_minus": 1e11, "error_plus": 1e11, "reference": "x"}
    row = {key: value if key == column else old for key, old in row.items() if key != column or value is not None}
    Table([row]).write(tmp_path / "table.ecsv")
    with pytest.raises(sk.StreamkitError, match=message):
        read_literature(tmp_path / "table.ecsv")


@pytest.mark.parametrize("content", [None, "", "\x00\x01", "a,b\n1"])
def test_a_file_that_is_no_table_is_refused(tmp_path, content):
    path = tmp_path / "table.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(sk.StreamkitError, match=r"literature '.*table\.csv'"):
        read_literature(path)
