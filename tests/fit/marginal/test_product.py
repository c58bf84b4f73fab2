"""Likelihoods of linear streams as functions of the host, through their files: all follows from Gaussians."""

import io

import numpy as np
import pytest

from streamkit.builtin.data.host_likelihood import read_surface
from streamkit.fit.marginal import stream_alone
from streamkit.fit.marginal.host_likelihood import table_of
from streamkit.fit.marginal.integral import integrate
from streamkit.fit.marginal.stream_alone import StreamAlone
from streamkit.fit.marginal.surface import fit
from streamkit.runfile import Normal, Uniform

HOST, OWN, DATA = 4, 5, 16
PRIORS = [Uniform(-20.0, 20.0)] * HOST + [Normal(0.0, 1.0)] * OWN
UNITS = {f"potential.{letter}": "" for letter in "abcd"}


class Linear:
    """Data that are linear in host and own parameters, with unit errors; an emulated likelihood without any error."""

    priors = PRIORS

    def __init__(self, seed: int, host: np.ndarray) -> None:
        rng = np.random.default_rng(seed)
        self.of_host = 0.75 * rng.standard_normal((DATA, HOST))
        self.of_own = 1.5 * rng.standard_normal((DATA, OWN))
        self.data = self.of_host @ host + self.of_own @ rng.standard_normal(OWN) + rng.standard_normal(DATA)

    def ln_likelihood(self, points):
        model = points[:, :HOST] @ self.of_host.T + points[:, HOST : HOST + OWN] @ self.of_own.T
        return -0.5 * np.sum((model - self.data) ** 2, axis=1)

    def is_trusted(self, points):
        return np.ones(len(points), dtype=bool)

    def redrawn(self, rng):
        return self

    def about_the_host(self):
        """Precision (d, d) of the host and its pull (d,): with the prior of its own parameters, data have C C^T + 1."""
        inverse = np.linalg.inv(self.of_own @ self.of_own.T + np.eye(DATA))
        return self.of_host.T @ inverse @ self.of_host, self.of_host.T @ inverse @ self.data

    def exactly(self, hosts):
        """(n,) ln of the integral of exp(ln_likelihood) times the prior of its own parameters, at hosts (n, d)."""
        covariance = self.of_own @ self.of_own.T + np.eye(DATA)
        away = hosts @ self.of_host.T - self.data
        chi2 = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away)
        return -0.5 * chi2 - 0.5 * np.linalg.slogdet(covariance)[1]


class Shelved(Linear):
    """Beside the others six parameters that have only an upper limit, as the logarithm of an extra error has."""

    SHELVES, LOWEST, HIGHEST, WIDTH = 6, -3.0, 1.0, 0.15
    priors = [*PRIORS, *SHELVES * [Uniform(LOWEST, HIGHEST)]]

    def ln_likelihood(self, points):
        above = np.maximum(points[:, HOST + OWN :], 0.0) / self.WIDTH
        return super().ln_likelihood(points) - 0.5 * np.sum(above**2, axis=1)

    def exactly(self, hosts):
        allowed = (-self.LOWEST + self.WIDTH * np.sqrt(np.pi / 2)) / (self.HIGHEST - self.LOWEST)
        return super().exactly(hosts) + self.SHELVES * np.log(allowed)


def marginal_of(stream, seed=3, joint=None):
    own = len(stream.priors) - HOST
    alone = StreamAlone(stream, stream.priors, np.arange(HOST), np.arange(HOST, HOST + own))
    rng = np.random.default_rng(seed)
    begin = [rng.uniform(-6, 6, (3000, HOST)), rng.standard_normal((3000, OWN)), rng.uniform(-2, 0, (3000, own - OWN))]
    begin = np.column_stack(begin)
    return alone, integrate(alone, begin, seed, joint)


def file_of(stream, name="toy", joint=None):
    """The surface of a stream, through the text of its file."""
    alone, marginal = marginal_of(stream, joint=joint)
    text = io.StringIO()
    table_of(name, UNITS, alone, marginal, fit(marginal), {"assumes": {}}).write(text, format="ascii.ecsv")
    return read_surface(name, text.getvalue())


