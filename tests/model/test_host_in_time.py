"""Numbers of a host that change in time: against static potentials, SciPy's cubic and closed forms; in run files."""

from typing import Any

import numpy as np
import pytest
from runfiles import BASE, accepts, schema_with
from scipy.interpolate import PchipInterpolator

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import MiyamotoNagai
from streamkit.engine import build_field
from streamkit.fields import InTime
from streamkit.model import Host

TIMES, SPEEDS = [-6.0, -3.0, -1.0, 0.0], [150.0, 190.0, 200.0, 230.0]
KNOTS = {"times": ["-6000 Myr", -3, -1, 0], "values": ["150 km/s", 190, 200, 230]}
RNG = np.random.default_rng(11)
Q, T = RNG.normal(0, 20, (3, 60)), np.sort(RNG.uniform(-7, 1, 60)) * sk.GYR
BAR = {"kind": "bar", "mass": 1e10, "a": 3.5, "b": 0.5, "c": 0.6}


def changed(field: str, value: Any, host: Any = None) -> sk.Spec:
    return sk.load(BASE | {"potential": (host or BASE["potential"] | {"v0": 230}) | {field: value}})


def field_of(spec: sk.Spec, **values: Any) -> Any:
    return build_field(list(spec.host(values).values()))


def test_a_speed_in_time_is_that_of_scipy_at_each_time_and_constant_beyond_the_knots() -> None:
    """v0 multiplies the force of `tf` by its square; 60 particles of 60 times, and all of one time."""
    spec = changed("v0", KNOTS)
    still = build_field(list(changed("v0", 1).host().values()))
    v0 = PchipInterpolator(TIMES, SPEEDS)(np.clip(T / sk.GYR, -6, 0))
    np.testing.assert_allclose(
        field_of(spec).acceleration(T, Q), v0**2 * still.acceleration(T, Q), rtol=1e-12, atol=1e-12
    )
    now = PchipInterpolator(TIMES, SPEEDS)(-2.0)
    np.testing.assert_allclose(
        field_of(spec).acceleration(-2 * sk.GYR, Q), now**2 * still.acceleration(0.0, Q), rtol=1e-12, atol=1e-12
    )
    assert spec.host()["potential"].v0 == pytest.approx(230)  # today
    assert Host(spec.host()).circular_velocity(np.array([20.0])) == pytest.approx(
        Host(changed("v0", 230).host()).circular_velocity(np.array([20.0]))
    )


