"""The disk cache of machine code: keyed by content, and run only if it is unchanged."""

import ctypes
import importlib.util
import os
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba import njit
from numba.core import registry
from numba.core.caching import NullCache
from numba.extending import overload

import streamkit as sk
from streamkit.builtin.potentials import closed_forms as potentials
from streamkit.engine import cache
from streamkit.engine.cache import content_digest
from streamkit.engine.kernels import compiled_kernel
from streamkit.engine.loops import ROW
from streamkit.testing.contained import in_a_process

CONSTANT = """
from numba import njit
from numba.core import registry
from numba.core.caching import NullCache
from pydantic import Field
from streamkit import G, Mass, Potential

SCALE = {scale}

@njit
def helper(r2):
    return SCALE * G / r2

class Point(Potential):
    \"\"\"A point of adjustable strength.\"\"\"

    kind = "point"
    mass: Mass = Field(default=1e11, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        \"\"\"Return the acceleration.\"\"\"
        r2 = x * x + y * y + z * z
        k = -{inline} * helper(r2) * mass / r2**0.5
        return k * x, k * y, k * z
"""


def probe(folder):
    """Digest, acceleration along x, and whether the machine code came from the disk, in a process of its own."""

    def compile_and_call():
        sys.path.insert(0, str(folder))
        sys.dont_write_bytecode = True  # the module is written twice within the second that its bytecode is dated to
        numba.config.CACHE_DIR = str(folder / "cache")
        point = importlib.import_module("point").Point
        kernel = compiled_kernel(point, (0,))
        q, a = np.zeros(3 * ROW), np.full(3 * ROW, np.nan)  # a is replaced
        q[0], q[ROW] = 3.0, 4.0
        arrays = [np.zeros(1), np.array([1e11]), np.zeros(3), q, a]
        kernel.ctypes(1, *(a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in arrays), 1)
        return [content_digest(point.acceleration, (0,)), arrays[4][0].hex(), str(kernel.cache_hits)]

    digest, value, hits = in_a_process(compile_and_call)
    return digest, float.fromhex(value), int(hits)


def test_kernels_are_cached_by_content(tmp_path):
    """The same text gives the same machine code from the disk; a changed constant elsewhere does not."""
    file = tmp_path / "point.py"
    expected = -sk.G * 1e11 * 3.0 / 125.0
    file.write_text(CONSTANT.format(scale=1.0, inline=1.0))
    digest, value, hits = probe(tmp_path)
    assert value == pytest.approx(expected, rel=1e-12)
    assert hits == 0
    assert probe(tmp_path) == (digest, value, 1)
    file.write_text(CONSTANT.format(scale=2.0, inline=1.0))
    other, value, hits = probe(tmp_path)
    assert value == pytest.approx(2 * expected, rel=1e-12)
    assert hits == 0
    assert other != digest


def module_of(file, text):
    """Import a file with this text."""
    file.parent.mkdir(exist_ok=True)
    file.write_text(text)
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def digest_of(file, text):
    """Digest of the class Point in a file with this text."""
    return content_digest(module_of(file, text).Point.acceleration, 1)


def test_the_digest_follows_the_content_and_not_the_place(tmp_path):
    text = CONSTANT.format(scale=1.0, inline=1.0)
    (tmp_path / "elsewhere").mkdir()
    places = (tmp_path / "one.py", text), (tmp_path / "elsewhere" / "one.py", "\n\n# moved\n" + text)
    same = {digest_of(*place) for place in places}
    assert len(same) == 1
    changes = (
        CONSTANT.format(scale=2.0, inline=1.0),
        CONSTANT.format(scale=1.0, inline=2.0),
        text.replace("r2**0.5", "r2**0.75"),
        text.replace("x * x + y * y", "x * x - y * y"),
        text.replace("helper(r2)", "helper(mass)"),
    )
    others = {digest_of(tmp_path / f"change{i}.py", change) for i, change in enumerate(changes)}
    assert len(others) == len(changes)
    assert None not in others
    assert not same & others