def joint(streams):
    """Mean (d,) and covariance (d, d) of the host by all streams, in closed form."""
    precision, pull = (np.sum(each, axis=0) for each in zip(*(s.about_the_host() for s in streams), strict=True))
    return np.linalg.solve(precision, pull), np.linalg.inv(precision)


def product(files, mean, covariance, n=4000):
    """Mean and standard deviations (d,) of the host by the product of files: draws about a Gaussian are weighed."""
    rng = np.random.default_rng(8)
    white = rng.standard_normal((n, HOST))
    hosts = mean + 1.4 * white @ np.linalg.cholesky(covariance).T
    inside = np.all([each.has(hosts) for each in files], axis=0)
    ln_w = np.sum([each.ln_likelihood(hosts) for each in files], axis=0) + 0.5 * np.sum(white**2, axis=1)
    w = np.where(inside, np.exp(ln_w - ln_w[inside].max()), 0.0)
    w /= w.sum()
    found = w @ hosts
    return found, np.sqrt(w @ (hosts - found) ** 2), 1 / np.sum(w**2)


@pytest.fixture
def shorter_walk(monkeypatch):
    """Fewer steps to the hosts, where a test looks at the integral there."""
    monkeypatch.setattr(stream_alone, "STEPS", 400)


TRUTH = np.random.default_rng(1).standard_normal(HOST)


@pytest.fixture(scope="module")
def eight():
    """Eight streams in one host, and their files."""
    streams = [Linear(seed, TRUTH) for seed in range(8)]
    return streams, [file_of(each) for each in streams]


def is_joint(files, mean, covariance):
    """The product of files has this mean and covariance; return its effective number of samples."""
    found, width, effective = product(files, mean, covariance)
    errors = np.sqrt(np.diag(covariance))
    assert np.abs((found - mean) / errors).max() < 0.15
    assert np.abs(width / errors - 1).max() < 0.1
    return effective


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 8])
def test_the_product_of_files_is_the_joint_posterior(eight, count):
    streams, files = (each[:count] for each in eight)
    mean, covariance = joint(streams)
    assert is_joint(files, mean, covariance) > 1000


def distance(stream, streams):
    """How far the host of all streams is from that of one stream alone, in standard deviations of the latter."""
    precision, pull = stream.about_the_host()
    away = joint(streams)[0] - np.linalg.solve(precision, pull)
    return float(np.sqrt(away @ precision @ away))


@pytest.mark.slow
def test_a_joint_host_far_from_one_stream_is_inside_its_file(eight):
    streams, files = (each[:4] for each in eight)
    others, direction = joint(streams[1:])[0], np.linalg.eigh(streams[0].about_the_host()[0])[1][:, -1]
    moved = [Linear(0, TRUTH + size * direction) for size in np.linspace(0.0, 8.0, 81)]
    far = next(each for each in moved if distance(each, [each, *streams[1:]]) > 2.8)
    streams, files = [far, *streams[1:]], [file_of(far), *files[1:]]
    mean, covariance = joint(streams)
    assert distance(streams[0], streams) == pytest.approx(2.8, abs=0.2)
    assert np.abs((mean - others) / np.sqrt(np.diag(covariance))).max() > 1
    assert files[0].reach > 5
    is_joint(files, mean, covariance)
    beyond = files[0].centre + 1.2 * files[0].reach * np.linalg.inv(files[0].whiten)[0]
    assert not files[0].has(beyond[None])[0]


