"""gala's potentials in streamkit: against closed forms and gala's own integrator, and a sentence for bad input."""

import copy
import importlib.util
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from click.testing import CliRunner
from gala.potential import NFWPotential
from gala.units import galactic
from scipy.interpolate import CubicSpline
from streamkit_gala import Gala
from streamkit_gala.catalogue import classes, parameters_of

import streamkit as sk
from streamkit.cli.main import main
from streamkit.engine import build_field
from streamkit.testing import check

ROOT = Path(__file__).parents[3]
Q = np.random.default_rng(1).normal(size=(3, 300)) * np.geomspace(0.3, 80, 300)  # kpc
HALO = {"kind": "gala", "name": "NFWPotential", "m": "5e11 Msun", "r_s": "15.6 kpc"}
RUN = {
    "seed": 7,
    "potential": {"kind": "gala", "name": "MilkyWayPotential", "version": "v2"},
    "progenitor": {
        "kind": "plummer", "mass": {"log_uniform": [1e8, "1e9 Msun"]}, "radius": 0.85,
        "x": 19.0, "y": 0.0, "z": -5.7, "vx": 176.0, "vy": 0.0, "vz": 202.0, "lookback": 2.0,
    },
    "stripping": {"kind": "mlcs", "particles": 300, "sigma": 10.0},
}  # fmt: skip


def made(name, **fields):
    section = {"name": name, "expansion": "none", **fields}
    return Gala.for_section(section)(**section)


def ours(kind, **fields):
    """A potential of streamkit's own."""
    return loaded(kind=kind, **fields).bind().potentials["potential"]


def acceleration(*potentials, q=Q):
    return build_field(potentials).acceleration(0.0, q)


def error(found, wanted):
    return np.abs(found - wanted).max(axis=0) / np.sqrt((wanted**2).sum(axis=0))


def loaded(**potential):
    document = copy.deepcopy(RUN)
    document["potential"] = potential
    return sk.load(document, components=[Gala])


MN = ("miyamoto_nagai", {"mass": 6.8e10, "a": 3, "b": 0.28})
SAME = [
    (("NFWPotential", {"m": 5e11, "r_s": 16}), ("nfw", {"mass": 5e11, "rs": 16})),
    (("MiyamotoNagaiPotential", {"m": "6.8e10 Msun", "a": "3 kpc", "b": "280 pc"}), MN),
    (("HernquistPotential", {"m": 5e9, "c": "1 kpc"}), ("hernquist", {"mass": 5e9, "a": 1})),
    (("PlummerPotential", {"m": 5e9, "b": 2}), ("plummer", {"mass": 5e9, "radius": 2})),
    (("KeplerPotential", {"m": 5e9}), ("kepler", {"mass": 5e9})),
]  # fmt: skip


@pytest.mark.parametrize(("theirs", "own"), SAME, ids=[theirs[0] for theirs, _ in SAME])
def test_exactly_our_own(theirs, own):
    (name, fields), same = theirs, ours(own[0], **own[1])
    potential = made(name, **fields)
    assert error(acceleration(potential), acceleration(same)).max() < 1e-10
    x, y, z = Q
    given = type(potential).potential(x, y, z, 0.0, *potential.in_engine_units())
    wanted = type(same).potential(x, y, z, 0.0, *same.in_engine_units())
    assert np.allclose(given - given[0], wanted - wanted[0], rtol=1e-9, atol=1e-6)


def test_the_logarithmic_halo_is_the_formula():
    """Phi = v_c^2 / 2 ln(r_h^2 + x'^2/q1^2 + y'^2/q2^2 + z^2/q3^2), x', y' turned by phi."""
    potential = made("LogarithmicPotential", v_c="172 km/s", r_h="12 kpc", q1=1.38, q2=1.0, q3=1.36, phi="97 deg")
    c, s = np.cos(np.radians(97)), np.sin(np.radians(97))
    x, y = c * Q[0] + s * Q[1], c * Q[1] - s * Q[0]
    k = -(172.0**2) / (12.0**2 + (x / 1.38) ** 2 + y**2 + (Q[2] / 1.36) ** 2)
    fx, fy = k * x / 1.38**2, k * y
    wanted = np.array([c * fx - s * fy, s * fx + c * fy, k * Q[2] / 1.36**2])
    assert error(acceleration(potential), wanted).max() < 1e-10