def place_of(function, folder, monkeypatch):
    """Return where a function's machine code is kept, None for nowhere, if numba is to use a folder."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder))
    cache._reason_not_to_trust.cache_clear()
    cache._refused_folders.cache_clear()
    result = cache.disk_cache(function, "digest")
    return None if isinstance(result, NullCache) else result.cache_path


@pytest.mark.parametrize("outer", [True, False])
@pytest.mark.parametrize(
    ("mode", "owner", "group", "used"),
    [
        (0o755, 0, 7, True),
        (0o700, 5, 5, True),
        (0o755, 8, 5, False),
        (0o777, 5, 5, False),
        (0o757, 5, 5, False),
        (0o775, 5, 5, True),
        (0o775, 5, 7, False),
    ],
)
def test_a_cache_that_others_may_write_is_not_used(tmp_path, monkeypatch, caplog, mode, owner, group, used, outer):
    """The user has the number 5, and a group 5 of his own; user 8 and group 7 are others."""
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o755)
    inner = Path(place_of(content_digest, folder, monkeypatch))
    stat = os.stat

    def pretended(self, **options):
        fields = list(stat(self, **options))
        if self == (folder if outer else inner):
            fields[0], fields[4:6] = (fields[0] & ~0o777) | mode, (owner, group)
        elif self in (folder, inner):
            fields[0], fields[4] = fields[0] & ~0o022, 5
        return os.stat_result(fields)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "stat", pretended)
        patch.setattr(os, "getuid", lambda: 5)
        patch.setattr(os, "getgid", lambda: 5)
        place = place_of(content_digest, folder, monkeypatch)
        assert place_of(content_digest, folder, monkeypatch) == place
        cache.disk_cache(content_digest, "again")
    assert place == (str(inner) if used else None)
    result = [record.getMessage() for record in caplog.records]
    assert len(result) == (0 if used else 2)  # once in every process, and place_of forgets
    assert all("set NUMBA_CACHE_DIR to a folder of your own" in text and str(folder) in text for text in result)


def test_no_place_for_a_cache_and_a_damaged_one_cost_a_compilation_only(tmp_path, monkeypatch):
    def nowhere(*_args):
        raise RuntimeError("no locator available")

    inner = Path(place_of(content_digest, tmp_path, monkeypatch))
    result = cache.disk_cache(content_digest, "digest")
    Path(result._cache_file._index_path).write_bytes(b"\x80\x04damaged")
    assert inner.is_dir()
    assert result.load_overload(numba.void(), registry.cpu_target.target_context) is None
    monkeypatch.setattr(cache, "ContentCache", nowhere)
    assert place_of(content_digest, tmp_path, monkeypatch) is None


def stored_function(scale):
    """Return a function that multiplies by ``scale``, with its cache: numba takes both for one function."""

    @njit(**cache.OPTIONS)
    def times(x):
        return scale * x

    times._cache = cache.disk_cache(times.py_func, f"digest of {scale}")
    return times


SIGNATURE = numba.float64(numba.float64)


def stored(times):
    """Return the machine code that the disk has for a function, None for none."""
    return times._cache.load_overload(SIGNATURE, registry.cpu_target.target_context)


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_one_changed_bit_of_stored_machine_code_costs_a_compilation_only(tmp_path, monkeypatch, ending):
    """Of 32 such bits, 18 killed the process and one changed the force. No changed file may be run at all."""
    place_of(content_digest, tmp_path, monkeypatch)
    stored_function(3.0).compile(SIGNATURE)
    (file,) = tmp_path.rglob(f"*.{ending}")
    content = file.read_bytes()
    bits = np.random.default_rng(1).integers(8 * len(content), size=200)
    for bit in (*range(64), *map(int, bits)):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        file.write_bytes(changed)
        assert stored(stored_function(3.0)) is None
    for part in (b"", content[:20], content[:-1]):
        file.write_bytes(part)
        assert stored(stored_function(3.0)) is None
    again = stored_function(3.0)
    again.compile(SIGNATURE)
    assert again(2.0) == 6.0
    assert stored(stored_function(3.0)) is not None


def test_machine_code_of_another_kernel_under_a_kernels_name_is_not_run(tmp_path, monkeypatch):
    """Two processes that save at the same time may choose the same name for their files."""
    place_of(content_digest, tmp_path, monkeypatch)
    for scale in (3.0, 5.0):
        stored_function(scale).compile(SIGNATURE)
    one, other = sorted(tmp_path.rglob("*.nbc"))
    assert stored(stored_function(3.0)) is not None
    other.replace(one)
    assert stored(stored_function(3.0)) is None


def test_what_cannot_be_described_is_not_cached():
    table = [1.0, 2.0]
    assert content_digest(lambda x: table[0] * x, 0) is None


HELPERS = """
from numba import njit
from numba.core import registry
from numba.core.caching import NullCache
import numpy as np

