"""The files of examples/: every run file is valid and makes a stream, every script runs."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import call
from documents import reduced

import streamkit as sk

EXAMPLES = Path(__file__).parent.parent / "examples"
RUN_FILES = sorted(EXAMPLES.glob("*.toml"))
SCRIPTS = sorted(EXAMPLES.glob("*.py"))


def test_the_examples_are_found() -> None:
    assert {path.stem for path in RUN_FILES} >= {"sagittarius", "sagittarius_modern", "mock_tf"}
    assert SCRIPTS


@pytest.mark.parametrize("path", RUN_FILES, ids=lambda path: path.stem)
def test_a_run_file_passes_the_check_and_makes_a_stream(path: Path) -> None:
    result = call("check", path, "--set", "stripping.particles=200", "--draws", "0")
    assert result.exit_code == 0, result.output
    spec = sk.load(path).with_values({"stripping.particles": 200})
    stream = sk.Model(spec).stream()
    assert len(stream) == 200
    assert np.isfinite(stream.q).all()
    assert np.isfinite(stream.winding).all()
    assert 0 < stream.bound.sum() < 200


@pytest.mark.parametrize("path", RUN_FILES, ids=lambda path: path.stem)
def test_a_run_file_can_be_fitted_where_the_documents_say(path: Path) -> None:
    spec = reduced(path, particles=2000)
    theta = spec.centre()
    lnp, *_ = sk.Posterior(spec)(theta)
    assert np.isfinite(lnp)


@pytest.mark.parametrize("name", ["sagittarius", "sagittarius_modern"])
def test_the_sagittarius_examples_hold_the_data_and_priors_of_the_paper(name: str) -> None:
    spec = sk.load(EXAMPLES / f"{name}.toml")
    assert len(spec.names) == 11
    observable = spec.bind().observable
    assert observable is not None
    values, errors = observable.data()
    assert values.tolist() == [47.8, 102.5, 93.2]
    assert errors.tolist() == [0.5, 2.5, 3.5]


def test_the_mock_has_the_masses_it_states() -> None:
    """tf(210, 12, 0.45): M = r v_c^2 / G, with v_c of G14's eq. 2."""
    r = np.array([50.0, 100.0, 200.0])
    v2 = 210.0**2 * 12.0**0.45 / (12.0**2 + r**2) ** 0.225
    assert (r * v2 / sk.G / 1e11).round(2).tolist() == [2.66, 3.94, 5.78]
    assert "(2.66, 3.94, 5.78)e11" in (EXAMPLES / "mock_tf.toml").read_text()


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_runs(path: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", path, "1000", tmp_path / "picture.png"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout
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
