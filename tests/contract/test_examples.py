"""The files of examples/: every run file is valid and makes a stream, every script runs."""

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import call
from documents import ROOT, reduced
from scipy.integrate import dblquad, quad
from snapshots import nbody_stream

import streamkit as sk
from streamkit.builtin.observables.apocentres.observable import Apocentres
from streamkit.fit.show.recovery import true_host
from streamkit.model import Host, progenitor_track
from streamkit.nbody import as_stream, read_snapshot
from streamkit.study.preflight.orbit import summarise_orbit

EXAMPLES = ROOT / "examples"
MOCKS = EXAMPLES / "mocks"
RUN_FILES = sorted(EXAMPLES.glob("*/*.toml"))
TRUTHS = sorted(EXAMPLES.glob("*/truth_*.toml"))
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
DEFAULT_RULE = Apocentres.model_fields["recent_debris"].default


def one_of(paths: list[Path]) -> list[Any]:
    """Return the run files as cases, of which only that of GD-1 is not slow."""
    return [pytest.param(p, id=p.stem, marks=() if p.stem == "gd1" else pytest.mark.slow) for p in paths]


def has_data(path: Path) -> bool:
    """Return whether a run file has something to fit: some examples make streams only."""
    sections = re.findall(r"^\[(.*?)\]", path.read_text(encoding="utf-8"), re.MULTILINE)
    return any(re.match(r"(observable|data|stream\..*\.observable)", section) for section in sections)


def test_the_examples_are_found() -> None:
    assert {path.stem for path in RUN_FILES} >= {"sagittarius", "sagittarius_modern", "mock_tf"}
    assert SCRIPTS


@pytest.mark.parametrize("path", one_of(RUN_FILES))
def test_a_run_file_passes_the_check_and_makes_a_stream(path: Path) -> None:
    places = [s.path for s in sk.load(path).sections.all if s.path.endswith("stripping")]
    few = [word for place in places for word in ("--set", f"{place}.particles=200")]
    result = call("check", path, *few, "--draws", "0")
    assert result.exit_code == 0, result.output
    spec = sk.load(path).with_values({f"{place}.particles": 200 for place in places})
    for stream in sk.Model(spec).streams().values():
        assert len(stream) == 200
        assert np.isfinite(stream.q).all()
        assert np.isfinite(stream.winding).all()
        assert 0 <= stream.bound.sum() < 200


@pytest.mark.parametrize("path", one_of([p for p in RUN_FILES if p not in TRUTHS and has_data(p)]))
def test_a_run_file_can_be_fitted_where_the_documents_say(path: Path) -> None:
    spec = reduced(path, sk.load(path), particles=2000)
    theta = spec.centre()
    lnp, *_ = sk.Posterior(spec)(theta)
    assert np.isfinite(lnp)


@pytest.mark.parametrize("name", ["sagittarius", "sagittarius_modern"])
def test_the_sagittarius_examples_hold_the_data_and_priors_of_the_paper(name: str) -> None:
    spec = sk.load(EXAMPLES / "sagittarius" / f"{name}.toml")
    assert len(spec.names) == 11
    observable = spec.bind().observable
    assert observable is not None
    values, errors = observable.data()
    assert values.tolist() == [47.8, 102.5, 93.2]
    assert errors.tolist() == [0.5, 2.5, 3.5]


def rule(spec: sk.Spec) -> str:
    return str(spec.document.get("observable", {}).get("recent_debris"))


@pytest.mark.slow
def test_an_example_uses_the_default_rule_for_recent_debris() -> None:
    """And has a stream that the rule measures, at the prior's centre as at the true values."""
    using = {path.stem: spec for path in RUN_FILES if rule(spec := sk.load(path)) == DEFAULT_RULE}
    assert using
    spec = using["mock_tf_turning"]
    truth = {"potential.v0": 210, "potential.rs": 12, "potential.alpha": 0.45, "progenitor.mass": 6.4e8}
    for values in ({}, truth | {"progenitor.radius": 0.85, "stripping.sigma": 10}):
        _, prediction = sk.Model(spec).observe(spec.with_values(values).bind())
        assert not prediction.why_not
    assert prediction.mean[:2] == pytest.approx(spec.bind().observable.data()[0][:2], abs=1.0)


