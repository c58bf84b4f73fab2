"""A class of this file is fitted as it is: by several workers, written, read again and continued."""

import numpy as np
import pytest
from pydantic import Field
from runfiles import FIT

import streamkit as sk
from streamkit.fit import describe_status, read_status


class Own(sk.Potential):
    """The isothermal sphere."""

    kind = "own_isothermal"
    v0: sk.Speed = Field(description="Circular velocity.")

    @staticmethod
    def acceleration(x, y, z, t, v0):
        k = -v0 * v0 / (x * x + y * y + z * z)
        return k * x, k * y, k * z


RUN = FIT | {"potential": {"kind": "own_isothermal", "v0": {"uniform": [190, 220]}}}


@pytest.mark.slow
def test_a_run_with_a_class_given_in_python(tmp_path):
    out = tmp_path / "out"
    first = sk.run(RUN, out, components=[Own], workers=2, progress=False, steps=2)
    assert first.spec.given == (Own,)
    assert (out / "mass_profile.ecsv").exists()
    mass = first.mass_profile(np.array([50.0]))["M"][0].to_value("Msun")  # M(<r) = v0^2 r / G
    v0 = np.median(first.samples[:, 0])
    assert mass == pytest.approx(v0**2 * 50 / sk.G, rel=0.02)
    with pytest.raises(sk.ChainError, match=r"components given in Python \(own_isothermal from Own given.*components="):
        sk.load_results(out)
    known = read_status(out)
    assert (known["state"], known["steps"], known["walkers"]) == ("steps", 2, 6)
    assert "components=[...]" in known["note"]
    assert "steps" in describe_status(out, known)
    go_on = known["go_on"]
    more = "components=[Own], steps=4, resume=True"
    assert go_on == f"streamkit.run({str(out / 'run.toml')!r}, out={str(out)!r}, {more})"
    assert sk.load_results(out, [Own]).spec.digest() == first.spec.digest()
    more = sk.run(out / "run.toml", out, components=[Own], resume=True, progress=False, steps=3, products=False)
    assert len(more.chain) == 3
