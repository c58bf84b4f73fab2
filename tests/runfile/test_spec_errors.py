"""Bad run files: a sentence per error, with path, what was found, what is allowed, the nearest name."""

import datetime as dt
import math
import re
from pathlib import Path
from typing import Any

import pytest
from runfiles import changed, error_of

import streamkit as sk


@pytest.mark.parametrize(
    ("source", "parts"),
    [
        ({}, ["run file is empty"]),
        (changed("version", 2), ["of version 2, this streamkit reads 1: upgrade"]),
        (changed("version", "1"), ["version: found '1', expected 1"]),
        (changed("seed", -1), ["seed: found -1", "whole number"]),
        (changed("seed", True), ["seed: found True"]),
        (changed("potenial", {}), ["potenial: ", "Did you mean 'potential'?", "sampler"]),
        (changed("potential", 3), ["potential: found 3, expected a section, [potential]"]),
        (changed("plugins", "a.py"), ["plugins: found 'a.py', expected a list"]),
        (changed("plugins", ["a.py", "b/a.py"]), ["plugins: found two files called 'a.py', expected one"]),
        (changed("plugins", ["nowhere.py"]), ["plugins: cannot read", "nowhere.py"]),
        (changed("plugins", ["9" * 300]), ["plugins: cannot read", "File name too long"]),
        (changed("potential", ...), ["the section [potential] is missing"]),
        (changed("potential", {}), ["potential: 'kind' is missing", "tf"]),
        (changed("progenitor", ...), ["the section [progenitor] is missing"]),
        (changed("stripping", ...), ["the section [stripping] is missing"]),
        (changed("stripping", "kind", "mlsc"), ["stripping.kind", "'mlsc'", "Did you mean 'mlcs'?"]),
        (changed("potential", "kind", ["tf"]), ["potential.kind", "['tf']"]),
        (changed("potential", "rs", "3 s"), ["potential.rs", "kpc", "'3 s'"]),
        (changed("potential", "rs", -1), ["potential.rs: found -1 kpc, should be greater than 0"]),
        (changed("potential", "rs", True), ["potential.rs", "True"]),
        (changed("potential", "rs", dt.date(2014, 1, 1)), ["potential.rs", "expected a number in kpc"]),
        (changed("potential", "rs", [1, 2]), ["potential.rs", "expected one number"]),
        (changed("potential", "rs", 1e308), ["potential.rs: expected 0 or a number between 1e-60 and 1e+60 in size"]),
        (changed("potential", "rs", "1e-320 kpc"), ["potential.rs", "expected 0 or a number between 1e-60 and 1e+60"]),
        (changed("potential", "rs", "8 1e308kpc"), ["potential.rs: found inf kpc, should be a finite number"]),
        (changed("potential", "rs", {"log_uniform": [1e-300, 1e300]}), ["potential.rs", "in size, found 1e-300"]),
        (changed("progenitor", "lookback", {"normal": [0, 1e308]}), ["progenitor.lookback", "in size, found 1e+308"]),
        (changed("progenitor", "lookback", 1e9), ["progenitor.lookback", "should be less than or equal to 100"]),
        (changed("potential", "rs", math.nan), ["potential.rs", "finite"]),
        (changed("potential", "rs", ...), ["potential.rs: missing", "turns over", "kpc"]),
        (changed("potential", "r_s", 3), ["potential.r_s", "Did you mean 'rs'?", "v0, rs, alpha"]),
        (changed("potential", "alpha", 2), ["potential.alpha: found 2, should be less than or equal to 1"]),
        (changed("potential", "disc", {"kind": "nfw"}), ["potential: found a kind of its own and", "disc"]),
        (changed("potential", {"halo": {"v0": 1}}), ["potential.halo: 'kind' is missing"]),
        (changed("potential", {"halo": {"kind": "nfw", "mass": 1, "rs": 1}, "v0": 3}), ["potential.v0"]),
        (changed("potential", {"a.b": {"kind": "nfw", "mass": 1, "rs": 1}}), ["may not contain a dot"]),
        (changed("potential", "v0", {"uniform": [400, 40]}), ["potential.v0", "below", "found 400 and 40"]),
        (changed("potential", "v0", {"unifrom": [40, 400]}), ["potential.v0", "Did you mean 'uniform'?"]),
        (changed("potential", "v0", {"normal": [40, 0]}), ["potential.v0", "sd > 0"]),
        (changed("potential", "v0", {"normal": [-40, 1]}), ["potential.v0", "greater than 0"]),
        (changed("potential", "alpha", {"uniform": [0, 1.5]}), ["potential.alpha", "than or equal to 1"]),
        (changed("progenitor", "mass", {"uniform": [-1e8, 1e9]}), ["progenitor.mass", "greater than 0"]),
        (changed("progenitor", "mass", {"truncated_normal": [1, 9, -2, math.inf]}), ["progenitor.mass"]),
        (changed("progenitor", "kind", "tf"), ["progenitor.kind: the potential 'tf' has no field 'mass'"]),
        (changed("progenitor", "l", 3), ["progenitor: found coordinates of several", "ra, dec", "vx, vy"]),
        (changed("progenitor", "vx", ...), ["progenitor.vx: missing (Velocity along x)", "km/s"]),
        (changed("data", {"x": {"kind": "circular_velocity", "radius": 8}}), ["missing", "[value, error] in km/s"]),
        (changed("progenitor", "lookback", ...), ["progenitor.lookback: missing", "Gyr"]),
        (changed("progenitor", "lookbak", 3), ["progenitor.lookbak", "Did you mean 'lookback'?"]),
        (changed("stripping", "progenitor_gravity", "true"), ["stripping.progenitor_gravity: found 'true'"]),
        (changed("stripping", "progenitor_gravity", 1), ["expected true or false"]),
        (changed("stripping", "particles", True), ["particles: found True, expected a whole number"]),
        (changed("stripping", "particles", 10.5), ["stripping.particles: found 10.5"]),
        (changed("stripping", "particles", {"uniform": [1, 2]}), ["stripping.particles: takes no prior"]),
        (changed("stripping", "release_times", "unifrom"), ["Did you mean 'uniform'?", "'pericentre'"]),
        (changed("integrator", "kind", "rk4"), ["integrator.kind", "'rk4'", "pefrl"]),
        (changed("integrator", "kind", "mlcs"), ["no integrator is called 'mlcs'. It is a kind of stripping."]),
        (changed("potential", "kind", "bovy2014"), ["is called 'bovy2014'. It is a preset: preset = \"bovy2014\"."]),
        (changed("observable", "leading", ["47.8 kpc"]), ["observable.leading"]),
        (changed("observable", "leading", ["47.8 kpc", "1 s"]), ["observable.leading", "'1 s'"]),
        (changed("observable", "recent_debris", "epoch-aware"), ["Did you mean 'epoch_aware'?"]),
        (changed("sampler", "walkers", 7), ["sampler.walkers: found 7, expected at least 8"]),
        (changed("sampler", "walker", 70), ["sampler.walker", "Did you mean 'walkers'?"]),
        (changed("sampler", "moves", "mh"), ["sampler.moves: found 'mh'", "'surrogate', 'de' or 'stretch'"]),
        (changed("likelihood", "noise", True), ["likelihood.noise: found True"]),
        (changed("stripping", "particles", 10**20), ["stripping.particles", "less than or equal to 10000000"]),
        (changed("sun", "r0", "-8 kpc"), ["sun.r0"]),
        (changed("sun", "z", 9), ["sun: |z| must be less than r0"]),
    ],
)  # fmt: skip
def test_bad_input_says_where_what_and_what_is_allowed(source: Any, parts: list[str]) -> None:
    message = error_of(source)
    assert message.startswith("run mapping: ")
    assert "\n" not in message
    for part in parts:
        assert part in message