def test_the_mock_of_the_default_rule_is_the_first_one_measured_by_that_rule() -> None:
    turning, first = (sk.load(MOCKS / f"{name}.toml") for name in ("mock_tf_turning", "mock_tf"))
    assert {k: v for k, v in turning.document.items() if k != "observable"} == {
        k: v for k, v in first.document.items() if k != "observable"
    }
    (ours, error), (_, paper_error) = turning.bind().observable.data(), first.bind().observable.data()
    assert error == pytest.approx(paper_error)
    assert ours == pytest.approx(Apocentres(recent_debris=DEFAULT_RULE).predict(nbody_stream("B")).mean, abs=0.06)


def test_the_extract_is_written_as_a_snapshot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = tmp_path / "table.npz"
    monkeypatch.setattr(sys, "argv", ["snapshot.py", str(ROOT / "tests/data/nbody_B.npz"), "-o", str(table)])
    runpy.run_path(str(EXAMPLES / "ablation" / "snapshot.py"), run_name="__main__")
    result = as_stream(read_snapshot(table), sk.load(MOCKS / "mock_tf.toml").bind())
    wanted = nbody_stream("B")
    assert np.array_equal(result.q, wanted.q)
    assert result.t_strip == pytest.approx(wanted.t_strip, abs=1e-6)
    assert np.array_equal(result.winding, wanted.winding)


def hernquist(r: float, z: float, mass: float, a: float) -> float:
    return mass / (r + a) ** 2


def miyamoto_nagai(r: float, z: float, mass: float, a: float, b: float) -> float:
    """G M (R^2 + z^2 (a + s) / s) / (R^2 + (a + s)^2)^(3/2) / r inwards, s^2 = z^2 + b^2."""
    s = np.hypot(z, b)
    return mass * (r**2 - z**2 + z**2 * (a + s) / s) / (r**2 - z**2 + (a + s) ** 2) ** 1.5 / r


def inside(r: float, inward: Callable[[float, float], float]) -> float:
    """M = r^2 <-a_r> / G by Gauss's law, of a force that depends on r and z."""
    return r**2 * quad(lambda mu: inward(r, mu * r), 0, 1, limit=200)[0]


def nfw(r: float, m200: float, c: float) -> float:
    """M200 m(r / rs) / m(c), with 200 times the critical density for H0 = 70 km/s/Mpc inside r200."""
    r200 = (m200 / (800 / 3 * np.pi * 3 * 0.07**2 / (8 * np.pi * sk.G))) ** (1 / 3)
    m, c_m = (np.log1p(x) - x / (1 + x) for x in (r * c / r200, c))
    return m200 * m / c_m


def law_majewski(r: float) -> float:
    """The halo v^2 ln(C1 x^2 + C2 y^2 + C3 x y + (z / qz)^2 + rh^2): -a_r = 2 v^2 (f / r) / (f + rh^2)."""
    angle = np.radians(97)
    c, s, q = np.cos(angle), np.sin(angle), 1.38
    c1, c2, c3 = c**2 / q**2 + s**2, c**2 + s**2 / q**2, 2 * s * c * (1 / q**2 - 1)

    def pull(phi: float, mu: float) -> float:
        x, y = np.sqrt(1 - mu**2) * np.array([np.cos(phi), np.sin(phi)])
        f = r**2 * (c1 * x**2 + c2 * y**2 + c3 * x * y + (mu / 1.36) ** 2)
        return 2 * 121.858**2 * f / r / (f + 12.0**2)

    return r**2 / sk.G * dblquad(pull, 0, 1, 0, 2 * np.pi)[0] / (2 * np.pi)


