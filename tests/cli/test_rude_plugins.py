"""Forces in Python that do to the process what no component may: the command says so, and its exit status is 2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import call, refused
from runfiles import RUN

from streamkit.sample.calls import workers

PLUGIN = '''
import sys, time
import numpy as np
from streamkit import Length, Potential, Speed, hookimpl

{at_import}

class Mute(Exception):
    """It cannot say anything."""
    def __str__(self):
        raise ValueError

class Rude(Potential):
    """A logarithmic potential."""
    kind = "rude"
    compiled = False
    v0: Speed
    rs: Length

    @staticmethod
    def acceleration(x, y, z, t, v0, rs):
        {in_a_call}
        k = -v0 * v0 / (x * x + y * y + z * z + rs * rs)
        return k * x, k * y, k * z

@hookimpl
def streamkit_components():
    return [Rude]
'''


def run_file(folder: Path, in_a_call: str = "pass", at_import: str = "") -> Path:
    (folder / "rude.py").write_text(PLUGIN.format(in_a_call=in_a_call, at_import=at_import))
    text = RUN.replace('"tf"', '"rude"').replace("alpha = 0.45\n", "").replace("3.77 Gyr", "0.5 Gyr")
    text = text.replace("particles = 400", "particles = 20")
    end = '\n[data.mass]\nkind = "enclosed_mass"\nradius = "50 kpc"\nmass = ["5e11 Msun", "1e11 Msun"]\n'
    host_only = text.split("[observable]")[0] + end + "[sampler]\nwalkers = 4\nsteps = 2\n"
    (folder / "run.toml").write_text(f'plugins = ["rude.py"]\n{host_only}')
    return folder / "run.toml"


@pytest.mark.parametrize("code", ["sys.exit(0)", "sys.exit()", "raise SystemExit"])
def test_sys_exit_in_a_force_is_an_error(tmp_path: Path, code: str) -> None:
    message = refused("check", run_file(tmp_path, code), "--draws", "0", "-q")
    assert "potential rude" in message
    assert "SystemExit" in message


def test_an_exception_that_cannot_say_what_it_is(tmp_path: Path) -> None:
    message = refused("check", run_file(tmp_path, "raise Mute"), "--draws", "0", "-q")
    assert "potential rude raised Mute: its message cannot be shown" in message


@pytest.mark.parametrize("place", ["at_import", "in_a_call"])
def test_numpy_settings_of_a_plugin_end_with_it(tmp_path: Path, place: str) -> None:
    before = np.geterr()
    assert "raise" not in before.values()
    result = call("check", run_file(tmp_path, **{place: 'np.seterr(all="raise")'}), "--draws", "0", "-q")
    assert result.exit_code == 0, result.output
    assert np.geterr() == before


def test_a_force_that_never_returns_ends_a_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "COMPILING", 1.0)
    path = run_file(tmp_path, "time.sleep(1000)")
    message = refused("check", path, "--draws", "0", "-q", "--set", "sampler.call_limit=1")
    assert "the first call took longer than sampler.call_limit = 1 s" in message
