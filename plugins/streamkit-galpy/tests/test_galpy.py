"""galpy's potentials in streamkit: against closed forms, units whatever ro and vo, and a sentence for bad input."""

import copy
import pickle
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from galpy.potential import SpiralArmsPotential, evaluateRforces
from scipy.interpolate import CubicSpline
from streamkit_galpy import Galpy
from streamkit_galpy.catalogue import classes, models, signature_of, units_of
from streamkit_galpy.component import TO_ENGINE
from streamkit_galpy.evaluate import Evaluator

import streamkit as sk
from streamkit.cli.main import main
from streamkit.engine import build_field
from streamkit.testing import check

Q = np.random.default_rng(1).normal(size=(3, 100)) * np.geomspace(0.3, 80, 100)  # kpc
HALO = {"kind": "galpy", "name": "NFWPotential", "amp": "5e11 Msun", "a": "15.6 kpc"}
RUN = {
    "seed": 7,
    "potential": {"kind": "galpy", "name": "MWPotential2014"},
    "progenitor": {
        "kind": "plummer", "mass": {"log_uniform": [1e8, "1e9 Msun"]}, "radius": 0.85,
        "x": 19.0, "y": 0.0, "z": -5.7, "vx": 176.0, "vy": 0.0, "vz": 202.0, "lookback": 2.0,
    },
    "stripping": {"kind": "mlcs", "particles": 300, "sigma": 10.0},
}  # fmt: skip


def made(name, **fields):
    section = {"name": name, "expansion": "none", **fields}
    return Galpy.for_section(section)(**section)


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
    return sk.load(document, components=[Galpy])


