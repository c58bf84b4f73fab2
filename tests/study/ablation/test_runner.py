"""The command `ablate`: the grid, its tables and files, and what it refuses."""

from __future__ import annotations

import copy
import re
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable, Table
from click.testing import Result
from commands import call, refused
from matplotlib.figure import Figure
from runfiles import FIT, RUN
from snapshot_files import write_gadget, write_table
from snapshots import arrays_of

import streamkit as sk
from streamkit.cli.ablate import read_variations
from streamkit.study.ablation import PRODUCTS, read_reference, run_ablation, variants_of
from streamkit.study.ablation.paper import paper_columns
from streamkit.study.ablation.products import PICTURES, SKY
from streamkit.study.ablation.runner import make_stream
from streamkit.study.ablation.tables import describe_ablation

GRAVITY = "--vary=stripping.progenitor_gravity=true,false"
HERE = ("--set=potential.v0=210", "--set=progenitor.mass=6.4e8", "--set=stripping.particles=600")


def test_variations_are_read_as_a_run_file_reads_them() -> None:
    found = read_variations(
        ("stripping.kind=mlcs, streakline", "stripping.progenitor_gravity=true,false", "a.b=10 km/s,5",
         "c=[1, 2],[3, 4]", "d='x, y',{ uniform = [1, 2] }")
    )  # fmt: skip
    assert found == {
        "stripping.kind": ["mlcs", "streakline"],
        "stripping.progenitor_gravity": [True, False],
        "a.b": ["10 km/s", 5],
        "c": [[1, 2], [3, 4]],
        "d": ["x, y", {"uniform": [1, 2]}],
    }


def test_the_grid_has_every_combination(run_file: Path) -> None:
    vary = {"stripping.kind": ["mlcs", "streakline"], "progenitor.mass": ["3e8 Msun", 6e8]}
    variants = variants_of(sk.load(run_file), vary)
    assert [v.label for v in variants] == [
        "mlcs, mass = 3e8 Msun", "mlcs, mass = 6e+08", "streakline, mass = 3e8 Msun", "streakline, mass = 6e+08"
    ]  # fmt: skip
    stream_inputs = [v.spec.bind() for v in variants]
    assert [s.stripping.kind for s in stream_inputs] == ["mlcs", "mlcs", "streakline", "streakline"]
    assert [s.mass for s in stream_inputs] == [3e8, 6e8, 3e8, 6e8]


