"""Member stars in ICRS as data of `track`: against astropy's frames, scipy's bivariate Gaussian, and samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy import coordinates as c
from astropy import units as u
from astropy.table import Table
from pydantic import ValidationError
from runfiles import changed
from scipy.stats import multivariate_normal, norm

import streamkit as sk
from streamkit.builtin.observables.track.likelihood import Side, ln_mixture, ln_mixture_of_pairs
from streamkit.builtin.observables.track.observable import Track
from streamkit.report import describe_measured
from streamkit.testing.streams import example_stream

PM = u.mas / u.yr
FRAME = {"pole": [192.86, 27.13], "origin": [266.4, -28.94]}


def table(n: int = 12, seed: int = 0) -> dict[str, Any]:
    """Stars near the debris of the example, with correlated errors; every third has no velocity."""
    rng = np.random.default_rng(seed)
    ra, dec, *_ = sk.sky_frame(FRAME).to_icrs(rng.uniform(-40, 40, n), rng.normal(0, 5, n))
    velocity = np.where(np.arange(n) % 3 == 2, np.nan, rng.normal(0, 80, n))
    return {
        "ra": ra.tolist(), "dec": dec.tolist(), "pm_ra_cosdec": rng.normal(-1, 1, n).tolist(),
        "pm_dec": rng.normal(-2, 1, n).tolist(), "pm_ra_cosdec_error": rng.uniform(0.1, 0.3, n).tolist(),
        "pm_dec_error": rng.uniform(0.4, 0.6, n).tolist(), "pm_correlation": rng.uniform(-0.6, 0.6, n).tolist(),
        "radial_velocity": velocity.tolist(), "radial_velocity_error": np.full(n, 5.0).tolist(),
    }  # fmt: skip


def astropy_frame() -> c.SkyOffsetFrame:
    """The same frame as an offset frame of astropy: about its origin, turned until the pole is the pole."""
    frame = sk.sky_frame(FRAME)
    origin, pole = (c.SkyCoord(*place, unit="deg") for place in (frame.origin, frame.pole))
    return c.SkyOffsetFrame(origin=origin, rotation=origin.position_angle(pole))


def test_data_and_errors_are_those_of_astropy() -> None:
    """Errors from 4000 motions drawn for each star in ICRS, turned by astropy."""
    stars, rng = table(), np.random.default_rng(1)
    track = Track(frame=FRAME, members=stars)
    sky = c.SkyCoord(stars["ra"] * u.deg, stars["dec"] * u.deg, pm_ra_cosdec=stars["pm_ra_cosdec"] * PM,
                     pm_dec=stars["pm_dec"] * PM).transform_to(astropy_frame())  # fmt: skip
    np.testing.assert_allclose(track.given["phi2"][0], sky.lon.wrap_at(180 * u.deg).deg, atol=1e-8)
    np.testing.assert_allclose(track.given["phi2"][1], sky.lat.deg, atol=1e-8)
    np.testing.assert_allclose(track.given["pm_phi2"][1], sky.pm_lat.to_value(PM), atol=1e-8)
    for i in range(3):
        errors = np.array([stars["pm_ra_cosdec_error"][i], stars["pm_dec_error"][i]])
        cross = stars["pm_correlation"][i] * errors.prod()
        drawn = rng.multivariate_normal([0, 0], [[errors[0] ** 2, cross], [cross, errors[1] ** 2]], 4000).T
        place = np.full(4000, stars["ra"][i]) * u.deg, np.full(4000, stars["dec"][i]) * u.deg
        turned = c.SkyCoord(*place, pm_ra_cosdec=drawn[0] * PM, pm_dec=drawn[1] * PM).transform_to(astropy_frame())
        expected = np.cov(turned.pm_lon_coslat.to_value(PM), turned.pm_lat.to_value(PM))
        assert track.given["pm_phi1_cosphi2"][2][i] == pytest.approx(np.sqrt(expected[0, 0]), rel=0.05)
        assert track.given["pm_phi2"][2][i] == pytest.approx(np.sqrt(expected[1, 1]), rel=0.05)
        assert track._stars is not None
        assert track._stars.covariance[i] == pytest.approx(expected[0, 1], abs=0.01)


def test_a_missing_value_is_no_datum() -> None:
    stars = table()
    track = Track(frame=FRAME, members=stars)
    assert {name: len(part[0]) for name, part in track.given.items()} == {
        "phi2": 12, "pm_phi1_cosphi2": 12, "pm_phi2": 12, "radial_velocity": 8,
    }  # fmt: skip
    velocity = np.array(stars["radial_velocity"])
    np.testing.assert_array_equal(track.given["radial_velocity"][1], velocity[np.isfinite(velocity)])


def test_a_pair_is_scipys_bivariate_gaussian() -> None:
    rng, n = np.random.default_rng(2), 5
    x, y, mean, other = rng.normal(size=(4, n))
    xx, yy = rng.uniform(0.5, 2, (2, n))
    cross, none = rng.uniform(-0.4, 0.4, n), np.zeros(n)
    expected = [
        multivariate_normal([mean[i], other[i]], [[xx[i], cross[i]], [cross[i], yy[i]]]).logpdf([x[i], y[i]])
        for i in range(n)
    ]
    out = 0.0, 3.0
    one, two = Side(x, xx, mean, none, 0.0, out), Side(y, yy, other, none, 0.0, out)
    assert ln_mixture_of_pairs(one, two, cross) == pytest.approx(expected)
    # with outliers and without a covariance: two mixtures
    one, two = Side(x, xx, mean, none - 0.1, 0.2, out), Side(y, yy, other, none - 0.1, 0.3, (1.0, 4.0))
    apart = ln_mixture(one) + ln_mixture(two)
    assert ln_mixture_of_pairs(one, two, none) == pytest.approx(apart)


@pytest.mark.parametrize("moving", [True, False])
def test_the_likelihood_is_that_of_stars_in_the_frame(moving: bool) -> None:
    """With the columns written as tables in the frame; the proper motions, if any, in the eyes of their covariance."""
    stream, stars = example_stream(), {name: each for name, each in table().items() if moving or name[:3] != "pm_"}
    track = Track(frame=FRAME, members=stars, kernel=5)
    prediction = track.predict(stream)
    total = 0.0
    start = 0
    for name, (phi1, value, error) in track.given.items():
        part, start = slice(start, start + len(phi1)), start + len(phi1)
        if name in ("phi2", "radial_velocity"):
            variance = error**2 + prediction.details["spread"][part] ** 2
            density = norm(prediction.mean[part], np.sqrt(variance)).logpdf(value)
            total += float((density + prediction.details["ln_coverage"][part]).sum())
    first, second = slice(12, 24), slice(24, 36)
    assert track._stars is not None
    for i, cross in enumerate(track._stars.covariance if moving else ()):
        values = [track.given[name][1][i] for name in ("pm_phi1_cosphi2", "pm_phi2")]
        spreads = [prediction.details["spread"][part][i] for part in (first, second)]
        errors = [track.given[name][2][i] for name in ("pm_phi1_cosphi2", "pm_phi2")]
        covariance = np.diag(np.square(spreads) + np.square(errors)) + cross * (1 - np.eye(2))
        means = [prediction.mean[part][i] for part in (first, second)]
        total += multivariate_normal(means, covariance).logpdf(values)
        total += 2 * prediction.details["ln_coverage"][first][i]
    assert track.ln_likelihood(prediction, False) == pytest.approx(total)
    drawn = track.mock(prediction, np.random.default_rng(0))
    assert Track(frame=FRAME, kernel=5, **drawn).given.keys() == track.given.keys()


def test_mocks_scatter_as_the_data_and_can_be_read_again() -> None:
    stream = example_stream()
    track = Track(frame=FRAME, members=table(), kernel=5)
    prediction, rng = track.predict(stream), np.random.default_rng(3)
    drawn = [Track(frame=FRAME, kernel=5, **track.mock(prediction, rng)) for _ in range(300)]
    for name, part in (("pm_phi1_cosphi2", slice(12, 24)), ("pm_phi2", slice(24, 36)), ("phi2", slice(0, 12))):
        values = np.array([mock.given[name][1] for mock in drawn])
        scatter = np.sqrt(track.given[name][2] ** 2 + prediction.details["spread"][part] ** 2)
        np.testing.assert_allclose(values.std(axis=0), scatter, rtol=0.2)
        assert np.abs((values.mean(axis=0) - prediction.mean[part]) / scatter * np.sqrt(300)).max() < 4.5
    for mock in drawn[:2]:
        np.testing.assert_allclose(mock.given["pm_phi2"][2], track.given["pm_phi2"][2], rtol=1e-6)
        np.testing.assert_allclose(mock.given["phi2"][0], track.given["phi2"][0], atol=1e-9)


def test_a_table_of_gaia_is_read_by_its_own_names(tmp_path: Path) -> None:
    stars = table()
    names = {"pm_ra_cosdec": "pmra", "pm_dec": "pmdec", "pm_ra_cosdec_error": "pmra_error",
             "pm_dec_error": "pmdec_error", "pm_correlation": "pmra_pmdec_corr"}  # fmt: skip
    units = {"ra": "deg", "dec": "deg", "radial_velocity": "km/s", "radial_velocity_error": "km/s"}
    file = Table({names.get(name, name): column for name, column in stars.items()}, masked=True)
    file["radial_velocity"].mask = np.isnan(stars["radial_velocity"])
    for name in file.colnames:
        file[name].unit = units.get(name, None if name == "pmra_pmdec_corr" else "mas/yr")
    file.write(tmp_path / "gaia.ecsv")
    given = {"kind": "track", "frame": FRAME, "members": {"file": "gaia.ecsv", "columns": names}}
    path = tmp_path / "run.toml"
    spec = sk.load(changed("observable", given | {"members": stars}))
    import tomlkit

    document = changed("observable", given)
    path.write_text(tomlkit.dumps(document))
    read = sk.load(path).bind().observable
    expected = spec.bind().observable
    np.testing.assert_allclose(read.data(), expected.data())
    assert sk.load(spec.document).digest() == spec.digest()


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"members": {"ra": [1], "dec": [2], "distance": [3]}}, "'distance_error' is missing"),
        ({"members": table() | {"dec": [91.0] * 12}}, "dec.*91 deg, expected -90 to 90"),
        ({"members": table() | {"pm_correlation": [1.2] * 12}}, "pm_correlation: row 1 is not within"),
        ({"members": table() | {"radial_velocity_error": [float("nan")] * 12}}, "row 1 has a value and no error"),
        ({"members": {"ra": [1], "dec": [2], "pm_dec": [1], "pm_dec_error": [1]}}, "needs pm_ra_cosdec and pm_dec"),
        ({"members": table(), "compared": ["distance"]}, "members have no distance; they have phi2, radial_velocity"),
        ({"members": table(), "unwrapped": True}, "do not determine the wrap"),
        ({"members": table(), "phi2": {"phi1": [0], "phi2": [0], "error": [1]}}, "phi2 is a table and also in members"),
        ({"compared": ["phi2"], "phi2": {"phi1": [0], "phi2": [0], "error": [1]}}, "there are no members"),
    ],
)
def test_members_that_are_wrong_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        Track(frame=FRAME, **given)


def test_columns_may_be_chosen() -> None:
    track = Track(frame=FRAME, members=table(), compared=["phi2", "pm_phi2"],
                  radial_velocity={"phi1": [0], "radial_velocity": [1], "error": [2]})  # fmt: skip
    assert list(track.given) == ["phi2", "pm_phi2", "radial_velocity"]
    assert np.isfinite(track.ln_likelihood(track.predict(example_stream()), True))


def test_tables_count_deviations_in_the_scatter_of_the_likelihood() -> None:
    """A position has an error of 0.001 deg: a star is judged by the debris about it, with an extra dispersion."""
    track = Track(frame=FRAME, members=table(), compared=["phi2"], phi2_dispersion=0.5)
    prediction = track.predict(example_stream())
    scatter = np.sqrt(0.001**2 + 0.5**2 + prediction.details["spread"] ** 2)
    np.testing.assert_allclose(track.scatter(prediction), scatter)
    text = describe_measured("observables", [track], prediction)
    stars = (track.data()[0] - prediction.mean) / scatter
    assert [float(line.split()[-2]) for line in text.splitlines()[2:14]] == pytest.approx(stars.tolist(), abs=0.051)
    assert "spread of the debris" in text


def test_means_without_dispersion_count_in_their_errors() -> None:
    means = {"phi1": [-10.0, 10.0], "phi2": [0.0, 1.0], "error": [0.5, 2.0]}
    track = Track(frame=FRAME, phi2=means)
    prediction = track.predict(example_stream())
    assert track.scatter(prediction).tolist() == [0.5, 2.0]
    assert "spread" not in describe_measured("observables", [track], prediction)