MN = ("miyamoto_nagai", {"mass": 6.8e10, "a": 3, "b": 0.28})
SAME = [
    (("NFWPotential", {"amp": 5e11, "a": 16}), ("nfw", {"mass": 5e11, "rs": 16})),
    (("MiyamotoNagaiPotential", {"amp": "6.8e10 Msun", "a": "3 kpc", "b": "280 pc"}), MN),
    (("HernquistPotential", {"amp": "1e10 Msun", "a": 1}), ("hernquist", {"mass": 5e9, "a": 1})),  # twice
    (("PlummerPotential", {"amp": 5e9, "b": 2, "ro": 7, "vo": 250}), ("plummer", {"mass": 5e9, "radius": 2})),
    (("KeplerPotential", {"amp": 5e9}), ("kepler", {"mass": 5e9})),
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
    potential = made("LogarithmicHaloPotential", amp="48400 km2/s2", core="12 kpc", q=0.8, b=0.9)
    k = -48400.0 / (12.0**2 + Q[0] ** 2 + (Q[1] / 0.9) ** 2 + (Q[2] / 0.8) ** 2)
    assert error(acceleration(potential), k * Q / np.array([[1], [0.81], [0.64]])).max() < 1e-10


def test_mwpotential2014_is_the_paper():
    """Bovy 2014, table 1: the parts share v_c = 220 km/s at 8 kpc as 0.05, 0.60 and 0.35 of the force."""
    result = acceleration(made("MWPotential2014"), q=np.array([[8.0], [0.0], [0.0]]))
    assert result[0] == pytest.approx(-(220.0**2) / 8.0, rel=1e-9)
    scaled = acceleration(made("MWPotential2014", ro="8.2 kpc", vo="235 km/s"), q=np.array([[8.2], [0.0], [0.0]]))
    assert scaled[0] == pytest.approx(-(235.0**2) / 8.2, rel=1e-9)
    disc = made("MiyamotoNagaiPotential", a="3 kpc", b="0.28 kpc", normalize=0.6)
    halo = made("NFWPotential", a="16 kpc", normalize=0.35)
    bulge = made("PowerSphericalPotentialwCutoff", alpha=1.8, rc="1.9 kpc", normalize=0.05)
    assert error(acceleration(disc, halo, bulge), acceleration(made("MWPotential2014"))).max() < 1e-10


UNITS = {"kpc": 3.0, "Msun": 5e10, "km2/s2": 2e4, "Msun/kpc3": 1e7, "Msun/kpc2": 1e8, "deg": 20.0}


def physical(name):
    """Values for all parameters of a class that have units, and for no two of them the same."""
    units = units_of(name)
    optional = {"rmax", "vmax", "mass", "rs", "rm2", "tgrid", "Af", "rolr"}
    values = {key: UNITS.get(unit, 10.0) * 1.1**i for i, (key, unit) in enumerate(units.items()) if key not in optional}
    return values | ({"rb": 3.5, "omegab": 40.0} if name == "DehnenBarPotential" else {})


SLOW = {"KingPotential", "DoubleExponentialDiskPotential", "RazorThinExponentialDiskPotential"}
LEFT_OUT = SLOW | {"TruncatedTwoPowerSphericalPotential"}  # which needs what its heirs give it
PLAIN = {
    name
    for name in classes()
    if "amp" in units_of(name) and name not in LEFT_OUT and not {"pot", "orbit", "s", "RZPot"} & set(signature_of(name))
}


@pytest.mark.parametrize("name", sorted(PLAIN))
def test_units_mean_the_same_whatever_ro_and_vo_are(name):
    """What was read from galpy's source about units is right, for every class of this galpy."""
    one, other = (made(name, **physical(name), ro=ro, vo=vo) for ro, vo in ((8.0, 220.0), (5.0, 300.0)))
    q = Q[:, 75:78]
    assert error(acceleration(one, q=q), acceleration(other, q=q)).max() < 1e-6


def test_most_classes_are_covered():
    assert len(PLAIN) > 25
    assert set(TO_ENGINE) == {"deg", "Gyr"}


def test_what_turns_is_asked_at_its_time():
    """A spiral: galpy's own force at the angle and time in its natural units."""
    fields = {
        "amp": "1e7 Msun/kpc3",
        "N": 2,
        "alpha": "12 deg",
        "omega": "25 km/(s kpc)",
        "Rs": "3 kpc",
        "H": "0.3 kpc",
    }
    potential = made("SpiralArmsPotential", **fields, r_ref="8 kpc")
    (model,) = potential.in_engine_units()
    assert not model.static
    assert isinstance(model.source, SpiralArmsPotential)
    t = np.array([0.0, -0.5, -0.5, -1.3])
    q = np.array([[5.0, -3.0, 8.0, 1.0], [0.0, 4.0, 1.0, 6.0], [0.1, -0.2, 0.3, 0.5]])
    result = model.acceleration(*q, t)
    radius, phi = np.hypot(q[0], q[1]), np.arctan2(q[1], q[0])
    for i in range(4):
        scale = 220.0**2 / 8.0
        outward = (result[0][i] * q[0, i] + result[1][i] * q[1, i]) / radius[i]
        wanted = evaluateRforces(
            model.source, radius[i] / 8, q[2, i] / 8, phi=phi[i], t=t[i] * 220 / 8, use_physical=False
        )
        assert outward == pytest.approx(scale * wanted, rel=1e-9)


def test_a_potential_that_takes_no_arrays_is_asked_point_by_point():
    numbers = Evaluator(made("NFWPotential", amp=5e11, a=16).in_engine_units()[0].source, 8.0, 220.0, arrays=False)
    assert np.allclose(numbers.acceleration(*Q, 0.0), acceleration(ours("nfw", mass=5e11, rs=16)), rtol=1e-9)
    assert made("NFWPotential", amp=5e11, a=16).in_engine_units()[0].arrays


@pytest.mark.parametrize(
    "section", [Galpy.example, {k: v for k, v in HALO.items() if k != "kind"}], ids=["model", "nfw"]
)
def test_conforms(section):
    cls = Galpy if section is Galpy.example else Galpy.for_section(section)
    cls.example = section
    check(cls, slow=section is Galpy.example)  # its bulge takes incomplete gamma functions, one position at a time


def test_a_stream_in_mwpotential2014_is_that_of_the_compiled_preset():
    theirs, ours = (sk.Model(loaded(**host)).stream() for host in (RUN["potential"], {"preset": "bovy2014"}))
    apart = np.sqrt(((theirs.q - ours.q) ** 2).sum(axis=0))
    assert np.median(apart) < 0.05


def test_priors_units_and_digest():
    spec = loaded(**HALO | {"amp": {"log_uniform": ["2e11 Msun", "1e12 Msun"]}, "vo": {"normal": [230, 5]}})
    assert spec.names[:2] == ("potential.amp", "potential.vo")
    assert (spec.document["potential"]["name"], spec.document["potential"]["ro"]) == ("NFWPotential", "8.0 kpc")
    again = pickle.loads(pickle.dumps(spec))
    assert (again, again.digest()) == (spec, spec.digest())
    assert loaded(**HALO).digest() != loaded(**HALO | {"ro": 8.1}).digest()


# Growth from -6 to -1 Gyr (Dehnen 2000, AJ 119, 800, eq. 4), and an expansion whose coefficients grow.
SMOOTH = {
    "name": "DehnenSmoothWrapperPotential", "tform": "-6 Gyr", "tsteady": "5 Gyr", "since": "-2 Gyr",
    "pot_name": "NFWPotential", "pot_amp": "5e11 Msun", "pot_a": 15.6,
}  # fmt: skip
SIZES = [0.4, 0.6, 0.9, 1.0]
GROWING = {
    "name": "SCFPotential", "amp": "1e11 Msun", "a": "10 kpc", "tgrid": ["-3 Gyr", -2, -1, 0], "step": "1 Gyr",
    "Acos": [[[[size]], [[0.1 * size]]] for size in SIZES],
}  # fmt: skip


def grown(t):
    """The factor on the force at times in Gyr."""
    xi = np.clip(2 * (t + 6) / 5 - 1, -1, 1)
    return 3 / 16 * xi**5 - 5 / 8 * xi**3 + 15 / 16 * xi + 0.5


@pytest.mark.parametrize(
    ("changing", "static", "factor"),
    [
        (SMOOTH, {"name": "NFWPotential", "amp": 5e11, "a": 15.6}, grown),
        (GROWING, {k: v for k, v in GROWING.items() if k not in ("tgrid", "step")} | {"Acos": [[[1.0]], [[0.1]]]},
         CubicSpline([-3, -2, -1, 0], SIZES)),
    ],
    ids=["wrapper", "table"],
)  # fmt: skip
def test_what_changes_is_expanded_at_times(changing, static, factor):
    """galpy's amplitudes in time are cubic splines of those of its table (its SCFPotential)."""
    potential = loaded(kind="galpy", **changing).bind().potentials["potential"]
    assert potential.known_times()[[0, -1]] == pytest.approx([-3 if changing is GROWING else -2, 0])
    q = Q[:, ::4].copy()
    t = np.random.default_rng(2).uniform(-2, 0, q.shape[1])
    exact = factor(t) * acceleration(made(**static), q=q)
    found = build_field([made(**changing)]).acceleration(t * sk.GYR, q)
    assert error(found, exact).max() < 1e-9
    expanded = build_field([potential]).acceleration(t * sk.GYR, q)
    assert error(expanded, exact).max() < 3e-4
    assert pickle.loads(pickle.dumps(potential)) == potential


def test_a_bar_that_turns_by_its_orientation_is_galpy_s_bar_that_turns():
    bar = {"amp": 1e10, "a": "3.5 kpc", "c": "0.6 kpc", "pa": 0}
    own = made("SoftenedNeedleBarPotential", **bar, omegab="-39 km/(s kpc)")
    turn = {"times": [-4, 0], "values": [float(np.degrees(-4 * sk.GYR * -39)), 0]}
    still = {"name": "SoftenedNeedleBarPotential", **bar, "omegab": 0, "expansion": "none"}
    turned = loaded(kind="galpy", **still, orientation=[0, 0, turn]).bind().potentials["potential"]
    turned = pickle.loads(pickle.dumps(turned))
    t = np.random.default_rng(2).uniform(-2, 0, Q.shape[1]) * sk.GYR
    assert error(build_field([turned]).acceleration(t, Q), build_field([own]).acceleration(t, Q)).max() < 1e-9


@pytest.mark.slow
def test_a_stream_in_a_halo_that_grows_is_that_of_growth():
    times = np.linspace(-3, 0, 200)
    growth = {"t": times.tolist(), "factor": (grown(times) / grown(0.0)).tolist()}
    hosts = {"kind": "galpy", **SMOOTH}, {"kind": "nfw", "mass": 5e11, "rs": 15.6, "growth": growth}
    theirs, ours = (sk.Model(loaded(**host)).stream() for host in hosts)
    assert np.median(np.sqrt(((theirs.q - ours.q) ** 2).sum(axis=0))) < 0.05


BAD = {
    "nearest": ({"name": "NFWPotentail"}, "has no potential 'NFWPotentail'. Did you mean 'NFWPotential'?"),
    "model": ({"name": "MWPotental2014"}, "Did you mean 'MWPotential2014'?"),
    "no name": ({}, "potential.name: missing"),
    "parameter": (HALO | {"am": 1}, "galpy's NFWPotential has no parameter 'am'. Did you mean 'amp'?"),
    "model's": ({"name": "MWPotential2014", "amp": 1}, "galpy's MWPotential2014 has no parameter 'amp'"),
    "unit": (HALO | {"a": "8 km/s"}, "potential.a: expected a quantity in kpc"),
    "number": ({"name": "LogarithmicHaloPotential", "q": "1 kpc"}, "potential.q: expected a number without a unit"),
    "object": ({"name": "AnySphericalPotential", "dens": 1}, "takes a Python object for 'dens'"),
    "wrapper": ({"name": "DehnenSmoothWrapperPotential"}, "potential: pot_name: missing; galpy's DehnenSmoothWrapper"),
    "wrapped": ({"name": "DehnenSmoothWrapperPotential", "pot_name": "NFWPotentail"}, "Did you mean 'NFWPotential'?"),
    "in it": (SMOOTH | {"pot_am": 1}, "pot_am: galpy's NFWPotential has no parameter 'am'. Did you mean 'amp'?"),
    "twice": (SMOOTH | {"pot_name": "GaussianAmplitudeWrapperPotential"}, "found a wrapper in a wrapper"),
    "function": ({"name": "TimeDependentAmplitudeWrapperPotential"}, "for 'A', which a run file cannot hold"),
    "moving": ({"name": "MovingObjectPotential"}, "'orbit', which a run file cannot hold: streamkit has centre"),
    "too late": (SMOOTH | {"since": -1}, "the galpy is known from -1 to 0 Gyr; expected all times from -2"),
    "table": (GROWING | {"tgrid": [-1, 0]}, "the galpy is known from -1 to 0 Gyr; expected all times from -2"),
    "steps": (SMOOTH | {"step": "1 Myr"}, "found 502 times to expand it at, expected at most 500: raise step"),
    "future": (SMOOTH | {"since": 1}, "potential.since: found 1"),
}


@pytest.mark.parametrize(("section", "told"), BAD.values(), ids=BAD)
def test_bad_input_is_told(section, told):
    with pytest.raises(sk.SpecError) as caught:
        loaded(**{"kind": "galpy"} | section)
    assert told in str(caught.value)


def test_parameters_that_galpy_refuses_are_no_stream():
    with pytest.raises(sk.OutOfDomain, match="galpy's TruncatedTwoPowerSphericalPotential refuses its parameters"):
        made("TruncatedTwoPowerSphericalPotential", amp=1e11, a=2.0).in_engine_units()


def test_a_command_ends_with_status_2(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plugin.py").write_text("from streamkit_galpy import streamkit_components\n")
    (tmp_path / "run.toml").write_text('plugins = ["plugin.py"]\n' + loaded(**RUN["potential"]).toml())
    done = CliRunner().invoke(main, ["check", "run.toml", "--set", "potential.name=NFWPotentail"])
    assert done.exit_code == 2
    assert "Did you mean 'NFWPotential'?" in done.stderr
    assert "Traceback" not in done.stderr


def test_without_galpy(monkeypatch):
    monkeypatch.setitem(sys.modules, "galpy", None)
    with pytest.raises(sk.SpecError, match=r"galpy cannot be imported.*pip install 'galpy>=1.10'"):
        loaded(**HALO)


def test_the_models_are_known_without_being_built():
    assert {"MWPotential2014", "McMillan17", "Cautun20", "Irrgang13I"} <= set(models())
