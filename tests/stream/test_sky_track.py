"""`Stream.track`: a cloud whose mean and covariance are written down, and the observable `track`'s own lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pictures import assert_readable

import streamkit as sk
from streamkit.stream.frames import axes
from streamkit.testing.streams import example_stream

# phi2, distance, pm_phi1_cosphi2, pm_phi2, radial_velocity: value at phi1 = 0, slope per degree; and the covariance.
AT_ZERO, SLOPE = np.array([1.0, 20.0, -3.0, 1.0, 40.0]), np.array([0.02, -0.05, 0.01, -0.02, 1.5])
WIDTHS, CORRELATION = np.array([0.5, 0.8, 0.2, 0.1, 6.0]), 0.7  # of phi2 and the radial velocity


def cloud(frame: sk.SkyFrame, seam: float = 0.0) -> sk.Stream:
    """A stream of 40 000 particles about straight lines, along 60 deg about a longitude."""
    rng, n = np.random.default_rng(0), 40000
    phi1 = rng.uniform(-30, 30, n)
    covariance = np.diag(WIDTHS**2)
    covariance[0, 4] = covariance[4, 0] = CORRELATION * WIDTHS[0] * WIDTHS[4]
    y = AT_ZERO[:, None] + SLOPE[:, None] * phi1 + rng.multivariate_normal(np.zeros(5), covariance, n).T
    return from_sky(frame, phi1 + seam, y)


def from_sky(frame: sk.SkyFrame, phi1: np.ndarray, y: np.ndarray) -> sk.Stream:
    """Particles at angles (n,) with the columns (5, n), unbound, in the order of a track."""
    stream, n = example_stream(), len(phi1)
    a, d = np.radians(phi1), np.radians(y[0])
    out = np.array([np.cos(a) * np.cos(d), np.sin(a) * np.cos(d), np.sin(d)])
    east = np.array([-np.sin(a), np.cos(a), 0 * a])
    north = np.array([-np.cos(a) * np.sin(d), -np.sin(a) * np.sin(d), np.cos(d)])
    motion = y[4] * out + 4.740470463533349 * y[1] * (y[2] * east + y[3] * north)
    turn = stream.sun.tilt @ axes("icrs") @ frame.matrix.T
    fill = {name: np.resize(getattr(stream, name), n) for name in ("t_release", "t_strip", "tail", "winding", "chi")}
    fill |= {"bound": np.zeros(n, dtype=bool), "weight": np.ones(n)}
    q, v = turn @ (y[1] * out) + stream.sun.q[:, None], turn @ motion + stream.sun.v[:, None]
    zero = np.zeros((3, n))
    return replace(stream, q=q, v=v, dq_galactocentric=zero, dv_galactocentric=zero, **fill)


@pytest.mark.parametrize("seam", [0.0, 180.0])
def test_means_and_covariances_are_those_of_the_cloud(seam: float) -> None:
    """Also where the debris lies across phi1 = 180 deg."""
    frame = sk.sky_frame("GD1Koposov10")
    at = np.array([-20.0, 0.0, 15.0])
    track = cloud(frame, seam).track(frame, at + seam, kernel=2.0)
    expected = AT_ZERO[:, None] + SLOPE[:, None] * at
    assert np.abs((track.mean - expected) / track.error).max() < 4
    np.testing.assert_allclose(track.spread, np.broadcast_to(WIDTHS[:, None], (5, 3)), rtol=0.05)
    np.testing.assert_allclose(track.correlation("phi2", "radial_velocity"), CORRELATION, atol=0.03)
    np.testing.assert_allclose(track.correlation("phi2", "distance"), 0, atol=0.06)
    # the particles per degree, times the kernel's integral
    np.testing.assert_allclose(track.count, 40000 / 60 * 2 * np.sqrt(2 * np.pi), rtol=0.05)
    np.testing.assert_allclose(track.error, track.spread / np.sqrt(40000 / 60 * 2 * 2 * np.sqrt(np.pi)), rtol=0.1)
    np.testing.assert_array_equal(track.phi1, at + seam)


def test_the_lines_are_those_of_the_observable() -> None:
    """Among debris, where the observable's wings and shrinkage do not matter."""
    frame = sk.sky_frame("GD1Koposov10")
    stream, at = cloud(frame), [-10.0, 5.0]
    observable = {"frame": np.array(frame), "phi2": {"phi1": at, "phi2": [0, 0], "error": [1, 1]}, "kernel": 2.0}
    from streamkit.builtin.observables.track.observable import Track

    prediction, track = Track(**observable).predict(stream), stream.track(frame, at, kernel=2.0)
    np.testing.assert_allclose(track["phi2"], prediction.mean, atol=2e-3)
    np.testing.assert_allclose(track.spread[0], prediction.details["spread"], rtol=0.01)
    np.testing.assert_allclose(track.error[0], np.sqrt(prediction.variance), rtol=0.05)


def test_a_table_with_units_and_nothing_where_there_is_no_debris() -> None:
    frame = sk.sky_frame("GD1Koposov10")
    track = cloud(frame).track(frame, [0.0, 100.0])
    table = track.table()
    assert str(table["pm_phi2_spread"].unit) == "mas / yr"
    assert table["phi2_correlation_radial_velocity"][0] == pytest.approx(CORRELATION, abs=0.05)
    assert np.isnan(table["phi2"][1].value)
    assert "from 0 to 100 deg" in repr(track)


def test_the_grid_is_even_along_the_debris_and_arms_are_parts() -> None:
    frame = sk.sky_frame("GD1Koposov10")
    stream = cloud(frame)
    phi1 = stream.track(frame, kernel=4.0).phi1
    np.testing.assert_allclose(np.diff(phi1), 2.0)
    assert phi1[0] == pytest.approx(-28)
    parts = [stream.track(frame, [0.0], arm=arm).count[0] for arm in ("leading", "trailing", "both")]
    assert parts[0] + parts[1] == pytest.approx(parts[2])
    unwrapped = stream.track(frame, unwrapped=True)
    assert np.isfinite(unwrapped["phi2"]).any()


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"kernel": 0}, "kernel is 0 deg"),
        ({"kernel": float("nan")}, "kernel is nan"),
        ({"arm": "inner"}, "found arm = 'inner'"),
        ({"phi1": [float("nan")]}, "finite numbers"),
        ({"frame": "GD1"}, "no frame 'GD1'"),
    ],
)
def test_bad_arguments_are_refused(given: dict, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        example_stream().track(**({"frame": "GD1Koposov10"} | given))


def test_the_picture_can_be_read(monkeypatch) -> None:
    frame = sk.sky_frame("GD1Koposov10")
    stream = cloud(frame)
    assert_readable(sk.draw_track(stream.track(frame), stream, frame), monkeypatch)
