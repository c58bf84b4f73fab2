"""What encounters change in a stream: dispersion, stars off the track and power spectrum, against closed forms."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtr

import streamkit as sk
from streamkit.builtin.observables.dispersion import Dispersion
from streamkit.builtin.observables.off_track import OffTrack
from streamkit.builtin.observables.power_spectrum import PowerSpectrum
from streamkit.testing.streams import example_stream

FRAME = {"pole": [192.86, 27.13], "origin": [266.4, -28.94]}


@dataclass
class Drawn:
    """Particles with known places on the sky, in the form of a stream."""

    lon: np.ndarray
    lat: np.ndarray = field(default_factory=lambda: np.zeros(0))
    radial_velocity: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self):
        self.bound, self.weight = np.zeros(len(self), dtype=bool), np.ones(len(self))

    def __len__(self):
        return len(self.lon)

    def seen(self, _frame):
        return SimpleNamespace(lon=self.lon, lat=self.lat, radial_velocity=self.radial_velocity)


def dispersion(phi1, **fields):
    table = {"phi1": phi1, "dispersion": np.full(len(phi1), 3.0), "error": np.full(len(phi1), 0.3)}
    return Dispersion(frame=FRAME, table=table, **fields)


def off_track(phi1, **fields):
    table = {"phi1": phi1, "share": np.full(len(phi1), 0.1), "error": np.full(len(phi1), 0.02)}
    return OffTrack(frame=FRAME, table=table, **fields)


def power(wavelength, **fields):
    table = {"wavelength": wavelength, "power": np.full(len(wavelength), 0.3), "error": np.full(len(wavelength), 0.1)}
    return PowerSpectrum(frame=FRAME, table=table, **fields)


def scatters(observable, draw, count=120):
    """Means, their scatter, and the stated standard deviations, over streams drawn anew."""
    found = [observable.predict(draw(np.random.default_rng(i))) for i in range(count)]
    means, variances = (np.array([getattr(each, name) for each in found]) for name in ("mean", "variance"))
    return means.mean(axis=0), means.std(axis=0), np.sqrt(variances.mean(axis=0))


def test_the_dispersion_of_a_stream_with_a_gradient_is_that_about_it():
    """Velocities of 2.5 km/s about a line, and of 6 km/s beyond phi1 = 10: a gradient does not count."""

    def draw(rng):
        lon = rng.uniform(-40, 40, 4000)
        sigma = np.where(lon > 10, 6.0, 2.5)
        return Drawn(lon, radial_velocity=-80.0 + 4.0 * lon + sigma * rng.normal(size=4000))

    mean, scatter, stated = scatters(dispersion([-20.0, 0.0, 25.0], kernel=2.0), draw)
    assert mean == pytest.approx([2.5, 2.5, 6.0], rel=0.02)
    assert stated == pytest.approx(scatter, rel=0.3)


def test_the_share_beside_a_track_is_that_of_a_normal_distribution_with_a_spur():
    """Stars 0.3 deg about a parabola, of which one in ten above phi1 = 0 is 2 deg higher."""

    def draw(rng):
        lon = rng.uniform(-40, 40, 6000)
        spur = (rng.random(6000) < 0.1) & (lon > 0)
        return Drawn(lon, 1.0 + 0.1 * lon - 0.0005 * lon**2 + 0.3 * rng.normal(size=6000) + 2.0 * spur)

    tail = ndtr(-0.6 / 0.3)
    mean, scatter, stated = scatters(off_track([-20.0, 20.0], beyond=0.6, side="above"), draw, 60)
    assert mean == pytest.approx([tail, 0.1 + 0.9 * tail], rel=0.05)
    assert stated == pytest.approx(scatter, rel=0.25)
    one = draw(np.random.default_rng(0))
    above, below, both = (
        off_track([-20.0, 20.0], beyond=0.6, **side).predict(one).mean
        for side in ({"side": "above"}, {"side": "below"}, {})
    )
    assert both == pytest.approx(above + below)
    below, *_ = scatters(off_track([-20.0, 20.0], beyond=0.6, side="below"), draw, 30)
    assert below == pytest.approx([tail, 0.9 * tail], rel=0.12)


def wave(rng, amplitude, length, count):
    """Longitudes between -40 and 40 deg with a density 1 + A cos(2 pi x / length)."""
    x = rng.uniform(-40, 40, 4 * count)
    keep = rng.random(4 * count) * (1 + amplitude) < 1 + amplitude * np.cos(2 * np.pi * x / length)
    return x[keep][:count]


def test_the_power_of_a_wave_is_half_its_amplitude_squared_times_the_length():
    observable = power([20.0, 10.0, 5.0], low=-40, high=40)
    mean, scatter, stated = scatters(observable, lambda rng: Drawn(wave(rng, 0.4, 10.0, 4000)), 200)
    exact = 0.4**2 * 80 / 2
    noise = 2 * 80 / 4000 / np.sqrt(200)
    assert mean == pytest.approx([0.0, exact, 0.0], abs=0.02 * exact + 4 * noise)
    assert stated[1] == pytest.approx(scatter[1], rel=0.25)
    assert (stated > scatter).all()  # powers below zero are taken for zero: it is not less
    assert (stated < 1.5 * scatter).all()


def test_shot_noise_is_subtracted_and_that_of_the_data_added():
    draw = lambda rng: Drawn(rng.uniform(-40, 40, 500))  # noqa: E731
    shot = 2 * 80 / 500
    mean, scatter, _ = scatters(power([40.0, 8.0, 4.0], low=-40, high=40, degree=0), draw, 300)
    assert mean == pytest.approx(0.0, abs=4 * shot / np.sqrt(300))
    assert scatter == pytest.approx(shot, rel=0.25)
    one = draw(np.random.default_rng(1))
    noisy, clean = (power([8.0], low=-40, high=40, shot_noise=s).predict(one).mean for s in (0.3, 0.0))
    assert noisy - clean == pytest.approx(0.3)


def test_a_smooth_density_has_no_power():
    """A density that rises by a cubic polynomial, which is divided out; without that it has power."""

    def draw(rng):
        x = rng.uniform(-1, 1, 40_000)
        return Drawn(40 * x[rng.random(40_000) * 2 < 1 + 0.8 * x**3])

    shot = 2 * 80 / 20_000
    mean, *_ = scatters(power([40.0, 20.0], low=-40, high=40), draw, 40)
    assert mean == pytest.approx(0.0, abs=5 * shot / np.sqrt(40) + shot)
    assert power([40.0], low=-40, high=40, degree=0).predict(draw(np.random.default_rng(0))).mean[0] > 20 * shot


KINDS = [dispersion([-5.0, 5.0]), off_track([-5.0, 5.0], beyond=1.0), power([10.0, 5.0], low=-20, high=20)]


@pytest.mark.parametrize("observable", KINDS, ids=lambda one: one.kind)
def test_mock_data_panels_and_reasons(observable):
    stream = example_stream()
    prediction = observable.predict(stream)
    assert np.isfinite(prediction.mean).all()
    assert (prediction.variance > 0).all()
    rng = np.random.default_rng(3)
    (name,) = {"dispersion", "share", "power"} & set(observable.table.names)
    drawn = np.array([observable.mock(prediction, rng)["table"][name] for _ in range(400)])
    assert drawn.mean(axis=0) == pytest.approx(prediction.mean, abs=0.2 * observable.table["error"].max() + 0.01)
    (panel,) = observable.panels(stream, prediction)
    assert panel.data is not None
    assert len(panel.data.pull) == 2
    assert np.isfinite(panel.marks[0].y).all()
    gone = replace(stream, bound=np.ones(len(stream), dtype=bool))
    assert observable.predict(gone).why_not
    assert observable.panels(gone, observable.predict(gone))


def test_data_beyond_the_stream_are_told():
    rng = np.random.default_rng(2)
    lon = rng.uniform(-20, 20, 2000)
    stream = Drawn(lon, rng.normal(size=2000), rng.normal(size=2000))
    for observable in (dispersion([0.0, 90.0]), off_track([0.0, 90.0], beyond=1.0)):
        (remark,) = observable.remarks(observable.predict(stream))
        assert "1 of 2 data lie where the stream has no debris" in remark
    wide = power([20.0], low=-60, high=60)
    assert "does not fill phi1 = -60 to 60 deg" in wide.remarks(wide.predict(stream))[0]


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"low": 40.0, "high": 40.0}, "found low = 40 and high = 40 deg, expected 0 < high - low <= 180"),
        ({"low": 0.0, "high": 8.0}, "found a wavelength longer than high - low = 8 deg"),
        ({"degree": -1}, "observable.degree"),
    ],
)
def test_a_spectrum_that_cannot_be_is_refused(changed, sentence):
    document = {
        "potential": {"kind": "logarithmic_halo", "v0": 220},
        "progenitor": {"kind": "plummer", "mass": 1e4, "radius": "20 pc", "x": 10, "y": 0, "z": 0, "vx": 0, "vy": 200,
                       "vz": 0, "lookback": 1},
        "observable": {"kind": "power_spectrum"} | PowerSpectrum.example | changed,
        "stripping": {"kind": "mlcs"},
    }  # fmt: skip
    with pytest.raises(sk.SpecError) as error:
        sk.load(document)
    assert sentence in str(error.value)
