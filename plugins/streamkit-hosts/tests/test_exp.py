"""Hosts of EXP: its own functions, closed forms of its basis, files that gala ships, and what cannot be used."""

from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq
from scipy.special import sph_harm_y
from streamkit_hosts import agama, exp
from streamkit_hosts.basis import Basis, Model
from streamkit_hosts.expansion import tabulated
from streamkit_hosts.sections import written

import streamkit as sk
from streamkit.cli.main import main

FILES = Path(__file__).parent / "exp"
COEFFICIENTS = FILES / "EXP-Hernquist-multi-coefs-snap-time-Gyr.hdf5"
LENGTH, MASS = 3.845, 1.25234e11  # kpc and Msun: gala's units of its files
FIRST, LAST = 3e-4, 52.0  # of the basis
R, FINE = (np.geomspace(r, 2e2, rows) / LENGTH for r, rows in ((1e-3, 1024), (1e-5, 16384)))
UNITS = exp.Units(LENGTH, MASS, 1.0)


def hernquist(r):
    return Model(r, 1 / (2 * np.pi * r * (1 + r) ** 3), -1 / (1 + r))


def write_model(path, radius=R):
    rows = np.stack(
        [radius, 1 / (2 * np.pi * radius * (1 + radius) ** 3), (radius / (1 + radius)) ** 2, -1 / (1 + radius)]
    )
    text = "\n".join(" ".join(map(repr, row)) for row in rows.T.tolist())
    path.write_text(f"! r density mass energy\n{len(radius)}\n{text}\n")


@pytest.fixture
def folder(tmp_path):
    """The basis of gala's files, with its model."""
    write_model(tmp_path / "EXP-Hernquist.model")
    (tmp_path / "basis.yml").write_text((FILES / "EXP-Hernquist-basis.yml").read_text())
    return tmp_path


def write_coefficients(path, times, values, l_max=4, n_max=10, version="1.0", **attributes):
    with h5py.File(path, "w") as file:
        file.attrs.update({"lmax": l_max, "nmax": n_max, "geometry": "sphere", "scale": 1.0})
        if version:
            file.attrs["CoefficientOutputVersion"] = version
        for k, (t, c) in enumerate(zip(times, values, strict=True)):
            group = file.create_group(f"snapshots/{k:08d}")
            group.attrs.update({"Time": t, "Center": np.zeros(3)} | attributes)
            group["coefficients"] = c
    return path


def series(a, b, c, z):
    """2F1, whose series converges inside the last radius; scipy's is wrong for numbers such as these."""
    k = np.arange(3000)
    terms = np.cumprod(np.concatenate([[1.0], (a + k) * (b + k) / (c + k) / (1 + k)]))
    return np.polynomial.polynomial.polyval(z, terms)


@cache
def closed_form(degree, n, fine=False):
    """Return lambda and Phi_ln(r) of a Hernquist sphere in a sphere: the functions of Hernquist & Ostriker (1992).

    Their n is no whole number, so that u Phi0 continues as r^-(l + 1) at the last radius, where EXP takes the slope of
    the model from its last two rows.
    """
    rows = FINE if fine else R
    slope = (1 / (1 + rows[-2]) - 1 / (1 + rows[-1])) / (rows[-1] - rows[-2])
    ratio = slope / np.interp(LAST, rows, -1 / (1 + rows))

    def u(r, order):
        return (r / (1 + r) ** 2) ** degree * series(-order, order + 4 * degree + 3, 2 * degree + 2, r / (1 + r))

    def edge(order):
        h = 1e-4 * LAST
        rise = (u(LAST + h, order) - u(LAST - h, order)) / (2 * h)
        return rise + ((1 + degree) / LAST + ratio) * u(LAST, order)

    grid = np.arange(-0.05, n + 3, 0.05)
    root = np.flatnonzero(np.diff(np.sign([edge(x) for x in grid])))[n]
    order = brentq(edge, grid[root], grid[root + 1], xtol=1e-14)
    value = order * (order + 4 * degree + 3) / 2 + (degree + 1) * (2 * degree + 1)
    x, weight = np.polynomial.legendre.leggauss(400)
    r = np.exp(0.5 * (np.log(LAST / FIRST) * x + np.log(LAST * FIRST)))
    norm = 0.5 * np.log(LAST / FIRST) * (weight * 2 * r**2 / (1 + r) ** 4 * u(r, order) ** 2).sum()
    return value, lambda r: -u(r, order) / (1 + r) / np.sqrt(norm * value)