def test_two_parameters_and_growth_change_together() -> None:
    rs = {"times": [-5, 0], "values": [6, "12 kpc"]}
    host = BASE["potential"] | {"v0": KNOTS, "growth": {"t": [-5, 0], "factor": [0.5, 1]}}
    field = field_of(changed("rs", rs, host))
    for t in (-5.0, -1.3, 0.0):
        v0 = float(PchipInterpolator(TIMES, SPEEDS)(t))
        plain = field_of(changed("rs", 12 + 1.2 * t, BASE["potential"] | {"v0": v0}))
        wanted = (1 + 0.1 * t) * plain.acceleration(0.0, Q)
        np.testing.assert_allclose(field.acceleration(t * sk.GYR, Q), wanted, rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize("way", ["pattern_speed", "angle"])
def test_a_bar_that_slows_down_has_the_angle_of_uniform_deceleration(way: str) -> None:
    """angle(t) = angle + omega t + rate t^2 / 2 between the knots, and omega of the first knot before them."""
    omega, rate, first = -39.0, 6.0 / sk.GYR, -4.0 * sk.GYR  # km/s/kpc, and per time

    def angle(t: Any) -> Any:
        inside = np.maximum(t, first)
        return omega * inside + 0.5 * rate * inside**2 + (omega + rate * first) * (t - inside)

    if way == "pattern_speed":
        knots: dict[str, Any] = {"times": [-4, 0], "values": [omega - 4 * rate * sk.GYR, omega]}
        spec = changed("pattern_speed", knots, BAR | {"angle": -27})
        times, tolerance = np.array([-5.0, -4.0, -2.7, -0.1, 0.0]) * sk.GYR, 1e-9
    else:
        t = np.linspace(-4, 0, 201)
        spec = changed("angle", {"times": t.tolist(), "values": (-27 + np.degrees(angle(t * sk.GYR))).tolist()},
                       BAR | {"pattern_speed": 0})  # fmt: skip
        times, tolerance = np.array([-3.999, -2.7, -0.1, 0.0]) * sk.GYR, 2e-4
    field = field_of(spec)
    for t in times:
        still = changed("angle", float(np.degrees(angle(t)) - 27), BAR | {"pattern_speed": 0})
        wanted = field_of(still).acceleration(0.0, 0.3 * Q)
        np.testing.assert_allclose(
            field.acceleration(t, 0.3 * Q), wanted, rtol=0, atol=tolerance * np.abs(wanted).max()
        )


def test_an_orbit_around_a_mass_that_shrinks_slowly_widens_in_proportion() -> None:
    """A circular orbit keeps G M r = L^2 if the mass changes slowly (Jeans 1924)."""
    mass = {"times": [0, 8], "values": [1e11, 0.6e11]}
    field = build_field([sk.load(BASE | {"potential": {"kind": "kepler", "mass": mass}}).host()["potential"]])
    r, v = 2.0, np.sqrt(sk.G * 1e11 / 2.0)
    orbit = field.orbit(np.array([r, 0.0, 0.0]), np.array([0.0, v, 0.0]), 0.0, 8 * sk.GYR, 1e-3)
    assert orbit.r[-1] == pytest.approx(r / 0.6, rel=2e-3)
    np.testing.assert_allclose(orbit.q[0] * orbit.v[1] - orbit.q[1] * orbit.v[0], r * v, rtol=1e-8)


def test_knots_with_priors_are_free_parameters() -> None:
    prior = {"normal": [190, 10]}
    spec = changed("v0", {"times": [-6, 0], "values": [prior, {"uniform": [220, 240]}]})
    assert spec.names[:2] == ("potential.v0.values.0", "potential.v0.values.1")
    assert spec.units[0] == "km/s"
    host = spec.host({"potential.v0.values.0": 170, "potential.v0.values.1": 225})["potential"]
    assert host.v0 == 225
    assert host.in_time["v0"].at(-3) == pytest.approx(197.5)
    again = sk.load(spec.document)
    assert again == spec
    assert again.digest() == spec.digest() != changed("v0", {"times": [-5, 0], "values": [prior, 230]}).digest()
    fixed = spec.with_values({"potential.v0.values.0": "180 km/s"})
    assert fixed.host()["potential"].in_time["v0"].at(-6) == 180
    assert spec.with_values({"potential.v0": 230}).host() == changed("v0", 230).host() != fixed.host()
    schema = schema_with(spec.registry)
    assert accepts(schema, spec.document, schema)


def test_a_stream_of_a_host_in_time_is_another_and_ends_where_its_progenitor_is() -> None:
    small = BASE | {"stripping": BASE["stripping"] | {"particles": 60}}
    specs = [sk.load(small | {"potential": BASE["potential"] | {"v0": v}}) for v in (230, KNOTS)]
    still, moving = (sk.Model(spec).stream() for spec in specs)
    np.testing.assert_allclose(still.orbit.q[:, -1], moving.orbit.q[:, -1], atol=1e-9)
    assert np.abs(still.orbit.q[:, 0] - moving.orbit.q[:, 0]).max() > 1


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("v0", {"times": [-1, 0], "values": [1]}, r"potential.v0: found 2 times and 1 values, expected as many"),
        ("v0", {"times": [0], "values": [1]}, r"found 1 times and 1 values.*2 to 1000"),
        ("v0", {"times": [0, -1], "values": [1, 2]}, r"the times must increase, found -1 Gyr after 0 Gyr"),
        ("v0", {"times": [-1, 0], "value": [1, 2]}, r"no 'value'. Did you mean 'values'\?"),
        ("v0", {"times": [-1, 0]}, r"found no values"),
        ("v0", {"times": "-1", "values": [1, 2]}, r"found times = '-1', expected a list"),
        ("v0", {"times": ["-1 kpc", 0], "values": [1, 2]}, r"potential.v0: expected a quantity in Gyr"),
        ("v0", {"times": [-1, 0], "values": ["1 kpc", 2]}, r"potential.v0: values\[0\]: expected a quantity in km/s"),
        ("v0", {"times": [-1, 0], "values": [{"norml": [1, 2]}, 2]}, r"values\[0\]: no prior is called 'norml'"),
        ("rs", {"times": [-1, 0], "values": [-3, 2]}, r"potential.rs: found -3.0 kpc, should be greater than 0"),
        ("rs", {"times": [-1, 0], "values": [{"uniform": [-1, 3]}, 2]}, r"potential.rs.values.0: the prior .*outside"),
        ("alpha", {"times": [-1, 0], "values": [float("nan"), 0.2]}, r"potential.alpha: values\[0\]: found nan"),
    ],
)  # fmt: skip
def test_bad_knots_are_told(field: str, value: Any, said: str) -> None:
    with pytest.raises(sk.SpecError, match=said):
        changed(field, value)