def test_an_orientation_is_galas_rotation():
    angles = [25.0, 40.0, -70.0]
    ca, cb, cg = np.cos(np.radians(angles))
    sa, sb, sg = np.sin(np.radians(angles))
    rows = [ca * cg - sa * cb * sg, sa * cg + ca * cb * sg, sb * sg], [-ca * sg - sa * cb * cg, ca * cb * cg - sa * sg,
            sb * cg], [sa * sb, -ca * sb, cb]  # fmt: skip
    gala = NFWPotential(m=5e11, r_s=16, a=1, b=0.85, c=0.7, units=galactic, R=np.array(rows))
    wanted = -gala.gradient(Q * u.kpc).to_value("km2 / (s2 kpc)")
    own = ours("nfw_triaxial", mass=5e11, rs=16, p=0.85, q=0.7, orientation=angles)
    plain = made("NFWPotential", m=5e11, r_s=16, a=1, b=0.85, c=0.7, orientation=angles)
    assert error(acceleration(own), wanted).max() < 1e-9
    assert error(acceleration(plain), wanted).max() < 1e-9


def test_a_milky_way_has_the_parameters_of_its_parts():
    parts = made("MilkyWayPotential2022")
    heavier = made("MilkyWayPotential2022", halo_m="8e11 Msun")
    more = made("NFWPotential", m=8e11 - parts.halo_m, r_s=parts.halo_r_s)
    assert error(acceleration(parts, more), acceleration(heavier)).max() < 1e-10
    assert parts.disk_h_R == 2.6
    v2 = made("MilkyWayPotential", version="v2")
    v1 = made("MilkyWayPotential", version="v1")
    assert np.array_equal(acceleration(v2), acceleration(parts))
    assert v1.disk_a == 3.0
    assert not hasattr(v2, "disk_a")


def test_the_expansion_is_the_potential_to_its_tolerance():
    section = {"name": "MilkyWayPotential", "version": "v2", "tolerance": 1e-4}
    expanded = Gala.for_section(section)(**section)
    far = Q[:, np.sqrt((Q**2).sum(axis=0)) > 0.5]
    result = build_field([expanded.in_loop()]).acceleration(0.0, far)
    assert error(result, acceleration(made("MilkyWayPotential", version="v2"), q=far)).max() < 1e-4


@pytest.mark.parametrize(
    "section", [Gala.example, {k: v for k, v in HALO.items() if k != "kind"}], ids=["model", "nfw"]
)
def test_conforms(section):
    cls = Gala if section is Gala.example else Gala.for_section(section)
    cls.example = section
    check(cls)


def test_times_are_not_given_to_gala():
    """gala 1.11 returns gradients in wrong places for an array of times."""
    potential = made("NFWPotential", m=5e11, r_s=16)
    times = np.linspace(-3, 0, Q.shape[1])
    result = np.array(type(potential).acceleration(*Q, times, *potential.in_engine_units()))
    assert np.array_equal(result, acceleration(potential))


def test_read_only_positions_are_left_alone():
    potential, q = made("NFWPotential", m=5e11, r_s=16), Q.copy()
    q.flags.writeable = False
    type(potential).acceleration(*q, 0.0, *potential.in_engine_units())
    assert np.array_equal(q, Q)


def test_priors_units_and_digest():
    spec = loaded(**HALO | {"m": {"log_uniform": ["2e11 Msun", "1e12 Msun"]}, "r_s": "50000 lyr"})
    assert spec.names[0] == "potential.m"
    values = spec.document["potential"]
    assert values["r_s"].startswith("15.33")
    assert (values["kind"], values["name"], values["a"]) == ("gala", "NFWPotential", 1.0)
    assert spec.bind({"potential.m": 3e11}).potentials["potential"].m == 3e11
    again = pickle.loads(pickle.dumps(spec))
    assert (again, again.digest()) == (spec, spec.digest())
    assert loaded(**HALO).digest() != loaded(**HALO | {"a": 1.1}).digest()


def test_a_stream_in_a_milky_way_is_that_of_the_compiled_preset():
    theirs = sk.Model(loaded(kind="gala", name="MilkyWayPotential", version="v2")).stream()
    ours = sk.Model(loaded(preset="gala_v2")).stream()
    apart = np.sqrt(((theirs.q - ours.q) ** 2).sum(axis=0))
    assert np.median(apart) < 0.02


SIZES = [0.4, 0.6, 0.9, 1.0]
GROWING = {
    "name": "TimeInterpolatedPotential", "potential_cls": "HernquistPotential", "time_knots": ["-3 Gyr", -2, -1, 0],
    "m": [1e11 * size for size in SIZES], "c": "10 kpc",
}  # fmt: skip
COEFFICIENTS = GROWING | {
    "potential_cls": "SCFPotential", "m": 1e11, "r_s": 10.0, "Tnlm": [[[0.0]], [[0.0]]],
    "Snlm": [[[[size]], [[0.0]]] for size in SIZES],
}  # fmt: skip
del COEFFICIENTS["c"]