@pytest.mark.parametrize("sigma", ["10 km/s", "7 km/s", {"uniform": [1, 20]}])
def test_another_kind_starts_from_its_own_defaults_and_keeps_what_all_kinds_have(run_file: Path, sigma: object) -> None:
    """Whatever sigma the file gives mLCS, Küpper's streakline has none."""
    spec = sk.load(run_file).with_values({"stripping.sigma": sigma, "stripping.burst_fraction": 0.5})
    mlcs, streakline = (v.spec.bind().stripping for v in variants_of(spec, {"stripping.kind": ["mlcs", "streakline"]}))
    assert mlcs == spec.bind().stripping
    assert streakline.model_dump() == {**streakline.model_dump(), "sigma": 0.0, "particles": 400, "burst_fraction": 0.5}
    both = variants_of(spec, {"stripping.kind": ["mlcs", "streakline"], "stripping.sigma": [4.0]})
    assert [v.spec.bind().stripping.model_dump()["sigma"] for v in both] == [4.0, 4.0]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """The products of two variants at two seeds, and what the command said."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "small.toml").write_text(RUN)
    result = call("ablate", folder / "small.toml", GRAVITY, *HERE, "--seeds", "2", "-o", folder / "out")
    assert result.exit_code == 0, result.output
    return folder / "out", result


def test_it_writes_a_table_the_tracks_and_the_pictures(made: tuple[Path, Result]) -> None:
    out, result = made
    assert sorted(path.name for path in out.iterdir()) == sorted(set(PRODUCTS) - {SKY})
    table = QTable.read(out / "ablation.ecsv")
    assert table["variant"].tolist() == ["with progenitor gravity", "without progenitor gravity"]
    assert table["stripping.progenitor_gravity"].tolist() == ["true", "false"]
    assert table["streams"].tolist() == [2, 2]
    assert table["track_leading"].unit == u.kpc
    assert table["length_ratio"][0] == pytest.approx(1.0)
    assert table["track_trailing"][0].value == 0
    assert table["length_ratio"][1] < 0.7
    assert (table["length_leading_sd"] > 0).all()
    assert (table["cpu"] > 0).all()
    assert table.meta["vary"] == {"stripping.progenitor_gravity": [True, False]}
    assert table.meta["run_digest"] == sk.load(out / "ablation.toml").digest()
    tracks = QTable.read(out / "tracks.ecsv")
    assert set(tracks["variant"]) == set(table["variant"])
    trailing = tracks[(tracks["arm"] == "trailing") & (tracks["variant"] == "with progenitor gravity")]
    assert (trailing["angle"] <= 0).all()
    both = tracks[tracks["variant"] == "with progenitor gravity"]
    assert both["density"].sum().value == pytest.approx(1.0, abs=0.03)  # a kernel at the progenitor loses a little
    for name in ("with progenitor gravity", "without", "len L", "precession", "pull"):
        assert name in result.stdout


def test_the_small_table_for_a_paper_has_the_numbers_of_the_large_one(made: tuple[Path, Result]) -> None:
    out, _ = made
    large, small = QTable.read(out / "ablation.ecsv"), Table.read(out / "ablation.csv", format="ascii.csv")
    assert len(small.colnames) < 20
    for head, name in (
        ("length leading [deg]", "length_leading"), ("sd of length trailing [deg]", "length_trailing_sd"),
        ("track trailing [kpc]", "track_near_trailing"), ("apocentres leading [kpc]", "observable_leading"),
        ("apocentres precession [deg]", "observable_precession"), ("fraction bound", "bound"),
    ):  # fmt: skip
        np.testing.assert_allclose(small[head], u.Quantity(large[name]).value, rtol=5e-3, equal_nan=True)
    assert not any(head.startswith("M(<") for head in small.colnames)  # there is one host
    latex = (out / "ablation.tex").read_text().splitlines()
    assert latex[0].startswith(r"\begin{tabular}")
    assert [len(line.split("&")) for line in latex[2:4]] == [len(latex[5].split("&"))] * 2
    length, scatter = (large[name][0].value for name in ("length_leading", "length_leading_sd"))
    value, error = (float(part) for part in latex[5].split("&")[1].strip(" $").split(r"\pm"))
    assert (value, error) == (pytest.approx(length, abs=scatter / 10), pytest.approx(scatter, rel=0.06))


def test_the_small_table_weighs_hosts_that_differ(run_file: Path) -> None:
    """M(<r) of the truncated flat host goes with v0 squared (Gibbons et al. 2014, equation 7)."""
    spec = sk.load(run_file).with_values({"stripping.particles": 200, "progenitor.mass": 6.4e8})
    ablation = run_ablation(spec, variants_of(spec, {"potential.v0": [200, 240]}))
    masses = next(column for column in paper_columns(ablation) if column.head == "M(<50 kpc)")
    assert masses.unit == "1e11 Msun"
    assert masses.mean[1] / masses.mean[0] == pytest.approx(1.44)


def test_many_data_are_one_column_for_each_quantity() -> None:
    """The first variant is the reference."""
    document = copy.deepcopy(FIT)
    n = 10
    distance = {"phi1": np.linspace(-5, 5, n).tolist(), "distance": [24.6] * n, "error": [1.0] * n}
    document["observable"]["distance"] = distance
    spec = sk.load(document)
    ablation = run_ablation(spec, variants_of(spec, {"stripping.progenitor_gravity": [True, False]}))
    column = next(each for each in paper_columns(ablation) if "distance" in each.head)
    assert (column.head, column.unit, column.mean[0]) == ("rms difference of distance", "errors", 0.0)
    measures = ablation.outcomes[1].measures[0]
    pulls = np.array([value for name, value in measures.items() if name.startswith("pull_distance")])
    assert len(pulls) == n
    assert column.mean[1] == pytest.approx(np.sqrt(np.mean(pulls**2)))


@pytest.mark.slow
def test_long_labels_become_numbers_with_a_list(run_file: Path, tmp_path: Path) -> None:
    line = [f"--set=progenitor.{name}=0" for name in ("y", "z", "vy")]
    result = call(
        "ablate", run_file, "--vary=progenitor.vz=201,0", "--vary=stripping.release_times=uniform", GRAVITY, *HERE,
        "-o", tmp_path / "out", *line,
    )  # fmt: skip
    lines = result.stdout.splitlines()
    assert "  1  vz = 201, release_times = uniform, with progenitor gravity" in lines
    assert "  4  vz = 0, release_times = uniform, without progenitor gravity" in lines
    assert any(line.startswith("4: no stream: the progenitor moves on a line") for line in lines)
    assert all(len(line) <= 100 for line in lines)


@pytest.mark.slow  # those of the other studies have fast tests
def test_workers_do_not_change_the_numbers(run_file: Path, tmp_path: Path, made: tuple[Path, Result]) -> None:
    result = call("ablate", run_file, GRAVITY, *HERE, "--seeds=2", "--workers=2", "-o", tmp_path / "out", "-q")
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    tables = [QTable.read(out / "ablation.ecsv") for out in (made[0], tmp_path / "out")]
    assert tables[0].colnames == tables[1].colnames
    for name in tables[0].colnames:
        if not name.startswith("cpu"):
            one, two = (np.asarray(table[name]) for table in tables)
            assert np.array_equal(one, two, equal_nan=one.dtype.kind == "f"), name


def test_a_variant_without_a_stream_has_its_reason_and_the_others_their_results(run_file: Path, tmp_path: Path) -> None:
    """On a line through the Galactic centre there is no orbital plane; 0.02 Gyr leave no one unbound."""
    line = ("--set=progenitor.y=0", "--set=progenitor.z=0", "--set=progenitor.vy=0")
    out = tmp_path / "out"
    result = call(
        "ablate", run_file, "--vary=progenitor.vz=0,201", "--vary=progenitor.lookback=0.02 Gyr,3.7 Gyr", *line, *HERE,
        "-o", out,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    table = QTable.read(out / "ablation.ecsv")
    reasons = table["reason"].filled("").tolist()
    assert ["line through the Galactic centre" in reason for reason in reasons] == [True, True, False, False]
    assert reasons[3] == ""
    assert table["streams"].tolist() == [0, 0, 1, 1]
    assert np.isfinite(table["length_leading"][3])
    assert "vz = 0, lookback = 3.7 Gyr: no stream: the progenitor moves on a line" in " ".join(result.stdout.split())


def test_if_no_variant_has_a_stream_it_says_why(run_file: Path, tmp_path: Path) -> None:
    line = [f"--set=progenitor.{name}=0" for name in ("y", "z", "vy", "vz")]
    message = refused("ablate", run_file, "--vary=stripping.kind=mlcs,streakline", *line, "-o", tmp_path / "out")
    assert "no variant has a stream. mlcs: no stream: the progenitor moves on a line" in message


def test_an_interruption_keeps_what_is_finished(
    run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def make(job: tuple[sk.Spec, str]) -> object:
        if not job[0].bind().stripping.progenitor_gravity:
            raise KeyboardInterrupt
        return make_stream(job)

    monkeypatch.setattr("streamkit.study.ablation.runner.make_stream", make)
    result = call("ablate", run_file, GRAVITY, *HERE, "-o", tmp_path / "out")
    assert result.exit_code == 130
    assert "interrupted; the tables hold the finished part" in result.stderr
    table = QTable.read(tmp_path / "out" / "ablation.ecsv")
    assert table["reason"].filled("").tolist() == ["", "interrupted"]
    assert table["length_leading"][0] > 0
    monkeypatch.setattr("streamkit.study.ablation.runner.run_jobs", lambda *_: ({}, "interrupted"))
    result = call("ablate", run_file, GRAVITY, *HERE, "-o", tmp_path / "none")
    assert result.exit_code == 130
    assert "interrupted before the first variant was finished" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--vary=stripping.knd=mlcs,streakline"], "there is no field 'stripping.knd'. Did you mean 'stripping.kind'?"),
        (["--vary=stripping.kind=mlcs,streaklin"], "variant 'streaklin': .*Did you mean 'streakline'?"),
        (["--vary=stripping.progenitor_gravity=yes"], "found 'yes', expected true or false"),
        (["--vary=progenitor.mass=1e8,1 kpc"], "variant 'mass = 1 kpc'.*expected a quantity in Msun"),
        (["--vary=stripping.kind"], "expected PATH=V1,V2,..., such as stripping.kind=mlcs,streakline"),
        (["--vary=stripping.kind=mlcs,"], "expected PATH=V1,V2,..."),
        ([GRAVITY, GRAVITY], "stripping.progenitor_gravity: given twice"),
        (["--vary=stripping.sigma=5,6,5"], "--vary stripping.sigma: the value 5 is given twice"),
        ([], "missing option '--vary'"),
        ([GRAVITY, "--reference=none.npz"], "none.npz: there is no such file"),
        ([GRAVITY, "--reference=restricted"], "is no live progenitor. Did you mean 'restricted_nbody'?"),
        ([GRAVITY, "--match-rate"], "--match-rate needs a --reference"),
        ([GRAVITY, "--seeds=0"], "0 is not in the range x>=1"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_run(
    run_file: Path, tmp_path: Path, arguments: list[str], message: str
) -> None:
    assert re.search(message.replace("?", r"\?").replace("...,", r"\.\.\.,"), refused("ablate", run_file, *arguments))
    assert not list(tmp_path.glob("*-ablation"))


def test_the_products_of_another_ablation_are_not_replaced(run_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "small-ablation"
    out.mkdir()
    (out / "ablation.ecsv").write_text("mine")
    assert "holds an ablation already (ablation.ecsv). --force replaces it" in refused("ablate", run_file, GRAVITY)
    assert (out / "ablation.ecsv").read_text() == "mine"
    assert call("ablate", run_file, GRAVITY, *HERE, "--force", "-q").exit_code == 0
    assert QTable.read(out / "ablation.ecsv")["variant"][0] == "with progenitor gravity"


def nbody(path: Path, **changes: object) -> Path:
    """The extract of mock 1, as a plain table."""
    data = arrays_of("nbody_B.npz")
    orbit = data["orbit_txv"].copy()
    orbit[:, 0] -= orbit[0, 0]
    columns: dict[str, object] = dict(zip(("x", "y", "z", "vx", "vy", "vz"), [*data["x"], *data["v"]], strict=True))
    meta = f'{{"units": "kpc, km/s, Gyr", "t_gyr": {orbit[-1, 0]}}}'
    columns |= {
        "t_strip": data["t_strip"] + orbit[-1, 0], "Lam_unwrapped_deg": data["winding"], "chi": data["chi"],
        "orbit_txv": orbit, "meta": meta,
    }  # fmt: skip
    return write_table(path, **(columns | changes))


def test_beside_a_snapshot_the_reference_has_its_own_row(run_file: Path, tmp_path: Path) -> None:
    """Mock 1 at 2000 particles: lengths within 10 %, the N-body's apocentres by the N-body simulation's own README."""
    result = call(
        "ablate", run_file, GRAVITY, *HERE[:2], "--set=stripping.particles=2000",
        "--set=observable.recent_debris=epoch_aware", "--reference", nbody(tmp_path / "b.npz"), "-o", tmp_path / "out",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    table = QTable.read(tmp_path / "out" / "ablation.ecsv")
    assert table["variant"].tolist() == ["reference", "with progenitor gravity", "without progenitor gravity"]
    assert table["observable_leading"][0] == pytest.approx(57.0, abs=1.0)
    assert table["observable_trailing"][0] == pytest.approx(96.2, abs=1.0)
    assert table["length_ratio"][1] == pytest.approx(1.0, abs=0.1)
    assert 0.4 < table["length_ratio"][2] < 0.6
    pull = (table["observable_leading"][1] - table["observable_leading"][0]) / 1.0  # the file's error is 1 kpc
    assert table["pull_leading"][1] == pytest.approx(pull)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vx": None}, "vx missing; a snapshot needs positions and velocities"),
        ({"meta": '{"units": "kpc, km/s, Myr", "t_gyr": 1}'}, "its units are 'kpc, km/s, Myr', without Gyr"),
        ({"meta": None}, "does not state its units"),
    ],
)
def test_a_snapshot_that_cannot_be_used_is_refused(
    run_file: Path, tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    path = nbody(tmp_path / "b.npz", **changes)
    assert message in refused("ablate", run_file, GRAVITY, *HERE, "--reference", path)


def test_a_snapshot_of_another_satellite_is_refused(run_file: Path, tmp_path: Path) -> None:
    path = nbody(tmp_path / "b.npz")
    message = refused("ablate", run_file, GRAVITY, *HERE, "--set=progenitor.x=-19", "--reference", path)
    assert "put into [progenitor]: x = 19.1555" in message


def with_crossings(path: Path, particles: int) -> Path:
    """The first particles of the extract of mock 1 in the Gadget layout, with crossings of the tidal radius."""
    data = arrays_of("nbody_B.npz")
    today = -data["orbit_txv"][0, 0]
    columns = {name: np.asarray(data[name], float)[..., :particles] for name in ("x", "v", "t_strip", "winding")}
    stripped = np.where(np.isnan(columns["t_strip"]), -1.0, (columns["t_strip"] + today) * sk.GYR)
    crossing = np.random.default_rng(1).normal(0, 10, (particles, 3))
    units = {"UnitLength_in_cm": 3.0856775814913673e21, "UnitVelocity_in_cm_per_s": 1e5}
    orbit = data["orbit_txv"]
    return write_gadget(
        path,
        Header={"Time": today * sk.GYR, "NumFilesPerSnapshot": 1},
        Units=units,
        PartType1={
            "Coordinates": columns["x"].T, "Velocities": columns["v"].T, "StrippingTime": stripped,
            "Winding": np.radians(columns["winding"]), "StrippingOffset": crossing / 10, "StrippingVelocity": crossing,
        },
        Progenitor={
            "Times": (orbit[:, 0] + today) * sk.GYR, "Coordinates": orbit[:, 1:4], "Velocities": orbit[:, 4:]
        },
    )  # fmt: skip


@pytest.mark.slow  # test_figures.py draws such a snapshot
def test_a_snapshot_with_its_crossings_costs_no_picture(run_file: Path, tmp_path: Path) -> None:
    """The variants have 600 particles, the snapshot 500."""
    snapshot = with_crossings(tmp_path / "b.hdf5", 500)
    out = tmp_path / "out"
    result = call("ablate", run_file, GRAVITY, *HERE, "--reference", snapshot, "-o", out)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    assert sorted(path.name for path in out.iterdir()) == sorted(set(PRODUCTS) - {SKY})


@pytest.mark.slow  # tests/fit/test_products.py has one that fails
def test_a_picture_that_fails_is_named_and_the_others_are_there(
    run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object) -> Figure:
        raise ValueError("shapes (3,500) and (3,3000)")

    monkeypatch.setitem(PICTURES, "phase_space.png", broken)
    result = call("ablate", run_file, GRAVITY, *HERE, "-o", tmp_path / "out", "-q")
    assert result.exit_code == 0, result.output
    said = "streamkit: not drawn: phase_space.png (ValueError: shapes (3,500) and (3,3000)); everything else is written"
    assert result.stderr.strip() == said
    there = {path.name for path in (tmp_path / "out").iterdir()}
    assert set(PRODUCTS) - there == {"phase_space.png", SKY}


LIVE = {
    "seed": 1,
    "potential": {"kind": "tf", "v0": 210.0, "rs": 12.0, "alpha": 0.45},
    "progenitor": {
        "kind": "plummer", "mass": 6.4e8, "radius": 0.85, "x": 40.0, "y": 0.0, "z": 0.0, "vx": -60.0, "vy": 0.0,
        "vz": 120.0, "lookback": 1.5,
    },
    "stripping": {"kind": "mlcs", "particles": 300, "sigma": 10.0, "mass_loss": 0.2},
}  # fmt: skip


def test_live_progenitor_is_a_variant_and_a_reference():
    """Of another sort than mLCS, it does not keep what belongs to releasing schemes; and it is one by its kind."""
    spec = sk.load(LIVE)
    mlcs, live = variants_of(spec, {"stripping.kind": ["mlcs", "restricted_nbody"]})
    assert mlcs.spec.bind().stripping.mass_loss == 0.2
    assert live.spec.bind().stripping.particles == 300
    reference = read_reference("restricted_nbody", spec)
    assert reference.title == "restricted_nbody"
    assert len(reference.stream) == 20000
    assert reference.stream.orbit.mass_left[-1] < 1
    found = run_ablation(spec, [mlcs, live], reference)
    assert found.beside == "a live progenitor by restricted_nbody"
    assert all(outcome.measures for outcome in found.outcomes), [outcome.reasons for outcome in found.outcomes]


def test_reference_that_is_neither_a_file_nor_a_live_scheme_is_a_sentence():
    with pytest.raises(sk.StreamkitError):
        read_reference("streakline", sk.load(LIVE))


def test_energies_beside_a_moving_body_are_said_not_to_last() -> None:
    lmc = {"kind": "hernquist", "mass": 1e10, "a": 5, "x": 0, "y": 50, "z": 0, "vx": 0, "vy": 0, "vz": 250}
    texts = []
    for more in ({}, {"body": {"lmc": lmc}}):
        document = copy.deepcopy(FIT) | more
        document["stripping"]["particles"] = 100
        spec = sk.load(document)
        texts.append(describe_ablation(run_ablation(spec, variants_of(spec, {"stripping.kind": ["mlcs"]}))))
    assert "not conserved" not in texts[0]
    assert "not conserved" in " ".join(texts[1].split())