def test_the_functions_are_those_of_exp():
    rows = np.genfromtxt(FILES / "EXP-Hernquist-functions.csv", delimiter=",", names=True, deletechars="")
    r = np.array([float(name[2:-1]) for name in rows.dtype.names[3:]])
    nodes = (1 + (x := np.linspace(*((r - 1) / (r + 1) for r in (FIRST, LAST)), 1024))) / (1 - x)
    basis = Basis(hernquist(R), 4, 10, FIRST, LAST, nodes[3])
    theirs = np.array([list(row)[3:] for row in rows]).reshape(5, 10, -1)
    value = rows["eigenvalue"].reshape(5, 10)
    np.testing.assert_allclose(basis.eigenvalues, value, rtol=3e-6)
    phi = -theirs / (1 + r) / np.sqrt(value)[:, :, None]
    np.testing.assert_allclose(basis(r), phi, atol=1e-5 * np.abs(phi).max(axis=2).max())


@pytest.mark.parametrize(("degree", "n"), [(0, 0), (0, 3), (1, 0), (1, 2), (2, 1), (4, 2)])
def test_the_functions_are_closed_forms(degree, n):
    """Of a model with many rows, as EXP takes it linear between them, and a first radius near 0."""
    basis = Basis(hernquist(FINE), 4, 10, 3e-6, LAST, 4e-3)
    value, phi = closed_form(degree, n, fine=True)
    assert basis.eigenvalues[degree, n] == pytest.approx(value, rel=1e-5)
    r = np.geomspace(0.1, 50.0, 200)
    np.testing.assert_allclose(basis(r)[degree, n], phi(r), atol=1e-5 * np.abs(phi(r)).max())


def test_gala_s_file_has_its_closed_form_at_all_times(folder):
    """Forces of one function whose amplitude is 1, 2 and 3 at 0, 0.5 and 1 Gyr: a line in time.

    To 1e-4: EXP takes the model linear between its 1024 rows.
    """
    made = tabulated(exp.read(folder / "basis.yml", COEFFICIENTS, UNITS), (1.0, 100.0))
    np.testing.assert_allclose(made.times, [-1, -0.5, 0])
    assert made.harmonics == [(0, 0)]
    assert not made.warnings()
    sphere = sk.Multipoles(*(made.table[name] for name in ("l", "m", "r", "phi")), time=made.table["t"] * sk.GYR)
    _, phi = closed_form(0, 0)
    r = np.geomspace(0.5, 150.0, 60)
    h = 1e-3
    slope = (phi(r / LENGTH * np.exp(h)) - phi(r / LENGTH * np.exp(-h))) / (2 * h)
    for t, amplitude in ((-1.0, 1.0), (-0.7, 1.6), (0.0, 3.0)):
        exact = -sk.G * MASS / LENGTH * amplitude / np.sqrt(4 * np.pi) * slope / r
        force = sphere.acceleration(0.6 * r, 0.0 * r, -0.8 * r, t * sk.GYR)
        np.testing.assert_allclose(force[0], 0.6 * exact, rtol=1e-4)
        np.testing.assert_allclose(force[2], -0.8 * exact, rtol=1e-4)
    hernquist = -sk.G * MASS * 3.0 / np.sqrt(4 * np.pi) * np.sqrt(3) / (r + LENGTH) ** 2
    near = (r > 1) & (r < 60)
    assert np.abs(-np.hypot(*force[::2]) / hernquist - 1)[near].max() < 4e-3  # the edge of EXP's basis bends it


