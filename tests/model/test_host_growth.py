"""A host that grows, in the run file: today it is what it was, the stream is another, and satellites do not grow."""

from typing import Any

import numpy as np
import pytest
from runfiles import BASE

import streamkit as sk
from streamkit.model import Host

GROWTH = {"t": ["-5000 Myr", -1, 0], "factor": [0.5, 0.9, 1]}
SMALL = BASE | {"stripping": BASE["stripping"] | {"particles": 60}}


def grown(growth: Any, section: str = "potential") -> sk.Spec:
    return sk.load(SMALL | {section: BASE[section] | {"growth": growth}})


@pytest.mark.slow  # tests/engine has a growing halo
def test_a_host_that_grows_is_today_what_it_was_and_has_another_stream() -> None:
    still, growing = sk.load(SMALL), grown(GROWTH)
    assert "growth" not in still.document["potential"]
    assert growing.document["potential"]["growth"] == GROWTH
    assert growing.names == still.names
    radii = np.array([10.0, 50.0, 100.0])
    masses = [Host(spec.bind().potentials).mass_inside(radii) for spec in (still, growing)]
    np.testing.assert_array_equal(*masses)
    first, second = sk.Model(still).stream(), sk.Model(growing).stream()
    assert growing.digest() != still.digest()
    assert np.abs(first.orbit.q[:, -1] - second.orbit.q[:, -1]).max() < 1e-9
    assert np.abs(first.orbit.q[:, 0] - second.orbit.q[:, 0]).max() > 1
    ones = sk.Model(grown({"t": [-9, 9], "factor": [1, 1]})).stream()
    np.testing.assert_allclose(ones.q, first.q, rtol=1e-9)


def test_a_progenitor_does_not_grow() -> None:
    with pytest.raises(sk.SpecError, match=r"progenitor.growth: .*has no field 'growth'"):
        grown(GROWTH, "progenitor")


def test_a_growth_that_is_not_one_today_is_told_with_its_place() -> None:
    with pytest.raises(sk.SpecError, match=r"potential.growth: .*the factor today \(t = 0\) is 0.9, expected 1"):
        grown({"t": [-5, 0], "factor": [0.5, 0.9]})