def test_every_error_is_told_at_once() -> None:
    document = changed("potential", "rs", "3 s")
    document["progenitor"]["radius"] = -1
    document["stripping"]["particels"] = 5
    lines = error_of(document).splitlines()
    assert [line.split(": ")[1] for line in lines] == [
        "potential.rs", "progenitor.radius", "stripping.particels"
    ]  # fmt: skip


@pytest.mark.parametrize("value", [-5, "-5 km/s"])
def test_a_field_of_several_types_is_named_as_in_the_run_file(value: Any) -> None:
    message = error_of(changed("sun", "v_circ", value))
    assert "sun.v_circ: found -5" in message
    assert "should be greater than or equal to 0, or 'host'" in message
    assert len(message.splitlines()) == 1


def test_files_that_are_none(tmp_path: Path) -> None:
    assert "cannot read the run file: No such file" in error_of(tmp_path / "none.toml")
    assert "cannot read the run file" in error_of(tmp_path)
    (tmp_path / "bad.toml").write_bytes(b"\xef\xbb\xbfseed = 1\n[potential\n")  # the mark of editors of Windows
    assert "not valid TOML" in error_of(tmp_path / "bad.toml")
    assert "line 2" in error_of(str(tmp_path / "bad.toml"))
    (tmp_path / "empty.toml").write_text("")
    assert error_of(tmp_path / "empty.toml").startswith(f"{tmp_path / 'empty.toml'}: the run file is empty")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    assert "not a text file" in error_of(tmp_path / "binary.toml")


