"""Bodies in a run file: read, bound, written back, and what is refused."""

from typing import Any

import numpy as np
import pytest
from runfiles import BASE, changed, error_of

import streamkit as sk
from streamkit.runfile import Sun
from streamkit.stream import seen_from, sky_matrix, to_galactocentric

LMC: dict[str, Any] = {
    "kind": "hernquist", "mass": {"log_uniform": ["3e10 Msun", "3e11 Msun"]}, "a": "16 kpc",
    "ra": 81.28, "dec": "-69.78 deg", "distance": {"normal": [49.6, 0.5]},
    "pm_ra_cosdec": 1.858, "pm_dec": 0.385, "v_los": 262.2,
}  # fmt: skip
TF = {"kind": "tf", "v0": 30, "rs": 5, "alpha": 0.4, "x": 5, "y": 1, "z": 0, "vx": 0, "vy": 200, "vz": 10}
CLUMP = {"kind": "kepler", "mass": 1e7, "x": 5.0, "y": 1.0, "z": 0.0, "vx": 0.0, "vy": 200.0, "vz": 10.0}


def test_a_body_is_read_with_its_priors_and_placed_with_the_sun():
    spec = sk.load(changed("body", {"lmc": LMC, "clump": CLUMP | {"friction": "none", "reflex": False}}))
    assert spec.names[-2:] == ("body.lmc.mass", "body.lmc.distance")
    inputs = spec.bind({"body.lmc.distance": 50.0, "body.lmc.mass": "1.4e11 Msun"})
    lmc, clump = inputs.bodies["lmc"], inputs.bodies["clump"]
    sun = spec.sections.sun.centre
    q, v = to_galactocentric("icrs", 81.28, -69.78, 50.0, 1.858, 0.385, 262.2, sun.observer)
    assert np.allclose(lmc.q, q)
    assert np.allclose(lmc.v, v)
    assert (lmc.mass, lmc.extent, lmc.friction, lmc.reflex) == (1.4e11, 16.0, True, True)
    assert (clump.mass, clump.extent, clump.friction, clump.reflex) == (1e7, 0.0, False, False)
    assert list(clump.q) == [5.0, 1.0, 0.0]


def test_bodies_are_written_with_their_defaults_and_read_again():
    spec = sk.load(changed("body", {"lmc": LMC}))
    written = spec.document["body"]["lmc"]
    assert written["friction"] == "chandrasekhar"
    assert written["reflex"] is True
    assert list(written)[: len(LMC)] == list(LMC)
    assert sk.load(spec.document) == spec
    assert sk.load(spec.document).digest() == spec.digest()
    assert ("body.lmc", "hernquist") in [(path, cls.kind) for path, cls, _ in spec.components()]


def test_a_field_of_a_body_can_be_replaced_and_counts():
    spec = sk.load(changed("body", {"lmc": LMC}))
    other = spec.with_values({"body.lmc.friction": "none", "body.lmc.mass": 1e11})
    assert not other.bind().bodies["lmc"].friction
    assert other.digest() != spec.digest()


def test_a_run_file_without_bodies_stays_what_it_was():
    spec = sk.load(BASE)
    assert "body" not in spec.document
    assert spec.bind().bodies == {}
    assert sk.load(changed("body", {})).digest() == spec.digest()


@pytest.mark.parametrize(
    ("body", "parts"),
    [
        (3, ["body: found 3, expected a section, [body]"]),
        (LMC, ["body: found a kind, expected a section [body.NAME]"]),
        ({"lmc": 3}, ["body.lmc: found 3, expected a section [body.lmc] with a kind"]),
        ({"l.mc": LMC}, ["body.l.mc: the name of a body may not contain a dot"]),
        ({"lmc": {}}, ["body.lmc: 'kind' is missing; it names the potential"]),
        ({"lmc": LMC | {"kind": "hernqist"}}, ["body.lmc.kind", "Did you mean 'hernquist'?"]),
        (
            {"lmc": LMC | {"kind": "tf"}},
            ["body.lmc.kind: the potential 'tf' has no field 'mass' in Msun", "a body needs a mass, hernquist has one"],
        ),
        (
            {"clump": TF},
            ["body.clump.kind: the potential 'tf' has no field 'mass' in Msun, and its force gives an infinite mass"],
        ),
        (
            {"lmc": LMC | {"friction": "chandra"}},
            ["found 'chandra'", "Did you mean 'chandrasekhar'?"],
        ),
        ({"lmc": LMC | {"reflex": 1}}, ["body.lmc.reflex: found 1, expected true or false"]),
        (
            {"lmc": LMC | {"lookback": 3}},
            ["body.lmc.lookback: the body (hernquist, equatorial", "has no field"],
        ),
        ({"lmc": LMC | {"mass": -1}}, ["body.lmc.mass: found -1 Msun, should be greater than 0"]),
        ({"lmc": LMC | {"x": 1.0}}, ["body.lmc: found coordinates of several sets", "x, y, z, vx, vy, vz"]),
        ({"lmc": {"kind": "hernquist", "mass": 1e11, "a": 10}}, ["body.lmc: found no phase-space coordinates"]),
        ({"lmc": {k: v for k, v in LMC.items() if k != "v_los"}}, ["body.lmc.v_los: missing"]),
        (
            {"c": {"kind": "isochrone", "mass": 1e9, "l": 3, "distance": 8}},
            ["body.c: ", "Galactic sky is not available here: the body's potential has a field b of its own"],
        ),
    ],
)
def test_bad_bodies(body, parts):
    error = error_of(changed("body", body))
    for part in parts:
        assert part in error


def test_the_schema_knows_bodies(schema):
    body = schema["properties"]["body"]["additionalProperties"]
    names = str(body)
    assert "body.hernquist.BodyEquatorialSky" in names
    fields = schema["$defs"]["body.hernquist.BodyEquatorialSky"]["properties"]
    assert {"kind", "mass", "a", "ra", "friction", "reflex"} <= fields.keys()
    assert "lookback" not in fields
    assert not any("tf" in name for name in schema["$defs"] if name.startswith("body."))


def test_a_body_may_be_placed_in_the_frame_of_a_stream():
    """The six numbers are those of another set of coordinates in that frame."""
    frame = {"pole": [78.8, 21.0], "origin": [80.0, -69.0]}
    result = {"kind": "hernquist", "mass": 1e11, "a": 16.0}
    body = sk.load(changed("body", {"lmc": LMC})).bind().bodies["lmc"]
    seen = seen_from(Sun().observer, body.q[:, None], body.v[:, None], sky_matrix(frame))
    names = ("phi1", "phi2", "distance", "pm_phi1_cosphi2", "pm_phi2", "v_los")
    place = {name: float(value[0]) for name, value in zip(names, seen, strict=False)}
    there = sk.load(changed("body", {"lmc": result | place | {"frame": frame}})).bind().bodies["lmc"]
    np.testing.assert_allclose(there.q, body.q, rtol=1e-9)
    np.testing.assert_allclose(there.v, body.v, rtol=1e-9)