def test_what_cannot_change_in_time_is_told() -> None:
    knots = {"times": [-1, 0], "values": [1, 1]}
    with pytest.raises(sk.SpecError, match=r"progenitor.mass: only a number of a host's potential may change"):
        sk.load(BASE | {"progenitor": BASE["progenitor"] | {"mass": knots}})
    table = {"l": [0] * 4, "m": [0] * 4, "r": [1, 2, 3, 4], "phi": [-4, -3, -2, -1]}
    with pytest.raises(sk.SpecError, match=r"potential.factor of the potential 'multipole' cannot .*Give growth"):
        changed("factor", knots, {"kind": "multipole", "table": table})
    with pytest.raises(sk.SpecError, match=r"v_circ of the potential 'hernquist_vcirc' cannot .*computed once"):
        changed("v_circ", knots, {"kind": "hernquist_vcirc", "mass": 1e12, "r": 8})
    with pytest.raises(sk.SpecError, match=r"pattern_speed .* is the rate of angle, which changes in time too"):
        changed("angle", knots, BAR | {"pattern_speed": knots})
    with pytest.raises(sk.SpecError, match=r"sun.u: only a number of a host's"):
        sk.load(BASE | {"sun": {"u": knots}})


@pytest.mark.parametrize("compiled", [True, False])
def test_a_turned_halo_changes_in_time_along_its_axes(compiled: bool) -> None:
    """A disc on its side whose mass changes is the static one times the factor of its mass."""
    fields = {"mass": sk.Mass, "a": sk.Length, "b": sk.Length}
    members = {"__annotations__": fields, "__module__": __name__, "__doc__": "Plain."}
    plain = type("P", (sk.Potential,), members | {
        "kind": "plain_disc", "compiled": False, "acceleration": staticmethod(MiyamotoNagai.acceleration)})  # fmt: skip
    cls = MiyamotoNagai if compiled else plain
    disc = cls(mass=1e11, a=3.0, b=0.3, orientation=[20.0, 70.0, 10.0])
    moving = disc.changing({"mass": InTime((-4.0, 0.0), (0.2e11, 1e11))})
    wanted = np.clip(1 + 0.2 * T / sk.GYR, 0.2, 1) * build_field([disc]).acceleration(T, Q)
    np.testing.assert_allclose(build_field([moving]).acceleration(T, Q), wanted, rtol=1e-11)