@pytest.mark.parametrize(
    ("integrator", "lookback", "told"),
    [
        ({"kind": "leapfrog", "step": "1e-15 Gyr"}, 3.77,
         r"integrator\.step: found 1e-15, .* 3\.8e\+15 steps over the 3\.77 Gyr of progenitor\.lookback"),
        ({"kind": "pefrl", "step": "1 yr"}, {"uniform": [0, 10]},
         r"integrator\.step: found 1e-09, .* 1e\+10 steps over the 10 Gyr"),
        ({"kind": "pefrl", "step": "1 yr"}, {"normal": [3, 1]}, r"1e\+11 steps over the 100 Gyr"),
        ({"kind": "adaptive", "eta": 1e-30, "deepest": 20}, 10, r"integrator\.eta: found 1e-30, .* 2\.1e\+08 steps"),
        ({"kind": "adaptive", "eta_progenitor": 1e-30, "deepest": 20}, 10, r"integrator\.eta_progenitor: found 1e-30"),
    ],
)  # fmt: skip
def test_steps_with_which_a_stream_would_never_end_are_refused(integrator, lookback, told):
    document = changed("integrator", integrator)
    document["progenitor"]["lookback"] = lookback
    error = error_of(document)
    assert re.search(told, error), error
    assert error.endswith("expected at most 1e+07")


@pytest.mark.parametrize(
    "integrator", [{"kind": "leapfrog", "step": "1e-6 Gyr"}, {"kind": "adaptive", "eta": 0.01, "deepest": 20}]
)
def test_small_steps_are_taken(integrator):
    assert sk.load(changed("integrator", integrator)).sections.integrator.centre.kind == integrator["kind"]


@pytest.mark.parametrize(
    "text",
    [
        f"[potential]\nkind = {'[' * 900}{']' * 900}\n",
        f"[potential.{'.'.join(['a'] * 900)}]\nkind = 'nfw'\n",
        f"[sun]\nr0 = {'[' * 100}8{']' * 100}\n",
    ],
    ids=["lists", "tables", "a value"],
)
def test_deep_nesting_is_an_error_of_one_paragraph(tmp_path: Path, text: str) -> None:
    file = tmp_path / "deep.toml"
    file.write_text(text)
    with pytest.raises(sk.SpecError) as caught:
        sk.load(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert all(len(line) < 2500 for line in str(caught.value).splitlines())