POWER = (1, (2, 3))

def made(scale):
    @njit
    def inner(x):
        return scale * x
    return inner

scaled = made(2.0)
other = made(3.0)

@njit(fastmath={"contract"})
def helper(x, shift=1.0, *, factor=2.0):
    try:
        return factor * scaled(x) + shift + POWER[0]
    except Exception:
        return np.sqrt(x)

def acceleration(x, y, z, t, *, offset=0.0):
    return helper(x) + scaled(y) + other(z) + offset
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("shift=1.0", "shift=1.5"),
        ("factor=2.0", "factor=2.5"),
        ("shift=1.0", "shift=1"),
        ("offset=0.0", "offset=0.5"),
        ("shift=1.0, *, factor", "shift=1.0, factor"),
        ("made(2.0)", "made(2.5)"),
        ("scaled(y) + other(z)", "scaled(y) + scaled(z)"),
        ("made(3.0)", "scaled"),
        ("(1, (2, 3))", "((1, 2), 3)"),
        ('{"contract"}', '{"contract", "arcp"}'),
        ('{"contract"}', "True"),
        ('fastmath={"contract"}', "boundscheck=True"),
        ('fastmath={"contract"}', 'error_model="numpy"'),
        ('fastmath={"contract"}', 'inline="always"'),
        ("    @njit\n", '    @njit("float64(float32)")\n'),
        ("except Exception", "except"),
        ("np.sqrt(x)", "np.cbrt(x)"),
    ],
)
def test_the_digest_sees_all_that_changes_the_machine_code(tmp_path, old, new):
    assert old in HELPERS
    texts = HELPERS, HELPERS, HELPERS.replace(old, new)
    modules = [module_of(tmp_path / str(i) / "helpers.py", text) for i, text in enumerate(texts)]
    before, again, changed = (content_digest(module.acceleration, 1) for module in modules)
    assert before == again
    assert None not in {before, changed}
    assert changed != before


@pytest.mark.parametrize(
    ("definition", "used"),
    [
        ("from enum import Enum\nclass Scale(Enum):\n    A = 2.0", "Scale.A.value * x"),
        ("from numba import float64", "float64(x)"),
        ("from numba.extending import register_jitable\n@register_jitable\ndef h(x):\n    return x", "h(x)"),
        ("from numba import njit\n@njit(inline=lambda *a: True)\ndef h(x):\n    return x", "h(x)"),
        ("from numba import vectorize\n@vectorize\ndef h(x):\n    return x", "h(x)"),
        ("from scipy.special import erf", "erf(x)"),
        ("def outer():\n    def f(x):\n        return later(x)\n    return f\n    later = 1", None),
    ],
)
def test_what_has_no_sure_description_is_not_cached(tmp_path, definition, used):
    function = "acceleration = outer()" if used is None else f"def acceleration(x):\n    return {used}"
    module = module_of(tmp_path / "unsure.py", f"{definition}\n{function}\n")
    assert content_digest(module.acceleration, 1) is None


def test_what_an_overload_replaces_is_not_cached():
    """In a process of its own: an overload cannot be taken back."""

    def acceleration(x, y, z, t):
        return np.sinc(x), y, z

    def plain(x, y, z, t):
        return np.sqrt(x), y, z

    def replace():
        before = content_digest(acceleration, 0)
        overload(np.sinc)(lambda x: lambda x: 2.0 * x)
        return [before, content_digest(acceleration, 0), content_digest(plain, 0)]

    before, after, other = in_a_process(replace)
    assert before is not None
    assert after is None
    assert other is not None


def test_every_built_in_potential_is_cached():
    for cls in vars(potentials).values():
        if isinstance(cls, type) and issubclass(cls, sk.Potential) and cls not in (sk.Potential, sk.Spherical):
            written = getattr(cls, "pull", cls.acceleration)
            assert content_digest(written, len(cls.parameters())) is not None, cls
