"""One table for all columns of `track`: the data, likelihood and mocks of a table for each column."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.table import Table
from pydantic import ValidationError

import streamkit as sk
from streamkit.builtin.observables.track.observable import Track
from streamkit.study.preflight.corrections import corrected
from streamkit.testing.streams import example_stream

FRAME = {"pole": [192.86, 27.13], "origin": [266.4, -28.94]}
UNITS = {"phi1": "deg", "phi2": "deg", "distance": "kpc", "pm_phi2": "mas/yr", "radial_velocity": "km/s"}
NAN = float("nan")
SHARED: dict[str, list[float]] = {
    "phi1": [-30.0, -10.0, 10.0, 30.0],
    "phi2": [1.0, 0.5, -0.5, -1.0], "phi2_error": [0.3, 0.2, 0.2, 0.3],
    "distance": [20.0, NAN, 21.0, NAN], "distance_error": [1.0, NAN, 2.0, NAN],
    "radial_velocity": [NAN, NAN, NAN, -30.0], "radial_velocity_error": [NAN, NAN, NAN, 3.0],
    "distance_depth": [2.0, NAN, NAN, NAN], "distance_depth_error": [0.5, NAN, NAN, NAN],
}  # fmt: skip
APART: dict[str, Any] = {  # the same data
    "phi2": {"phi1": SHARED["phi1"], "phi2": SHARED["phi2"], "error": SHARED["phi2_error"]},
    "distance": {"phi1": [-30, 10], "distance": [20, 21], "error": [1, 2]},
    "radial_velocity": {"phi1": [30], "radial_velocity": [-30], "error": [3]},
    "distance_depth": {"phi1": [-30], "depth": [2], "error": [0.5]},
}


def test_data_and_likelihood_are_those_of_a_table_for_each_column() -> None:
    both: list[Any] = [{"table": SHARED}, APART]
    one, several = (Track(frame=FRAME, kernel=5, stars=["radial_velocity"], **each) for each in both)
    assert one.names == several.names
    np.testing.assert_array_equal(one.data(), several.data())
    stream = example_stream()
    made = one.predict(stream)
    np.testing.assert_array_equal(made.mean, several.predict(stream).mean)
    assert one.ln_likelihood(made, True) == several.ln_likelihood(made, True)


def test_a_file_gives_all_columns_by_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    table = Table({name: column for name, column in SHARED.items() if "depth" not in name}, masked=True)
    for name in table.colnames:
        table[name].unit = UNITS[name.removesuffix("_error")]
        table[name].mask = np.isnan(SHARED[name])
    table.write("stream.ecsv")
    read = Track(frame=FRAME, table="stream.ecsv")
    assert {name: len(part[0]) for name, part in read.given.items()} == {"phi2": 4, "distance": 2, "radial_velocity": 1}
    chosen = Track(frame=FRAME, table="stream.ecsv", compared=["distance"])
    np.testing.assert_array_equal(chosen.data(), [[20, 21], [1, 2]])


def test_mocks_scatter_as_the_data_and_keep_the_gaps() -> None:
    track, stream, rng = Track(frame=FRAME, table=SHARED, kernel=5), example_stream(), np.random.default_rng(1)
    prediction = track.predict(stream)
    mocks = [Track(frame=FRAME, kernel=5, **track.mock(prediction, rng)) for _ in range(400)]
    assert {mock.names for mock in mocks} == {track.names}
    pulls = (np.array([mock.data()[0] for mock in mocks]) - prediction.mean) / track.data()[1]
    narrow = [i for i, name in enumerate(track.names) if "depth" not in name]
    assert np.abs(pulls[:, narrow].mean(axis=0)).max() < 4 / np.sqrt(400)
    assert np.abs(pulls[:, narrow].std(axis=0) - 1).max() < 4 / np.sqrt(800)


def test_likely_mistakes_in_the_shared_table_are_tried() -> None:
    changes = dict(corrected(Track(frame=FRAME, table=SHARED)))
    turned = changes["the opposite sign of radial_velocity in table"]
    assert isinstance(turned, Track)
    assert turned.given["radial_velocity"][1] == 30


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"table": {"phi1": [1], "distance": [3]}}, "the column 'distance_error' is missing"),
        ({"table": SHARED | {"phi2_error": [0.1, NAN, 0.1, 0.1]}}, "phi2: row 2 has a value and no error"),
        ({"table": {"phi2": [1], "phi2_error": [3]}}, "the column 'phi1' is missing"),
        ({"table": {"phi1": [1], "pm": [3]}}, "there is no column 'pm'"),
        ({"table": {"fil": "t.ecsv"}}, "there is no column 'fil'. Did you mean 'file'?"),
        ({"table": SHARED | {"pm_error": [1] * 4}}, "Did you mean 'pm_phi1_cosphi2_error' or 'pm_phi2_error'?"),
        ({"table": {"phi1": [1]}}, "there are no data"),
        ({"table": {"phi1": [1], "phi2": [NAN], "phi2_error": [NAN]}}, "there are no data"),
        ({"table": SHARED, "phi2": APART["phi2"]}, "phi2 is a table and also in table: leave it out of `compared`"),
        ({"table": SHARED, "compared": ["pm_phi2"]}, "table has no pm_phi2; it has phi2, distance, radial_velocity"),
        ({"table": SHARED, "stars": ["pm_phi2"]}, "there is no table of 'pm_phi2'"),
        ({"table": SHARED, "members": {"ra": [1], "dec": [2]}}, "phi2 is in table and also in members"),
    ],
)
def test_tables_that_are_wrong_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        Track(frame=FRAME, **given)


def test_members_give_what_the_table_lacks() -> None:
    stars = {"ra": [266.4], "dec": [-28.9], "radial_velocity": [5.0], "radial_velocity_error": [2.0]}
    positions = {"phi1": [0.0], "phi2": [0.0], "phi2_error": [0.1]}
    track = Track(frame=FRAME, table=positions, members=stars, compared=["phi2", "radial_velocity"])
    assert {name: part[1].tolist() for name, part in track.given.items()} == {"phi2": [0.0], "radial_velocity": [5.0]}


def test_a_resolved_run_file_keeps_the_table() -> None:
    spec = sk.load({
        "potential": {"kind": "tf", "v0": 220, "rs": 12, "alpha": 0.4},
        "progenitor": {"kind": "plummer", "mass": 1e8, "radius": 1, "x": 20, "y": 0, "z": 0, "vx": 0, "vy": 150,
                       "vz": 50, "lookback": 1},
        "stripping": {"kind": "mlcs", "particles": 100, "sigma": 5},
        "observable": {"kind": "track", "frame": FRAME, "table": SHARED},
    })  # fmt: skip
    again = sk.load(spec.document)
    assert again.digest() == spec.digest()
    np.testing.assert_array_equal(again.bind().observable.data(), spec.bind().observable.data())
