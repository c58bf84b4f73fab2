"""What is taken from the library, the run files that are written, and what is said of names and missing packages."""

import csv
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from click.testing import CliRunner
from streamkit_galstreams import catalogue
from streamkit_galstreams.catalogue import COLUMNS, streams, tracks, tracks_of
from streamkit_galstreams.library import Galstreams, best
from streamkit_galstreams.measured import measured
from streamkit_galstreams.points import points_of
from streamkit_galstreams.progenitor import clusters
from streamkit_galstreams.runfile import section_name

from streamkit import StreamkitError, load
from streamkit.cli.main import main

# Read off the library's files by eye: what each track has, and what is wrong with its rows.
SEEN = {
    "GD-1.pricewhelan2018": ("sdp-", []),
    "GD-1.ibata2021": ("sdp-", ["spline"]),
    "GD-1.ibata2024": ("s-p-", ["placeholder", "spline"]),
    "Orphan-Chenab.koposov2023": ("sdpv", ["from 16.1 to 52.7 kpc"]),
    "Orphan-Chenab.koposov2019": ("sdp-", ["from 16 to 100 kpc", "velocity 0 where it is unknown"]),
    "Phoenix.shipp2019": ("sdpv", []),
    "M68-Fjorm.ibata2021": ("s-p-", ["falls to 0.00018 kpc", "spline"]),
    "M68-Fjorm.palau2019": ("s-p-", ["its InfoFlag 2"]),
    "M5.grillmair2019": ("s-p-", ["its InfoFlag 0"]),
    "Gaia-2.ibata2021": ("sdp-", ["1.3e+05 km/s"]),
    "C-4.ibata2021": ("sdp-", []),  # velocities of 1000 km/s, and a flag that says so
    "SGP-S.yang2022": ("sd--", ["InfoFlag 2 for the proper motion"]),
    "300S.fu2018": ("sd-v", []),
}


@pytest.mark.parametrize("name", SEEN)
def test_columns_that_were_not_measured_are_found(name):
    found, (dims, faults) = measured(tracks()[name]), SEEN[name]
    assert found.dims == dims
    assert len(found.faults) == len(faults)
    assert all(fault in told for fault, told in zip(faults, found.faults, strict=True))


def test_the_rules_hold_for_a_track_that_is_made_up(tmp_path):
    columns = dict.fromkeys(COLUMNS, 0.0) | {"ra": "ra", "distance": 7.0, "pm_dec": 3.0, "radial_velocity": 100.0}
    rows = [columns | {"ra": ra} for ra in (1.0, 2.0, 3.0)]

    def made(flags, **changes):
        with (tmp_path / "track.st.X.a2020.ecsv").open("w") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(row | {name: values[i] for name, values in changes.items()} for i, row in enumerate(rows))
        (tmp_path / "track.st.X.a2020.summary.ecsv").write_text(f"# a\nStreamName,InfoFlags\nX,{flags}\n")
        catalogue.tracks.cache_clear()
        return measured(catalogue.tracks(tmp_path)["X.a2020"])

    assert made("1011").distance == "one value"
    assert made("1111", distance=[7.0, 8.0, 9.0]).dims == "sdpv"
    assert made("1111", distance=[1.0, 1.0, 1.0]).dims == "s-pv"
    assert made("1111", radial_velocity=[10.0, 0.0, 700.0]).dims == "sdp-"
    assert made("1110", radial_velocity=[-189.0] * 3).start_velocity  # a mean of the whole stream
    assert not made("1110", radial_velocity=[0.0] * 3).start_velocity
    catalogue.tracks.cache_clear()


def test_there_are_sixty_streams_with_sky_distance_and_motion():
    full = [name for name, found in streams().items() if measured(best(found)).rank[0]]
    assert len(full) >= 60
    assert all(track.file.exists() for found in streams().values() for track in found)


def test_the_best_track_has_most_and_is_the_newest():
    assert best(tracks_of("Orphan-Chenab")).name == "Orphan-Chenab.koposov2023"
    assert best(tracks_of("gd1")).name == "GD-1.ibata2021"  # 2024 has no distances
    assert best(tracks_of("GD-1.pricewhelan2018")).name == "GD-1.pricewhelan2018"


@pytest.mark.parametrize("name", ["GD-1", "Phoenix", "Orphan-Chenab", "NGC3201"])
def test_points_lie_on_the_track_as_astropy_turns_it(name):
    track = best(tracks_of(name))
    points = points_of(track)
    given = track.points
    seen = SkyCoord(
        ra=given["ra"] * u.deg, dec=given["dec"] * u.deg, pm_ra_cosdec=given["pm_ra_cosdec"] * u.mas / u.yr,
        pm_dec=given["pm_dec"] * u.mas / u.yr,
    ).transform_to(points.frame.to_astropy())  # fmt: skip
    order = np.argsort(seen.phi1.wrap_at(180 * u.deg).deg)
    phi1 = seen.phi1.wrap_at(180 * u.deg).deg[order]
    for column, values in (
        ("phi2", seen.phi2.deg),
        ("pm_phi1_cosphi2", seen.pm_phi1_cosphi2.value),
        ("pm_phi2", seen.pm_phi2.value),
    ):
        wanted = np.interp(points.columns["phi1"], phi1, values[order])
        assert np.allclose(points.columns[column], wanted, atol=1e-6)
    assert np.abs(points.columns["phi2"]).max() < 15
    assert points.columns["phi1"][0] > phi1[0]
    assert points.columns["phi1"][-1] < phi1[-1]