@pytest.mark.parametrize("version", ["1.0", ""])
def test_all_degrees_and_both_orders_of_numbers(folder, version):
    """The potential is the sum of closed forms and scipy's harmonics, whose sign (-1)^m is that of EXP."""
    rng, terms = np.random.default_rng(5), [(0, 0, 0), (0, 0, 3), (1, 0, 2), (1, 1, 0), (2, 1, 1), (2, 2, 2), (4, 3, 2)]
    c = np.zeros((15, 10), dtype=complex)
    for n, m, k in terms:
        c[n * (n + 1) // 2 + m, k] = rng.normal() + 1j * rng.normal() * (m > 0) + 3 * (n + k == 0)
    stored = c if version else c.T.reshape(c.shape)
    file = write_coefficients(folder / "c.h5", [0.0], [stored], version=version)
    table = tabulated(exp.read(folder / "basis.yml", file, UNITS), (1.0, 100.0)).table
    sphere = sk.Multipoles(*(table[name] for name in ("l", "m", "r", "phi")))
    direction = rng.standard_normal((3, 200))
    q = direction / np.sqrt((direction**2).sum(axis=0)) * (r := np.geomspace(0.5, 150, 200))
    theta, angle = np.arccos(q[2] / r), np.arctan2(q[1], q[0])
    exact = np.zeros(200)
    for n, m, k in terms:
        y = np.sqrt(2.0 if m else 1.0) * sph_harm_y(n, m, theta, angle)
        value = c[n * (n + 1) // 2 + m, k]
        exact += (value.real * y.real + value.imag * y.imag) * closed_form(n, k)[1](r / LENGTH)
    exact *= sk.G * MASS / LENGTH
    np.testing.assert_allclose(sphere.potential(*q), exact, atol=1e-4 * np.abs(exact).max())


def test_units_of_the_file_and_a_cache_with_other_signs(folder):
    """Units as EXP writes them; G = 1 gives the time."""
    c = np.zeros((15, 10), dtype=complex)
    c[0, :2] = 2.0, 0.5
    file = write_coefficients(folder / "c.h5", [0.0, 10.0], [c, c])
    with h5py.File(file, "r+") as data:
        kind = [("name", "S16"), ("unit", "S16"), ("value", "f4")]
        rows = [("length", "pc", 3845.0), ("mass", "Msun", MASS), ("time", "none", 1.0), ("G", "none", 1.0)]
        data["Units"] = np.array(rows, dtype=kind)
    source = exp.read(folder / "basis.yml", file, exp.Units())
    time = np.sqrt(LENGTH**3 / (sk.G * MASS)) / sk.GYR
    np.testing.assert_allclose(source.times, [-10 * time, 0], rtol=1e-6)
    nodes = (1 + (x := np.linspace(*((r - 1) / (r + 1) for r in (FIRST, LAST)), 1024))) / (1 - x)
    basis = Basis(hernquist(R), 4, 10, FIRST, LAST, nodes[3])
    with h5py.File(folder / "EXP-Hernquist.cache", "w") as cache:
        for n in range(5):
            u = -basis(nodes)[n] * (1 + nodes) * np.sqrt(basis.eigenvalues[n])[:, None]
            u[1] *= -1
            cache[f"Harmonic/{n}/ev"], cache[f"Harmonic/{n}/ef"] = basis.eigenvalues[n][:, None], u
    turned = exp.read(folder / "basis.yml", file, exp.Units())
    r = np.array([1.0, 10.0])
    one, other = ((closed_form(0, k)[1](r / LENGTH)) for k in (0, 1))
    scale = sk.G * MASS / LENGTH / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(source.phi(r)[0, 0], scale * (2 * one + 0.5 * other), rtol=1e-4)
    np.testing.assert_allclose(turned.phi(r)[0, 0], scale * (2 * one - 0.5 * other), rtol=1e-4)
    with h5py.File(folder / "EXP-Hernquist.cache", "r+") as cache:
        cache["Harmonic/3/ev"][4] *= 1.1
    with pytest.raises(sk.StreamkitError, match=r"EXP-Hernquist\.cache: belongs to another basis"):
        exp.read(folder / "basis.yml", file, UNITS)


def test_terms_that_do_not_converge_and_a_centre_that_moves_are_told(folder):
    c = np.zeros((2, 15, 10), dtype=complex)
    c[:, 0, 0], c[:, 0, 9], c[:, 10, 0] = 2.0, 0.1, 5.0
    file = write_coefficients(folder / "c.h5", [0.0, 1.0], c)
    with h5py.File(file, "r+") as data:
        data["snapshots/00000000"].attrs["Center"] = [1.0, 0.0, 0.0]
    warned = tabulated(exp.read(folder / "basis.yml", file, UNITS), (5.0, 300.0)).warnings()
    for said in ("the last 2 of 10 functions", "the degrees above 2", "centre moves by up to 3.85 kpc", "to 200 kpc"):
        assert any(said in sentence for sentence in warned), said


def test_a_centre_that_moves_becomes_a_path(folder):
    """A parabola in the file's units: from the place and the velocity of the last time it is ``g t^2 / 2``."""
    c = np.zeros((4, 15, 10), dtype=complex)
    c[:, 0, 0] = 2.0
    times = np.array([0.0, 1.0, 2.0, 4.0])
    file = write_coefficients(folder / "c.h5", times.tolist(), c)
    with h5py.File(file, "r+") as data:
        for k, t in enumerate(times):
            data[f"snapshots/{k:08d}"].attrs["Center"] = [5.0 + 2.0 * t + 0.5 * t**2, -t, 0.0]
    source = exp.read(folder / "basis.yml", file, UNITS)
    np.testing.assert_allclose(source.path["t"], source.times)
    np.testing.assert_allclose(source.path["x"], 0.5 * LENGTH * (times - 4.0) ** 2, atol=1e-9)
    np.testing.assert_allclose([source.path["y"], source.path["z"]], 0.0, atol=1e-9)
    host = agama.Host("multipole", source.times, source, centre=source.path)
    (part,) = written([host], (5.0, 60.0), folder / "h.ecsv", force=False)
    assert part.fields == {"centre": str(folder / "h_centre.ecsv")}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("basis.yml", "id: [sphereSL"), r"basis\.yml: cannot be read as YAML"),
        (("basis.yml", "id: cylinder\nparameters: {}"), "id is 'cylinder'; expected sphereSL"),
        (("basis.yml", "id: sphereSL\nparameters: {Lmax: 4}"), "has no modelname"),
        (("basis.yml", "id: sphereSL\nparameters: {modelname: m, Lmax: x}"), "Lmax: expected a number, found 'x'"),
        (("basis.yml", "id: sphereSL\nparameters: {modelname: m, nmax: 1000}"), "nmax is 1000; expected a whole"),
        (("basis.yml", "id: sphereSL\nparameters: {modelname: m, N1: 3}"), "N1 leaves out functions"),
        (("basis.yml", "id: sphereSL\nparameters: {modelname: none}"), "none: there is no such file"),
        (("EXP-Hernquist.model", "3\n1 1 1 -1\n"), r"EXP-Hernquist\.model: expected a model of EXP"),
        (("EXP-Hernquist.model", "20\n" + "1 1 1 -1\n" * 20), "expected radii that grow"),
        (("c.h5", "no HDF5"), r"c\.h5: cannot be read as HDF5"),
    ],
    ids=lambda value: value[0][:3] + value[1][-9:] if isinstance(value, tuple) else "",
)
def test_what_cannot_be_used_is_told(folder, change, said):
    write_coefficients(folder / "c.h5", [0.0], [np.ones((15, 10), dtype=complex)])
    name, text = change
    (folder / name).write_text(text)
    with pytest.raises(sk.StreamkitError, match=said):
        exp.read(folder / "basis.yml", folder / "c.h5", UNITS)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ({"values": [np.ones((15, 9), complex)]}, r"expected coefficients \(15, 10\), found \(15, 9\)"),
        ({"values": [np.full((15, 10), np.nan + 0j)]}, "has coefficients that are not finite"),
        ({"l_max": 6}, "lmax is 6, and 4 in the basis"),
        ({"Center": [1.0, np.nan, 0.0]}, "expected a Center of three numbers"),
        ({"Rotation": np.diag([1.0, -1.0, -1.0])}, "has a Rotation"),
        ({"times": [1.0, 1.0], "values": [np.ones((15, 10), complex)] * 2}, "has several snapshots of the same time"),
        ({"times": [], "values": []}, "has no group snapshots"),
    ],
)
def test_coefficients_that_cannot_be_used_are_told(folder, written, said):
    write_coefficients(folder / "c.h5", **({"times": [0.0], "values": [np.ones((15, 10), complex)]} | written))
    with pytest.raises(sk.StreamkitError, match=said):
        exp.read(folder / "basis.yml", folder / "c.h5", UNITS)