@pytest.mark.parametrize("name", ["tf", "bulge_disc_halo", "lm10"])
def test_a_mock_states_the_masses_of_its_truth(name: str) -> None:
    """Textbook forces over a sphere beside the file's comment and the potentials of the truth."""
    halves = {
        "tf": lambda r: r * 210.0**2 * 12.0**0.45 / (12.0**2 + r**2) ** 0.225 / sk.G,
        "bulge_disc_halo": lambda r: inside(
            r, lambda r, z: hernquist(r, z, 3e10, 0.5) + miyamoto_nagai(r, z, 3.3e10, 4, 0.4)
        ) + nfw(r, 1.2e12, 16),
        "lm10": lambda r: inside(
            r, lambda r, z: hernquist(r, z, 3.4e10, 0.7) + miyamoto_nagai(r, z, 1e11, 6.5, 0.26)
        ) + law_majewski(r),
    }  # fmt: skip
    r = np.array([50.0, 100.0, 200.0])
    mass = np.array([halves[name](x) for x in r])
    mock = MOCKS / f"mock_{name}.toml"
    assert f"({', '.join(f'{m:.2f}' for m in mass / 1e11)})e11" in mock.read_text()
    host = true_host(MOCKS / f"truth_{name}.toml", sk.load(mock))
    assert host.mass_inside(r) == pytest.approx(mass, rel=1e-4)


@pytest.mark.parametrize("name", ["bulge_disc_halo", "lm10"])
def test_a_mock_is_the_satellite_of_its_truth_and_measured_as_the_paper_did(name: str) -> None:
    """The live core is 12 and 14 degrees ahead of the point mass; the data are ours, near the paper's own."""
    mock, truth = (sk.load(MOCKS / f"{kind}_{name}.toml") for kind in ("mock", "truth"))
    core, point = mock.bind(), truth.bind()
    cosine = core.q @ point.q / np.sqrt((core.q @ core.q) * (point.q @ point.q))
    assert 5 < np.degrees(np.arccos(cosine)) < 20
    assert core.lookback == point.lookback
    assert len(mock.names) == 6
    (ours, error), (paper, paper_error) = core.observable.data(), point.observable.data()
    assert error == pytest.approx(paper_error)
    assert (np.abs(ours - paper) < (1.2, 2.0, 5.0)).all()


@pytest.mark.parametrize(("name", "since"), [("tf", 0.03), ("bulge_disc_halo", 0.02)])
def test_the_orbits_of_the_first_two_mocks_are_those_they_state(name: str, since: float) -> None:
    """17 to 75 kpc, polar, begun at apocentre, so many Gyr after the third pericentre."""
    inputs = sk.load(MOCKS / f"truth_{name}.toml").bind()
    track = progenitor_track(Host(inputs.potentials), inputs)
    assert track.at(track.pericentres()).r == pytest.approx([17, 17, 17], abs=0.02)
    assert track.r[0] == pytest.approx(75, abs=0.02)
    assert abs(track.v[:, 0] @ track.q[:, 0]) / track.r[0] < 4  # km/s: at rest in radius
    assert -track.pericentres()[-1] == pytest.approx(since * sk.GYR, abs=0.004)
    assert np.abs(track.q[1]).max() < 1e-6


def test_the_third_mock_is_on_the_orbit_it_states() -> None:
    inputs = sk.load(MOCKS / "truth_lm10.toml").bind()
    path = summarise_orbit(inputs)
    assert inputs.lookback / path.period == pytest.approx(3.5, abs=0.1)
    assert path.apocentres == pytest.approx(59, abs=1.5)
    assert ((path.pericentres > 12) & (path.pericentres < 28)).all()


@pytest.mark.rendered("picture")
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_runs(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(path), "1000", str(tmp_path / "picture.png")])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_one_stream_is_the_case_of_figure_5(tmp_path: Path) -> None:
    """An orbit between 18 and 70 kpc, from an apocentre; under 60 lines."""
    text = (EXAMPLES / "one_stream.py").read_text()
    assert len(text.splitlines()) < 60
    namespace: dict[str, object] = {}
    argv = sys.argv
    sys.argv = ["one_stream.py", "300", str(tmp_path / "picture.png")]
    try:
        exec(compile(text, "one_stream.py", "exec"), namespace)
    finally:
        sys.argv = argv
    stream = namespace["stream"]
    assert isinstance(stream, sk.Stream)
    orbit = stream.orbit
    peri = orbit.at(orbit.pericentres()).r
    assert orbit.r[0] == pytest.approx(70.0, abs=1e-3)
    assert len(peri) == 4
    assert peri == pytest.approx(18.0, abs=0.1)
