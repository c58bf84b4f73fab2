"""What streams share, said once: `[stream_defaults]`, files of streams, a frame and a table above the sections."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from runfiles import accepts, error_of, with_entry

import streamkit as sk
from streamkit.fit.directory.integrity import load_spec

PLACE: dict[str, Any] = {
    "phi2": {"uniform": [-1, 1]}, "distance": {"normal": [8, 1]}, "pm_phi1_cosphi2": -13, "pm_phi2": -3, "v_los": -80,
}  # fmt: skip
TRACK = {"phi1": [-5, 5], "phi2": [0, 1], "error": [0.2, 0.2]}
SHARED: dict[str, Any] = {
    "progenitor": {"kind": "plummer", "mass": "2e4 Msun", "radius": "30 pc", "phi1": 0, "lookback": 1},
    "stripping": {"kind": "mlcs", "particles": 100, "sigma": 1},
    "observable": {"kind": "track", "kernel": 3, "phi2": TRACK},
}
STREAM: dict[str, Any] = {"frame": "GD1Koposov10", "progenitor": PLACE}
HOST: dict[str, Any] = {"seed": 7, "potential": {"kind": "tf", "v0": {"uniform": [180, 260]}, "rs": 15, "alpha": 0.4}}
RUN = HOST | {"stream_defaults": SHARED, "stream": {name: copy.deepcopy(STREAM) for name in "abc"}}
WHOLE = {  # the same, with everything in every stream
    "progenitor": PLACE | SHARED["progenitor"] | {"frame": "GD1Koposov10"},
    "stripping": SHARED["stripping"],
    "observable": SHARED["observable"] | {"frame": "GD1Koposov10"},
}


def with_(*entries: Any) -> dict[str, Any]:
    """RUN with one entry replaced or removed, as by `with_entry`."""
    return with_entry(RUN, *entries)


def files(folder: Path, run: dict[str, Any], **streams: dict[str, Any]) -> Path:
    """Write a run file, and a file of each stream; return the run file."""
    for name, table in streams.items():
        (folder / f"{name}.toml").write_text(tomlkit.dumps(table))
    (folder / "run.toml").write_text(tomlkit.dumps(run))
    return folder / "run.toml"


def test_defaults_give_the_run_of_the_same_values_in_each_stream() -> None:
    spec, other = sk.load(RUN), sk.load(HOST | {"stream": dict.fromkeys("abc", WHOLE)})
    assert spec.digest() == other.digest()
    assert sk.load(spec.document).digest() == spec.digest()
    assert spec.only("b").digest() == other.only("b").digest()
    assert "stream_defaults" not in spec.toml()


def test_a_stream_s_own_value_replaces_a_default_as_a_whole() -> None:
    spec = sk.load(
        with_entry(with_("stream", "a", "stripping", {"sigma": 5}), "stream_defaults", "progenitor", "v_los", 3)
    )
    values = [spec.bind(stream=name).stripping for name in "ab"]
    assert [(each.sigma, each.particles) for each in values] == [(5, 100), (1, 100)]
    other = sk.load(with_entry(RUN, "stream", "b", "progenitor", "phi2", {"normal": [0, 1]}))
    assert [type(p).__name__ for p in other.priors] == [
        "Uniform", "Uniform", "Normal", "Normal", "Normal", "Uniform", "Normal",
    ]  # fmt: skip


def test_a_default_that_does_not_fit_a_stream_is_left_out_there() -> None:
    live = sk.load(with_("stream", "b", "stripping", {"kind": "restricted_nbody"}))
    assert "sigma" not in live.document["stream"]["b"]["stripping"]
    assert live.document["stream"]["b"]["stripping"]["particles"] == 100
    icrs = {"ra": 10, "dec": 3, "distance": 5, "pm_ra_cosdec": 1, "pm_dec": 2, "radial_velocity": 100}
    spec = sk.load(with_entry(with_("stream", "b", "progenitor", icrs), "stream_defaults", "progenitor", "v_los", 3))
    assert spec.document["stream"]["b"]["progenitor"]["v_los"] == "100.0 km/s"
    assert not {"phi1", "frame"} & spec.document["stream"]["b"]["progenitor"].keys()
    own = {"kind": "track", "phi2": TRACK}
    named = sk.load(with_("stream", "b", "observable", {"one": own, "other": own | {"kernel": 1}}))
    assert [each.kernel for each in named.bind(stream="b").observables.values()] == [2, 1]
    assert all(each.frame == "GD1Koposov10" for each in named.bind(stream="b").observables.values())


def test_a_frame_of_all_streams_stands_above_the_sections_too() -> None:
    run = with_("stream_defaults", "frame", "GD1Koposov10")
    for table in run["stream"].values():
        table.pop("frame", None)
    run["stream"]["b"]["frame"] = "Pal5PriceWhelan18"
    spec = sk.load(run)
    assert [spec.bind(stream=name).observable.frame for name in "ab"] == ["GD1Koposov10", "Pal5PriceWhelan18"]


def test_a_frame_of_all_streams_is_left_out_where_no_section_has_one() -> None:
    icrs = {"ra": 10, "dec": 3, "distance": 5, "pm_ra_cosdec": 1, "pm_dec": 2, "v_los": 100}
    apocentres = {"kind": "apocentres", "leading": [20, 1]}
    run = with_("stream_defaults", "frame", "GD1Koposov10")
    run = with_entry(run, "stream_defaults", "observable", ...)
    track = {"observable": SHARED["observable"]}
    run["stream"] = {"a": {"progenitor": PLACE} | track, "b": {"progenitor": icrs, "observable": apocentres}}
    spec = sk.load(run)
    assert spec.bind(stream="a").observable.frame == "GD1Koposov10"
    assert "frame" not in spec.document["stream"]["b"]
    del run["stream"]["a"], run["stream_defaults"]["progenitor"]["phi1"]
    (line,) = error_of(run).splitlines()
    assert line.startswith("run mapping: stream_defaults.frame: no section of the stream has such a field; expected")


def test_named_observables_have_their_own_defaults() -> None:
    shared = {"one": SHARED["observable"], "other": SHARED["observable"] | {"kernel": 1}}
    run = with_("stream_defaults", "observable", shared)
    run["stream"]["b"]["observable"] = {"one": {"kernel": 5}}
    spec = sk.load(run)
    kernels = {name: [each.kernel for each in spec.bind(stream=name).observables.values()] for name in "ab"}
    assert kernels == {"a": [3, 1], "b": [5, 1]}


MISTAKES = [  # with the beginnings of all lines of the message
    (("stream_defaults", "progenitor", "radius", -1), ["stream_defaults.progenitor.radius: found -1 kpc"]),
    (("stream_defaults", "stripping", "sigma", "1 kpc"), ["stream_defaults.stripping.sigma: expected a quantity in"]),
    (("stream_defaults", "stripping", "kind", "mlsc"), ["stream_defaults.stripping.kind: no stripping is called"]),
    (("stream_defaults", "stripping", "kind", ...), ["stream_defaults.stripping: 'kind' is missing"]),
    (("stream_defaults", "stripping", "steps", 3), ["stream_defaults.stripping.steps: the stripping 'mlcs' has"]),
    (("stream_defaults", "stripping", 3), ["stream_defaults.stripping: found 3, expected a section"]),
    (("stream_defaults", "observable", "phi2", "no.ecsv"), ["stream_defaults.observable.phi2: cannot read the file"]),
    (("stream_defaults", "table", "no.ecsv"), ["stream_defaults.table: cannot read the file 'no.ecsv'"]),
    (("stream_defaults", "striping", {}), ["stream_defaults.striping: a stream has no such section. Did you"]),
    (("stream", "b", "progenitor", "distance", -3), ["stream.b.progenitor.distance: found -3 kpc"]),
    (("stream", "b", "frame", "GD2"), ["stream.b.frame: there is no frame 'GD2'"]),
    (("stream", "b", "tabel", "b.ecsv"), ["stream.b.tabel: a stream has no such section. Did you mean 'table'?"]),
    (("stream", "b", "table", "b.ecsv"), ["stream.b.table: cannot read the file 'b.ecsv'"]),
    (("stream", "b", 3), ["stream.b: found 3, expected sections such as [stream.b.progenitor]"]),
    (("stream", "b.c", {}), ["stream.b.c: the name of a stream may not contain a dot"]),
    (("stream", "stream", {}), ["stream.stream: a stream may not be called 'stream'"]),
    (("stream", ...), ["stream_defaults: there is no stream to share it; expected [stream.NAME] or streams"]),
    (("streams", ["b.toml"]), ["streams[0]: 'b.toml' is a second stream called 'b', beside [stream.b]"]),
    (("progenitor", {}), ["progenitor: found beside the named streams a, b, c"]),
    (("streams", ["b.toml", 3]), ["streams: found ['b.toml', 3], expected a list of files of streams"]),
]  # fmt: skip


@pytest.mark.parametrize(("entry", "lines"), MISTAKES)
def test_a_mistake_is_one_line_with_the_place_that_has_it(entry: tuple[Any, ...], lines: list[str]) -> None:
    found = error_of(with_(*entry)).splitlines()
    assert [line.removeprefix("run mapping: ")[: len(text)] for line, text in zip(found, lines, strict=True)] == lines


def test_a_misspelt_name_in_the_defaults_is_not_missing_in_each_stream() -> None:
    run = with_("stream_defaults", "progenitor", "lookback", ...)
    run["stream_defaults"]["progenitor"]["lokback"] = 1
    (line,) = error_of(run).splitlines()
    assert line.startswith("run mapping: stream_defaults.progenitor.lokback: ")
    assert "Did you mean 'lookback'?" in line


def test_equal_errors_of_streams_are_one_line_with_their_names() -> None:
    run = HOST | ({"stream": {f"s{i}": copy.deepcopy(WHOLE) for i in range(40)}})
    for table in run["stream"].values():
        table["stripping"]["sigma"] = -1
    (line,) = error_of(run).splitlines()
    assert line.startswith("run mapping: stream.s0.stripping.sigma: found -1 km/s")
    assert line.endswith("(the same in s1, s2, s3, s4, s5 and 34 more)")
    run = with_("stream", "b", "table", "b.ecsv")
    run["stream"]["c"]["table"] = "b.ecsv"
    (line,) = error_of(run).splitlines()
    assert line.startswith("run mapping: stream.b.table: ")
    assert line.endswith("(the same in c)")


def test_a_default_that_fails_in_some_streams_names_them() -> None:
    run = with_("stream_defaults", "observable", "stars", ["distance"])
    own = {"distance": {"phi1": [0], "distance": [8], "error": [1]}}
    (line,) = error_of(with_entry(run, "stream", "b", "observable", own)).splitlines()
    assert line.startswith("run mapping: stream_defaults.observable.stars: found ['distance']: there is no table of")
    assert line.endswith("(in a, c)")


def test_a_stream_without_data_and_a_section_that_all_lack_are_told() -> None:
    run = with_("stream_defaults", "observable", "phi2", ...)
    has = {"phi2": TRACK}
    run = with_entry(with_entry(run, "stream", "a", "observable", has), "stream", "c", "observable", has)
    (line,) = error_of(run).splitlines()
    assert line.startswith("run mapping: stream.b.observable: there are no data: expected table or members, or")
    (line,) = error_of(with_("stream_defaults", "stripping", ...)).splitlines()
    assert line == "run mapping: the section [stream.a.stripping] is missing (the same in b, c)"


def test_a_default_of_one_observable_fits_no_stream_with_several() -> None:
    run = copy.deepcopy(RUN)
    for table in run["stream"].values():
        table["observable"] = {"one": SHARED["observable"]}
    (line,) = error_of(run).splitlines()
    assert line.startswith("run mapping: stream_defaults.observable: fits no stream: each stream has one ")


def test_a_field_above_the_sections_needs_one_that_takes_it() -> None:
    icrs = {"ra": 10, "dec": 3, "distance": 5, "pm_ra_cosdec": 1, "pm_dec": 2, "v_los": 100}
    apocentres = {"kind": "apocentres", "leading": [5, 1]}
    run = with_("stream", "b", {"frame": "GD1Koposov10", "progenitor": icrs, "observable": apocentres})
    (line,) = error_of(run).splitlines()
    assert line.startswith("run mapping: stream.b.frame: no section of the stream has such a field; expected one in")


def test_streams_may_have_files_of_their_own(tmp_path: Path) -> None:
    run = {key: value for key, value in RUN.items() if key != "stream"} | {"streams": ["a.toml", "b.toml", "c.toml"]}
    spec = sk.load(files(tmp_path, run, a=STREAM, b=STREAM, c=STREAM))
    assert spec.streams == ("a", "b", "c")
    assert spec.digest() == sk.load(RUN).digest()


@pytest.mark.parametrize(
    ("stream", "text"),
    [
        (STREAM | {"progenitor": PLACE | {"distance": -3}}, "b.toml: progenitor.distance: found -3 kpc"),
        (STREAM | {"frame": "GD2"}, "b.toml: frame: there is no frame 'GD2'"),
        (STREAM | {"potential": {}}, "b.toml: potential: all streams share it; move it into the run file"),
        (STREAM | {"stripping": {"sigma": -1}}, "b.toml: stripping.sigma: found -1 km/s"),
        (STREAM | {"progenitor": {**PLACE, "v_los": 3, "v_loss": 3}}, "b.toml: progenitor.v_loss: the progenitor"),
    ],
)
def test_errors_of_a_stream_s_file_have_its_name(tmp_path: Path, stream: dict[str, Any], text: str) -> None:
    run = {key: value for key, value in RUN.items() if key != "stream"} | {"streams": ["a.toml", "b.toml"]}
    (line,) = error_of(files(tmp_path, run, a=STREAM, b=stream)).splitlines()
    assert line.startswith(f"{tmp_path / ''}/{text}".replace("//", "/"))


def test_a_file_that_is_missing_is_told(tmp_path: Path) -> None:
    (line,) = error_of(files(tmp_path, HOST | {"streams": ["no.toml"]})).splitlines()
    run, stream = tmp_path / "run.toml", tmp_path / "no.toml"
    assert line == f"{run}: streams[0]: {stream}: cannot read the run file: No such file or directory"


@pytest.mark.usefixtures("short_check")
def test_a_directory_of_a_run_holds_the_tables_of_its_streams(tmp_path: Path) -> None:
    """It is read where neither the run file nor the files of the streams are."""
    there = tmp_path / "there"
    there.mkdir()
    rows = "# %ECSV 1.0\n# ---\n# datatype:\n" + "".join(
        f"# - {{name: {name}, unit: deg, datatype: float64}}\n" for name in ("phi1", "phi2", "phi2_error")
    )
    (there / "b.ecsv").write_text(rows + "phi1 phi2 phi2_error\n-5 0 0.2\n5 1 0.2\n")
    run = {key: value for key, value in RUN.items() if key != "stream"}
    run = with_entry(run, "stream_defaults", "observable", "phi2", ...) | {"streams": ["a.toml", "b.toml"]}
    run["sampler"] = {"walkers": 12, "steps": 1}
    path = files(there, run, a=STREAM | {"table": "b.ecsv"}, b=STREAM | {"table": "b.ecsv"})
    spec = sk.load(path)
    np.testing.assert_allclose(spec.bind(stream="b").observable.data(), [[0, 1], [0.2, 0.2]])
    sk.run(path, out=tmp_path / "out", progress=False, products=False)
    for file in there.iterdir():
        file.unlink()
    assert load_spec(tmp_path / "out").digest() == spec.digest()


def test_a_field_of_all_streams_is_set_at_once() -> None:
    spec = sk.load(RUN).with_values({"stream.*.stripping.particles": 50, "stream.b.stripping.particles": 60})
    assert [spec.bind(stream=name).stripping.particles for name in "abc"] == [50, 60, 50]
    assert spec.bind({"stream.*.progenitor.distance": 9.5}, "c").values["stream.c.progenitor.distance"] == 9.5
    with pytest.raises(sk.SpecError, match=r"no field 'stream_defaults.stripping.sigma'. For all streams: stream"):
        spec.with_values({"stream_defaults.stripping.sigma": 2})
    with pytest.raises(sk.SpecError, match=r"no field 'stream.a.stripping.sigmas'. Did you mean 'stream.a.stripping"):
        spec.with_values({"stream.*.stripping.sigmas": 2})


def test_the_schema_allows_what_load_reads(schema: dict[str, Any]) -> None:
    assert accepts(schema, RUN, schema)
    assert accepts(schema, sk.load(RUN).document, schema)
    above = {"table": "b.ecsv", **{key: dict(value) for key, value in WHOLE.items()}}
    assert accepts(schema, HOST | {"stream": {"b": above}}, schema)
    assert accepts(schema, HOST | {"streams": ["b.toml"]}, schema)
    assert not accepts(schema, with_("stream_defaults", "striping", {}), schema)
    assert not accepts(schema, with_("stream", "b", "tabel", "b.ecsv"), schema)
    assert not accepts(schema, HOST | {"stream": {"b": {"progenitor": PLACE}}}, schema)


def test_measurements_are_those_of_the_bound_streams_and_their_tables_are_read_once() -> None:
    spec = sk.load(with_("stream_defaults", "observable", "phi2_dispersion", {"uniform": [0, 1]}))
    names = [f"stream.{name}.observable.phi2_dispersion" for name in "abc"]
    streams, data = spec.measurements(dict(zip(names, [0.1, 0.2, 0.3], strict=True)))
    bound = spec.bind_all(dict(zip(names, [0.4, 0.5, 0.6], strict=True))).streams
    assert data == {}
    pairs = [(*streams[name].values(), *bound[name].observables.values()) for name in "abc"]
    assert [[each.phi2_dispersion for each in pair] for pair in pairs] == [[0.1, 0.4], [0.2, 0.5], [0.3, 0.6]]
    assert all(one.phi2 is other.phi2 for one, other in pairs)