def test_damaged_and_too_large_files_and_missing_units_are_told(folder):
    content = COEFFICIENTS.read_bytes()
    (folder / "c.h5").write_bytes(content[: len(content) // 2])
    with pytest.raises(sk.StreamkitError, match=r"c\.h5: cannot be read as HDF5"):
        exp.read(folder / "basis.yml", folder / "c.h5", UNITS)
    with pytest.raises(sk.StreamkitError, match="does not state its unit of length: give --length"):
        exp.read(folder / "basis.yml", COEFFICIENTS, exp.Units())
    with pytest.raises(sk.StreamkitError, match="does not state its unit of mass: give --mass"):
        exp.read(folder / "basis.yml", COEFFICIENTS, exp.Units(length=1.0))
    (folder / "basis.yml").write_text("#" * 1_000_001)
    with pytest.raises(sk.StreamkitError, match="has 1000001 bytes; expected at most 1000000"):
        exp.read(folder / "basis.yml", COEFFICIENTS, UNITS)


@pytest.mark.slow  # a stream in it is compiled
def test_the_command_makes_a_host_and_its_look_back_time_ends_with_the_file(folder):
    table = folder / "halo.ecsv"
    words = [str(folder / "basis.yml"), str(COEFFICIENTS), "--length", str(LENGTH), "--mass", str(MASS), "--time", "1"]
    shown = CliRunner().invoke(main, ["import-host", *words, "-o", str(table)])
    assert shown.exit_code == 0, shown.output
    assert "3 time(s), 1 harmonic(s)" in shown.output
    section = shown.output[shown.output.index("[potential]") :]
    rest = (
        '[progenitor]\nkind = "plummer"\nmass = 2e4\nradius = 0.01\nx = 12\ny = 0\nz = 5\nvx = 30\nvy = 140\nvz = 20\n'
        'lookback = 0.9\n[stripping]\nkind = "mlcs"\nparticles = 200\n'
    )
    path = folder / "run.toml"
    path.write_text(section + rest)
    assert np.isfinite(sk.Model(sk.load(path)).stream().q).all()
    path.write_text((section + rest).replace("lookback = 0.9", "lookback = 2"))
    with pytest.raises(sk.SpecError, match="is known from -1 to 0 Gyr"):
        sk.load(path)
    again = CliRunner().invoke(main, ["import-host", *words, "-o", str(table)])
    assert again.exit_code != 0
    assert "the file exists; add --force to replace it" in again.output