@pytest.mark.usefixtures("shorter_walk")
@pytest.mark.parametrize(("kind", "poorest", "left_out"), [(Linear, 0.0, 0.05), (Shelved, 0.1, 0.15)])
def test_the_integral_is_that_of_the_closed_form_within_its_error(kind, poorest, left_out):
    stream = kind(2, np.zeros(HOST))
    _, marginal = marginal_of(stream)
    away = marginal.ln_likelihood - stream.exactly(marginal.hosts)
    assert np.std(away / marginal.error) == pytest.approx(1.0, abs=0.15)
    assert np.abs(np.mean(away)) < 4 * np.median(marginal.error) / np.sqrt(len(away))
    assert np.quantile(marginal.effective, poorest) > 50
    precision, pull = stream.about_the_host()
    mean, errors = np.linalg.solve(precision, pull), np.sqrt(np.diag(np.linalg.inv(precision)))
    assert np.abs((marginal.alone.mean(axis=0) - mean) / errors).max() < 0.25
    fitted = fit(marginal)
    assert fitted.reach > 5
    assert fitted.left_out < left_out


class Noisy(Linear):
    """The same after calls with noise: another draw of it adds a number times the first parameter of the host."""

    slope = 0.0

    def ln_likelihood(self, points):
        return super().ln_likelihood(points) + self.slope * points[:, 0]

    def redrawn(self, rng):
        other = Noisy.__new__(Noisy)
        other.__dict__.update(self.__dict__, slope=0.3 * rng.standard_normal())
        return other


@pytest.mark.usefixtures("shorter_walk")
def test_the_noise_of_the_calls_is_part_of_the_error():
    """Standard deviation of ln of the integral: 0.3 times the first parameter; six draws give it to 30 %."""
    _, marginal = marginal_of(Noisy(2, np.zeros(HOST)))
    expected = 0.3 * np.abs(marginal.hosts[:, 0])
    large = expected > 0.3
    ratio = marginal.error[large] / expected[large]
    assert large.sum() > 50
    assert 0.4 < np.median(ratio) < 1.6


class Short(Linear):
    """The same with calls for the first parameter of the host below 1 alone."""

    def is_trusted(self, points):
        return points[:, 0] < 1


def test_the_domain_ends_where_the_calls_end():
    file = file_of(Short(2, np.zeros(HOST)))
    x = np.random.default_rng(4).normal(size=(4000, HOST))
    y = file.centre + 2.2 * x @ np.linalg.inv(file.whiten)
    inside, first, near = file.has(y), y[:, 0], np.sum((2.2 * x) ** 2, axis=1) < file.reach**2
    assert (near & (first > 1.5)).sum() > 50
    assert inside[near & (first > 1.5)].mean() < 0.15
    assert inside[near & (first < 0)].mean() > 0.95


class Apart(Linear):
    """The same with calls within 3 standard deviations of the stream alone, and where all streams of a run agree."""

    def is_trusted(self, points):
        precision, pull = self.about_the_host()
        away = points[:, :HOST] - np.linalg.solve(precision, pull)
        agreed = points[:, :HOST] - self.agreed
        alone = np.einsum("ni,ij,nj->n", away, precision, away) < 9.0
        return alone | (np.einsum("ni,ij,nj->n", agreed, 9.0 * precision, agreed) < 36.0)


@pytest.mark.usefixtures("shorter_walk")
def test_the_domain_has_the_hosts_of_all_streams_of_a_run():
    """They are 6.5 standard deviations from the stream alone, and a third as wide; no call is on the other side."""
    stream = Apart(2, np.zeros(HOST))
    precision, pull = stream.about_the_host()
    direction = np.linalg.inv(np.linalg.cholesky(precision)).T
    stream.agreed = np.linalg.solve(precision, pull) + 6.5 * direction[:, 0]
    hosts = stream.agreed + np.random.default_rng(6).standard_normal((3000, HOST)) @ direction.T / 3
    assert file_of(stream).has(hosts).mean() < 0.1
    file = file_of(stream, joint=hosts)
    assert file.has(hosts).mean() > 0.95
    off = file.ln_likelihood(hosts) - stream.exactly(hosts)
    assert np.std(off) < 0.3
    opposite = 2 * np.linalg.solve(precision, pull) - hosts
    assert file.has(opposite).mean() < 0.1
