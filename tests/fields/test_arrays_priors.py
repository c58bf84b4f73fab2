"""Priors on the entries of an array: names, values, resolved documents, and what is wrong."""

import math
import pickle
import tomllib
from typing import Any

import numpy as np
import pytest
from runfiles import BASE

import streamkit as sk
from streamkit.model import Host

V = [{"normal": [230, 10]}, "220 km/s", {"uniform": ["180000 m/s", 210]}, 150.0]
TABLE = {"kind": "spherical_table", "r": [4.0, 10.0, 30.0, 100.0], "v_c": V}
NAMES = ("potential.v_c.0", "potential.v_c.2")


def spec_with(**values: Any) -> sk.Spec:
    return sk.load(BASE | {"potential": TABLE | values})


def test_entries_with_priors_are_free_parameters() -> None:
    spec = spec_with()
    assert spec.names[:2] == NAMES
    assert spec.units[:2] == ("km/s", "km/s")
    assert spec.symbols[:2] == NAMES
    assert spec.centre()[:2].tolist() == [230.0, 195.0]
    assert [p.support for p in spec.priors[:2]] == [(-math.inf, math.inf), (180.0, 210.0)]


def test_binding_gives_the_values_and_leaves_the_others() -> None:
    spec = spec_with()
    bound = spec.bind({"potential.v_c.2": 200.0}).potentials["potential"]
    assert bound.v_c.tolist() == [230.0, 220.0, 200.0, 150.0]  # type: ignore[attr-defined]
    assert spec.bind().potentials["potential"].v_c.tolist() == [230.0, 220.0, 195.0, 150.0]  # type: ignore[attr-defined]
    speed = Host({"halo": bound}).circular_velocity(np.array([4.0, 10.0, 30.0, 100.0]))
    np.testing.assert_allclose(speed, [230, 220, 200, 150], rtol=1e-8)
    with pytest.raises(sk.OutOfDomain, match=r"potential.* outside its allowed range"):
        spec.bind({"potential.v_c.0": -1.0})


def test_the_resolved_file_gives_the_same_spec() -> None:
    spec = spec_with()
    assert spec.document["potential"]["v_c"][2] == {"uniform": ["180.0 km/s", "210.0 km/s"]}
    assert spec.document["potential"]["v_c"][1] == "220 km/s"
    again = sk.load(tomllib.loads(spec.toml()))
    assert again == spec
    assert again.digest() == spec.digest() == pickle.loads(pickle.dumps(spec)).digest()


def test_entries_are_set_by_their_number() -> None:
    spec = spec_with().with_values({"potential.v_c.0": "235 km/s", "potential.v_c.3": {"normal": [150, 5]}})
    assert spec.names[:2] == ("potential.v_c.2", "potential.v_c.3")
    assert spec.bind().potentials["potential"].v_c.tolist() == [235.0, 220.0, 195.0, 150.0]  # type: ignore[attr-defined]
    with pytest.raises(sk.SpecError, match=r"no field 'potential.v_c.4'. Did you mean"):
        spec.with_values({"potential.v_c.4": 100.0})
    with pytest.raises(sk.SpecError, match="fixed in the run file: use with_values"):
        spec.bind({"potential.v_c.1": 200.0})


@pytest.mark.parametrize(
    ("v_c", "said"),
    [
        ([{"normel": [230, 10]}, 1, 1, 1], r"potential.v_c.0: no prior is called 'normel'. Did you mean 'normal'"),
        ([{"uniform": [230, "10 kpc"]}, 1, 1, 1], r"potential.v_c.0: .*expected a quantity in km/s"),
        ([{"uniform": [-10, 300]}, 1, 1, 1], r"potential.v_c: a prior reaches outside the field's range"),
        ({"normal": [230, 10]}, "takes no prior"),
    ],
)
def test_a_wrong_prior_is_told_at_its_place(v_c: Any, said: str) -> None:
    with pytest.raises(sk.SpecError, match=said):
        spec_with(v_c=v_c)
