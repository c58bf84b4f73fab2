"""The public seam of live progenitors, used as a stranger would: the evaporation of a star cluster."""

from pathlib import Path

import numpy as np
import pytest

import streamkit as sk
from streamkit import BlockEdge, LiveStripping, Population, Remnant, testing
from streamkit.builtin.potentials.closed_forms import Plummer
from streamkit.components import load_registry

EXAMPLE = Path(__file__).parents[1] / "examples" / "evaporation.py"
Evaporation = load_registry([EXAMPLE]).find("stripping", "evaporation", "stripping.kind")

CLUSTER = {
    "seed": 3,
    "potential": {"kind": "tf", "v0": 220.0, "rs": 15.0, "alpha": 0.3},
    "progenitor": {
        "kind": "plummer", "mass": 2e4, "radius": 0.012, "x": 12.0, "y": 0.0, "z": 5.0, "vx": 0.0, "vy": 180.0,
        "vz": 60.0, "lookback": 1.0,
    },
    "stripping": {"kind": "evaporation", "particles": 500, "step": 0.001, "lifetime": 2.0},
}  # fmt: skip


def stream(components=(Evaporation,), **changes):
    document = {**CLUSTER, "stripping": {**CLUSTER["stripping"], **changes}}
    return sk.Model(sk.load(document, components=components)).stream()


def test_evaporating_cluster_loses_its_mass_as_it_says():
    found = stream()
    assert found.orbit.mass_left[0] == pytest.approx(1, abs=0.005)
    assert found.orbit.mass_left[-1] == pytest.approx(0.5, abs=0.01)
    t = (found.orbit.t - found.orbit.t[0]) / sk.GYR
    assert np.abs(found.orbit.mass_left - (found.orbit.mass_left[0] - 0.5 * t)).max() < 0.011
    slower = stream(lifetime=20.0)
    assert (~found.bound).sum() > (~slower.bound).sum()


def test_particles_that_the_scheme_calls_bound_are():
    found = stream()
    d = np.sqrt(((found.q - found.orbit.q[:, -1:]) ** 2).sum(axis=0))
    assert np.median(d[found.bound]) < 0.05
    assert (found.t_strip[found.bound] == 0).all()


def test_the_names_of_contract_1_work_with_a_warning():
    with pytest.warns(DeprecationWarning, match="is now") as warned:

        class Former(LiveStripping):
            """The same scheme by the former names."""

            kind = "former"
            renewal = 0.02

            def renew(self, edge, satellite, before):
                """Return the remnant of the present scheme."""
                return Evaporation().update_remnant(edge, satellite, before)

    class Present(LiveStripping):
        """The same scheme by the present names."""

        kind = "former"
        longest_block = 0.02

        def update_remnant(self, edge, satellite, previous):
            """Return the remnant of the other scheme, by its former name."""
            with pytest.warns(DeprecationWarning, match="Former.renew is now update_remnant"):
                return Former().renew(edge, satellite, previous)

    assert [str(one.message).split(":")[0] for one in warned] == [
        "Former.renew is now update_remnant",
        "Former.renewal is now longest_block",
    ]
    assert (Former.longest_block, Former.__abstractmethods__) == (0.02, frozenset())
    both = [
        sk.Model(sk.load({**CLUSTER, "stripping": {"kind": "former", "particles": 500}}, components=[one])).stream()
        for one in (Former, Present)
    ]
    assert np.array_equal(both[0].q, both[1].q)


def test_scheme_of_a_stranger_passes_the_conformance_tests():
    testing.check(Evaporation, slow=True)


class Sick(LiveStripping):
    """Fails in the way that a field says."""

    kind = "sick"
    fault: str = "mass"

    def populate(self, core, satellite, points):
        """Fill the progenitor, or not."""
        people = super().populate(core, satellite, points)
        if self.fault == "shape":
            return Population(people.q[:, :5], people.v, people.mass, people.weight)
        if self.fault == "nan":
            return Population(people.q * np.nan, people.v, people.mass, people.weight)
        if self.fault == "hot":
            v = core[3:6, None]
            return Population(people.q, v + 100 * (people.v - v), people.mass, people.weight)
        return people

    def update_remnant(self, edge: BlockEdge, satellite, previous):
        """Return a remnant, or raise."""
        if self.fault == "raise":
            raise RuntimeError("no idea")
        bound = ((edge.v - edge.core[3:6, None]) ** 2).sum(axis=0) < 4 * sk.G * satellite.mass / satellite.scale
        mass = -1.0 if self.fault == "mass" else float(edge.mass[bound].sum())
        return Remnant(Plummer(mass=satellite.mass, radius=satellite.scale), mass, bound)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("mass", r"stripping sick: `update_remnant` gave the bound mass -1.0, expected zero or more"),
        ("shape", r"stripping sick: `populate` gave q of the shape \(3, 5\), expected \(3, 500\)"),
        ("nan", r"stripping sick: `populate` gave q with numbers that are not finite"),
        ("raise", r"stripping sick failed: RuntimeError in .*update_remnant: no idea"),
    ],
)
def test_faults_name_the_scheme(fault, words):
    document = {**CLUSTER, "stripping": {"kind": "sick", "particles": 500, "fault": fault}}
    with pytest.raises(sk.ComponentError, match=words):
        sk.Model(sk.load(document, components=[Sick])).stream()


def test_particles_hotter_than_their_escape_speed_are_refused():
    document = {**CLUSTER, "stripping": {"kind": "sick", "particles": 500, "fault": "hot"}}
    with pytest.raises(sk.OutOfDomain, match="less than half of the progenitor plummer is bound"):
        sk.Model(sk.load(document, components=[Sick])).stream()