@pytest.mark.parametrize("changing", [GROWING, COEFFICIENTS], ids=["mass", "coefficients"])
def test_what_changes_is_expanded_at_times(changing):
    """gala's splines are natural ones; the first function of the basis is a Hernquist sphere."""
    factor = CubicSpline([-3, -2, -1, 0], SIZES, bc_type="natural")
    potential = loaded(kind="gala", **changing).bind().potentials["potential"]
    assert potential.known_times()[[0, -1]] == pytest.approx([-3, 0])
    t = np.random.default_rng(2).uniform(-3, 0, Q.shape[1])
    exact = factor(t) * acceleration(ours("hernquist", mass=1e11, a=10))
    assert error(build_field([made(**changing)]).acceleration(t * sk.GYR, Q), exact).max() < 1e-9
    assert error(build_field([potential]).acceleration(t * sk.GYR, Q), exact).max() < 3e-4
    assert pickle.loads(pickle.dumps(potential)) == potential
    if changing is GROWING:
        energy = type(potential).potential(*Q, t * sk.GYR, *potential.in_engine_units())
        wanted = -factor(t) * sk.G * 1e11 / (10 + np.sqrt((Q**2).sum(axis=0)))
        assert energy == pytest.approx(wanted, rel=1e-9)


def test_a_scale_that_changes_is_known_between_its_times():
    """The radius of a Plummer sphere through natural splines: what the force is at each time."""
    radii = CubicSpline([-3, -1.5, 0], [8, 5, 4], bc_type="natural")
    fields = {"potential_cls": "PlummerPotential", "time_knots": [-3, -1.5, 0], "m": "1e11 Msun", "b": [8, 5, "4 kpc"]}
    potential = loaded(kind="gala", name="TimeInterpolatedPotential", **fields).bind().potentials["potential"]
    t = np.random.default_rng(2).uniform(-3, 0, Q.shape[1])
    exact = -sk.G * 1e11 * Q / ((Q**2).sum(axis=0) + radii(t) ** 2) ** 1.5
    assert error(build_field([potential]).acceleration(t * sk.GYR, Q), exact).max() < 3e-4


def test_what_gala_refuses_is_no_stream():
    wrong = COEFFICIENTS | {"Snlm": [[[[1.0]], [[0.0]]]] * 3}
    with pytest.raises(sk.OutOfDomain, match="gala's TimeInterpolatedPotential refuses its parameters"):
        made(**wrong).in_engine_units()


BAD = {
    "nearest": ({"name": "NFWPotentail"}, "has no potential 'NFWPotentail'. Did you mean 'NFWPotential'?"),
    "short": ({"name": "Hernquist", "m": 1}, "Did you mean 'HernquistPotential'?"),
    "no name": ({}, "potential.name: missing"),
    "parameter": (HALO | {"rs": 1}, "potential.rs: the potential 'gala' has no field 'rs'. Did you mean 'r_s'?"),
    "missing": ({"name": "NFWPotential", "m": 1e11}, "potential.r_s: missing (gala's r_s (length))"),
    "unit": (HALO | {"r_s": "8 km/s"}, "potential.r_s: expected a quantity in kpc"),
    "negative": (HALO | {"m": -1}, "potential.m: found -1"),
    "frame": (HALO | {"origin": [1, 2, 3]}, "potential.origin: the potential 'gala' has no field 'origin'"),
    "rotated": (HALO | {"R": 1}, "potential.R: the potential 'gala' has no field 'R'"),
    "table": ({"name": "CylSplinePotential"}, "takes 'grid_R', a length array, which this section cannot hold"),
    "changing": ({"name": "TimeInterpolatedPotential"}, "potential: potential_cls: missing; the name of the potential"),
    "what": (GROWING | {"potential_cls": "NFWPotentail"}, "potential_cls: gala 1"),
    "twice": (GROWING | {"potential_cls": "TimeInterpolatedPotential"}, "expected a potential with parameters of its"),
    "too late": (GROWING | {"time_knots": [-1.9, -1, -0.5, 0]}, "known from -1.9 to 0 Gyr; expected all times from -2"),
    "backwards": (GROWING | {"time_knots": [-3, -4, -1, 0]}, "time_knots: found [-3.0, -4.0, -1.0, 0.0], expected two"),
    "rows": (GROWING | {"m": [1e11, 1e11]}, "m: found 2 numbers, expected one for each of 4 times"),
    "steps": (GROWING | {"step": "1 Myr"}, "found more than 500 times to expand it at: raise step"),
    "mass": (GROWING | {"m": [1e11, 1e11, -1, 1e11]}, "potential.m: entry [2] is -1 Msun, expected positive"),
    "version": ({"name": "MilkyWayPotential", "version": "v9"}, "v9"),
}


@pytest.mark.parametrize(("section", "told"), BAD.values(), ids=BAD)
def test_bad_input_is_told(section, told):
    with pytest.raises(sk.SpecError) as caught:
        loaded(**{"kind": "gala"} | section)
    assert told in str(caught.value)