def test_one_distance_for_the_whole_stream_is_one_datum():
    written = Galstreams().write(["Phoenix"])
    observable = tomllib.loads(written.text)["stream"]["phoenix"]["observable"]
    assert observable["distance"]["distance"] == ["17.50 kpc"]
    assert "distance" not in QTable.read(written.tables["phoenix.ecsv"], format="ascii.ecsv").colnames


def test_errors_are_the_widths_with_their_source_in_a_comment():
    written = Galstreams().write(["GD-1.ibata2021"])
    table = QTable.read(written.tables["gd1.ecsv"], format="ascii.ecsv")
    assert np.allclose(table["phi2_error"].value, 0.652)  # the file of the library says 0.652163577596312
    assert np.allclose(table["pm_phi1_cosphi2_error"].value, 0.463)
    assert np.allclose(table["distance_error"] / table["distance"], 0.1, atol=1e-3)
    assert "radial_velocity" not in table.colnames
    flat = " ".join(written.text.replace("#", " ").split())
    assert "CHECK THE ERRORS" in flat
    assert "phi2 0.65 deg (the width of its members)" in flat
    assert "Velocity is a spline through few stars: it starts the search, and is no datum." in flat
    published = Galstreams().write(["AAU-ATLAS.li2021"]).text
    assert "phi2 0.3 deg (its published width)" in published


def test_a_cluster_in_its_track_is_the_progenitor():
    document = tomllib.loads(Galstreams().write(["Pal5", "NGC288", "GD-1"]).text)["stream"]
    assert document["pal5"]["progenitor"]["ra"] == "229.019 deg"
    assert document["ngc288"]["progenitor"]["v_los"] == "-44.45 km/s"
    assert "phi1" in document["gd1"]["progenitor"]
    gjoll = tomllib.loads(Galstreams().write(["NGC3201-Gjoll.ibata2021"]).text)["stream"]["ngc3201_gjoll"]
    assert "phi1" in gjoll["progenitor"]  # the cluster is far from this stretch


def test_clusters_are_where_astropy_sees_them():
    """Harris's catalogue (2010 edition), as galstreams has it, is another measurement of the places."""
    lines = (
        (catalogue.folder().parent / "lib" / "globular_cluster_params.harris2010.tableI.csv").read_text().splitlines()
    )
    harris = {row[0].replace(" ", ""): row for row in ([each.strip() for each in line.split(",")] for line in lines)}
    compared = 0
    for cluster in clusters().values():
        row = harris.get(cluster["cluster"])
        if row is None or not row[2][0].isdigit():  # a comment in the file
            continue
        there = SkyCoord(row[2], row[3], unit=("hourangle", "deg"))
        here = SkyCoord(cluster["ra"] * u.deg, cluster["dec"] * u.deg)
        assert here.separation(there) < 1.5 * u.arcmin, cluster["cluster"]
        assert abs(cluster["distance"] / float(row[6]) - 1) < 0.12
        compared += 1
    assert compared > 15


def test_run_files_of_all_streams_are_valid(tmp_path):
    """Of one stream each, and of all together, whatever the library has of them."""
    names = [name for name, found in streams().items() if measured(best(found)).rank[0]]
    written = Galstreams().write(names)
    for name, text in written.tables.items():
        (tmp_path / name).write_text(text)
    (tmp_path / written.name).write_text(written.text)
    spec = load(tmp_path / written.name)
    assert len(spec.streams) == len(names)
    assert len({section_name(name) for name in streams()}) == len(streams())
    for line in written.text.splitlines():
        assert len(line) <= 120 or not line.startswith("#")


def call(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def test_init_writes_a_run_file_and_its_tables(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = call("init", "--stream", "GD-1", "Pal5")
    assert done.exit_code == 0, done.stderr
    assert (
        done.stdout
        == "streams.toml, gd1.ecsv, pal5.ecsv: check the errors of the data; next: streamkit check streams.toml\n"
    )
    assert load("streams.toml").streams == ("gd1", "pal5")
    again = call("init", "--stream", "GD-1", "--stream", "Pal5")
    assert again.exit_code == 2
    assert "exists; add --force" in again.stderr
    assert call("init", "--stream", "phoenix", "-o", "mine.toml").exit_code == 0
    assert Path("mine.toml").exists()
    assert Path("phoenix.ecsv").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--stream", "GD-2"], r"galstreams has no track of a stream 'GD-2'\. Did you mean 'GD-1'\? .*lists all"),
        (["--stream", "GD-1.nobody2020"], r"no track of a stream 'GD-1\.nobody2020'"),
        (["--stream", "GD-1", "gd1"], r"GD-1: given twice"),
        (["--own", "--stream", "GD-1"], r"--own writes a template; found the stream 'GD-1' too"),
    ],
)
def test_a_wrong_name_is_told(words, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = call("init", *words)
    assert done.exit_code == 2
    assert re.search(told, done.stderr)
    assert not list(tmp_path.iterdir())


def test_the_listing_has_the_streams_and_the_faults():
    listed = call("galstreams").stdout
    assert re.search(r"GD-1 +GD-1\.ibata2021 +sdp- +3", listed)
    assert "Styx" not in call("galstreams", "--all").stdout  # a great circle between two points
    assert "Hermus" in call("galstreams", "--all").stdout
    assert re.search(r"GD-1\.ibata2024 +s-p- +distance 1 kpc everywhere", call("galstreams", "GD-1").stdout)
    assert call("galstreams", "nothing").exit_code == 2


def test_without_galstreams_the_package_is_named(monkeypatch):
    monkeypatch.setattr(catalogue, "find_spec", lambda name: None)
    with pytest.raises(StreamkitError, match="galstreams is not installed: pip install galstreams"):
        catalogue.folder()
