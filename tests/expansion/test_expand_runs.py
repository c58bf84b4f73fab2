"""Runs whose host is expanded: what commands say, what a fit rejects, streams beside the compiled ones."""

import numpy as np
import pytest

import streamkit as sk
from streamkit.model import Model

PLUGIN = '''
import numpy as np
import streamkit as sk
from pydantic import Field


class Disc(sk.Potential):
    """A halo and a disc, of which numba knows nothing."""

    kind = "halo_disc"
    compiled = False
    evaluation = "expansion"
    mass: sk.Mass = Field(default=6.8e10, description="Mass of the disc.")
    height: sk.Length = Field(default=0.5, description="Scale height.")
    rate: sk.Number = Field(default=0.0, description="Growth per kpc/(km/s).")

    @staticmethod
    def acceleration(x, y, z, t, mass, height, rate):
        r = np.sqrt(x * x + y * y + z * z)
        k = sk.G * 3.6e11 * (r / (r + 16.0) - np.log1p(r / 16.0)) / r**3
        s = np.sqrt(z * z + height * height)
        d = -sk.G * mass * (1 + rate * t) / (x * x + y * y + (3.0 + s) ** 2) ** 1.5
        return (k + d) * x, (k + d) * y, (k + d * (3.0 + s) / s) * z


@sk.hookimpl
def streamkit_components():
    return [Disc]
'''


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The run file of the commands' tests with a host that is not compiled."""
    from runfiles import RUN

    folder = tmp_path_factory.mktemp("expanded")
    (folder / "disc.py").write_text(PLUGIN)
    head, tail = RUN.split("[potential]")[0], RUN[RUN.index("[progenitor]") :]

    def write(fields="", name="run.toml", tail=tail):
        path = folder / name
        path.write_text(f'plugins = ["disc.py"]\n{head}[potential]\nkind = "halo_disc"\n{fields}\n{tail}')
        return path

    return write


def test_check_and_stream_tell_the_expansion(run):
    from commands import call

    path = run()
    line = "potential  axisymmetric expansion, "
    for command in (("check", path, "--draws", "2"), ("stream", path)):
        shown = call(*command)
        assert shown.exit_code == 0, shown.output
        assert line in shown.stdout
        assert "held-out points" in shown.stdout
    assert 'expansion = "auto"' in sk.load(path).toml()
    assert "held-out" not in call("stream", path, "--set", 'potential.expansion="none"').stdout


@pytest.mark.slow  # the forces are compared in test_expand.py
def test_a_stream_by_the_expansion_is_that_of_the_potential(run):
    spec = sk.load(run())
    expanded = Model(spec).stream()
    exact = Model(spec.with_values({"potential.expansion": "none"})).stream()
    away = np.sqrt(((expanded.q - exact.q) ** 2).sum(axis=0))
    assert 0 < np.median(away) < 0.05
    assert np.mean(expanded.bound == exact.bound) > 0.99


def test_what_misses_its_tolerance_or_changes_in_time_ends_the_command(run):
    from commands import call, refused

    said = refused("stream", run('expansion = "spherical"', "sphere.toml"))
    assert "potential (halo_disc): its spherical expansion misses the tolerance 0.0001" in said
    assert 'take expansion = "auto"' in said
    result = call("check", run("rate = 0.01", "time.toml"))
    assert result.exit_code == 2
    assert "potential (halo_disc): it changes in time" in result.stderr
    said = refused("stream", run("tolerance = 1.0", "tolerance.toml"))
    assert "potential.tolerance" in said


def test_in_a_fit_other_parameters_that_miss_it_are_rejected(run):
    path = run('height = { uniform = ["0.001 kpc", "2 kpc"] }', "fit.toml")
    posterior = sk.Posterior(sk.load(path))
    names = list(posterior.spec.names)
    theta = posterior.spec.centre()
    shapes = set()
    for height in (1.0, 1.3):
        theta[names.index("potential.height")] = height
        inputs = posterior.spec.bind(theta)
        shapes.add(inputs.potentials["potential"].expanded().grid)
    assert len(shapes) == 1
    theta[names.index("potential.height")] = 0.0011
    assert posterior.evaluate(theta).reason == "the expansion of the potential halo_disc misses its tolerance"