CLOUD = {"ra": 81.28, "dec": -69.78, "distance": 49.6, "pm_ra_cosdec": 1.858, "pm_dec": 0.385, "v_los": 262.2}


def test_bodies_and_progenitors_of_gala_are_our_own():
    """Their masses, which gala does not tell, are read off the force; orbits and streams through expansions."""
    result = []
    for kind, lmc, satellite in (
        (
            "gala",
            {"name": "HernquistPotential", "m": 1.4e11, "c": 16},
            {"name": "PlummerPotential", "m": 4e8, "b": 0.85},
        ),
        (None, {"kind": "hernquist", "mass": 1.4e11, "a": 16}, {"kind": "plummer", "mass": 4e8, "radius": 0.85}),
    ):
        document = copy.deepcopy(RUN) | {"potential": {"kind": "nfw", "mass": 5.4e11, "rs": 15.6}}
        document["body"] = {"lmc": {"kind": kind} | lmc | CLOUD}
        place = {name: RUN["progenitor"][name] for name in ("x", "y", "z", "vx", "vy", "vz")}
        document["progenitor"] = {"kind": kind} | satellite | place | {"lookback": 1.0}
        document["stripping"]["particles"] = 100
        model = sk.Model(sk.load(document, components=[Gala]))
        inputs = model.spec.bind()
        assert inputs.mass == pytest.approx(4e8, rel=1e-7)
        assert inputs.bodies["lmc"].mass == pytest.approx(1.4e11, rel=1e-7)
        assert inputs.bodies["lmc"].extent == 16.0
        result.append(model.stream())
    theirs, outcome = result
    assert np.abs(theirs.orbit.q - outcome.orbit.q).max() < 0.01
    assert theirs.orbit.r_tidal == pytest.approx(outcome.orbit.r_tidal, rel=1e-3)
    assert np.median(np.abs(theirs.q - outcome.q).max(axis=0)) < 0.05


def test_a_halo_without_end_is_no_body():
    document = copy.deepcopy(RUN) | {"body": {"lmc": {**HALO, **CLOUD}}}
    with pytest.raises(sk.SpecError, match=r"body\.lmc\.kind: .*'gala' has no field 'mass' in Msun, and its force"):
        sk.load(document, components=[Gala])


def test_a_command_ends_with_status_2(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plugin.py").write_text("from streamkit_gala import streamkit_components\n")
    (tmp_path / "run.toml").write_text('plugins = ["plugin.py"]\n' + loaded(**RUN["potential"]).toml())
    done = CliRunner().invoke(main, ["check", "run.toml", "--set", "potential.name=NFWPotentail"])
    assert done.exit_code == 2
    assert "Did you mean 'NFWPotential'?" in done.stderr
    assert "Traceback" not in done.stderr


def test_without_gala(monkeypatch):
    """A missing gala is told when a section names a potential; everything else works."""
    classes.cache_clear()
    monkeypatch.setitem(sys.modules, "gala", None)
    monkeypatch.setitem(sys.modules, "gala.potential", None)
    with pytest.raises(sk.SpecError, match=r"gala cannot be imported.*pip install 'gala>=1.11'"):
        loaded(**HALO)
    monkeypatch.undo()
    classes.cache_clear()
    assert "NFWPotential" in classes()


def test_every_potential_of_gala_is_offered_or_refused():
    offered, refused = [], []
    for name in classes():
        try:
            parameters = parameters_of(name, {"lmax": 2})
        except ValueError as found:
            refused.append((name, "which this section cannot hold" in str(found)))
            continue
        given = {"lmax": 2} if name == "MultipolePotential" else {}
        needed = [p for p in parameters if p.default is None and not p.dimensions]
        values = {p.name: 1.5 + 0.5 * i for i, p in enumerate(needed)}
        values |= {p.name: np.ones((2, 2, 2)) for p in parameters if p.dimensions}
        potential = made(name, **given | values)
        assert np.isfinite(acceleration(potential)).all(), name
        offered.append(name)
    assert {"MN3ExponentialDiskPotential", "SCFPotential", "MultipolePotential", "BovyMWPotential2014"} <= set(offered)
    assert len(offered) > 20
    assert {("EXPPotential", True), ("SphericalSplinePotential", True)} <= set(refused)
    assert {name for name, result in refused if not result} == {"TimeInterpolatedPotential"}  # without a potential


@pytest.mark.slow
def test_a_stream_beside_the_cloud_is_galas(monkeypatch):
    """gala's TimeInterpolatedPotential carries Milky Way and cloud; test particles from our release states."""
    folder = ROOT / "tests" / "benchmarks"
    monkeypatch.syspath_prepend(folder)  # the program imports the one beside it
    result = importlib.util.spec_from_file_location("moving_hosts", folder / "moving_hosts.py")
    program = importlib.util.module_from_spec(result)
    result.loader.exec_module(program)
    assert program.differences(8).max() < 1e-6
