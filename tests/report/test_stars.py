"""Mock stars: what the Sun sees of the particles, masses of Kroupa's function, and magnitudes of an isochrone."""

import numpy as np
import pytest
from astropy.table import QTable, Table
from commands import call, refused
from scipy.integrate import quad
from scipy.stats import kstest

import streamkit as sk
from streamkit import StreamkitError
from streamkit.report import read_isochrone, star_table, write_stars
from streamkit.report.stars import initial_masses

GD1 = "examples/gd1/gd1_literal.toml"
ISOCHRONE = "mass,lsst_g,lsst_r\n0.8,4.0,3.5\n0.1,14.0,12.5\n0.4,9.0,8.0\n"


@pytest.fixture(scope="module")
def stream():
    spec = sk.load(GD1).with_values({"stripping.particles": 200, "progenitor.lookback": 1.0})
    return sk.Model(spec).stream()


@pytest.fixture
def isochrone(tmp_path):
    (tmp_path / "iso.csv").write_text(ISOCHRONE)
    return read_isochrone(tmp_path / "iso.csv")


@pytest.mark.parametrize(("low", "high"), [(0.1, 0.8), (0.02, 5.0), (0.6, 0.9)])
def test_masses_are_those_of_kroupa(low, high):
    def density(m):  # Kroupa 2001, equations 1 and 2
        if m < 0.08:
            return (m / 0.08) ** -0.3
        return (m / 0.08) ** -1.3 if m < 0.5 else (0.5 / 0.08) ** -1.3 * (m / 0.5) ** -2.3

    def below(m):
        return quad(density, low, m, points=[p for p in (0.08, 0.5) if low < p < m])[0]

    shares = np.linspace(0, 1, 21)
    masses = initial_masses(shares, low, high)
    assert np.isclose(masses[0], low)
    assert np.isclose(masses[-1], high)
    assert np.allclose([below(m) / below(high) for m in masses], shares, atol=1e-8)


def test_stars_are_the_unbound_particles_as_the_sun_sees_them(stream):
    free = ~stream.bound
    stars, seen = star_table(stream, "GD1Koposov10"), stream.seen("GD1Koposov10")
    assert len(stars) == free.sum()
    assert np.array_equal(stars["phi1"].value, seen.lon[free])
    assert np.array_equal(stars["pm_phi2"].value, seen.pm_lat[free])
    assert np.allclose(10 ** (stars["dist"].value / 5 - 2), stars["distance"].value)  # 10 pc have the modulus 0
    frame = sk.sky_frame("GD1Koposov10")
    assert np.allclose(frame.from_icrs(stars["ra"].value, stars["dec"].value)[:2], [seen.lon[free], seen.lat[free]])
    assert ((stars["ra"].value >= 0) & (stars["ra"].value < 360)).all()
    assert "weight" not in stars.colnames


def test_magnitudes_are_those_of_the_isochrone_at_the_distance(stream, isochrone):
    stars = star_table(stream, None, isochrone, seed=3)
    mass = stars["mass"].value
    absolute = stars["lsst_g_true"].value - stars["dist"].value
    assert np.allclose(absolute, np.interp(mass, [0.1, 0.4, 0.8], [14, 9, 4]))
    colour = stars["lsst_g_true"].value - stars["lsst_r_true"].value
    assert ((colour >= 0.5) & (colour <= 1.5)).all()
    many = initial_masses(np.linspace(0, 1, 10_001), 0.1, 0.8)
    assert kstest(mass, many).pvalue > 0.01
    assert np.array_equal(mass, star_table(stream, None, isochrone, seed=3)["mass"].value)
    assert not np.array_equal(mass, star_table(stream, None, isochrone, seed=4)["mass"].value)


@pytest.mark.parametrize("name", ["stars.csv", "stars.ecsv"])
def test_the_file_gives_the_numbers_back(stream, isochrone, tmp_path, name):
    stars = star_table(stream, "GD1Koposov10", isochrone)
    write_stars(stars, tmp_path / name)
    if name == "stars.csv":
        pd = pytest.importorskip("pandas")
        read = pd.read_csv(tmp_path / name)  # as streamobs does
        assert {"ra", "dec", "phi1", "phi2", "dist", "lsst_g_true", "lsst_r_true"} <= set(read.columns)
        assert np.array_equal(read["dist"], stars["dist"].value)
    else:
        assert np.array_equal(QTable.read(tmp_path / name)["distance"], stars["distance"])


@pytest.mark.parametrize(("text", "message"), [
    ("Mass,g\n1,2\n2,3\n", "no column 'mass'. Did you mean 'Mass'"),
    ("mass\n1\n2\n", "beside 'mass' a column for each band"),
    ("mass,g\n1,2\n", "two rows or more"),
    ("mass,g\n1,2\n-1,3\n", "mass: row 2: found -1, expected a positive mass"),
    ("mass,g\n1,2\n2,nan\n", "g: row 2: found nan, expected an absolute magnitude"),
    ("mass,g\n1,2\n2,bright\n", "g: not a column of numbers"),
])  # fmt: skip
def test_a_file_that_is_no_isochrone_is_refused(tmp_path, text, message):
    (tmp_path / "iso.csv").write_text(text)
    with pytest.raises(StreamkitError, match=message):
        read_isochrone(tmp_path / "iso.csv")
    with pytest.raises(StreamkitError, match=r"missing\.csv: cannot be read: No such file or directory$"):
        read_isochrone(tmp_path / "missing.csv")


def test_the_command_writes_them(tmp_path):
    (tmp_path / "iso.csv").write_text(ISOCHRONE)
    out = tmp_path / "stars.csv"
    few = ["--set", "stripping.particles=100", "--set", "progenitor.lookback=1"]
    text = call("stream", GD1, *few, "--stars", str(out), "--isochrone", str(tmp_path / "iso.csv"))
    assert text.exit_code == 0
    assert f"mock stars: {out}" in text.stdout
    stars = Table.read(out, format="ascii.csv")
    assert "phi1" in stars.colnames  # the frame is that of the observable
    assert 50 < len(stars) <= 100
    assert "--stars FILE is missing" in refused("stream", GD1, "--isochrone", str(tmp_path / "iso.csv"))
    assert "the suffix says the format" in refused("stream", GD1, "--stars", str(tmp_path / "stars.fits"))
