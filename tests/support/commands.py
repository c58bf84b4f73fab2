"""The command line in this process, and a small run file, for the tests of the commands."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner, Result

from streamkit.cli.main import main

RUN = """
seed = 7
[potential]
kind = "tf"
v0 = { uniform = ["190 km/s", "230 km/s"] }
rs = "12 kpc"
alpha = 0.45
[progenitor]
kind = "plummer"
mass = { log_uniform = ["3e8 Msun", "9e8 Msun"] }
radius = "0.85 kpc"
x = 19.155535
y = 0.0278852
z = -5.7149425
vx = 176.48999
vy = -0.36306170
vz = 201.58182
lookback = "3.77 Gyr"
[stripping]
kind = "mlcs"
particles = 400
[observable]
kind = "apocentres"
leading = ["57.0 kpc", "1.0 kpc"]
trailing = ["96.2 kpc", "5 kpc"]
precession = ["95.0 deg", "5 deg"]
[sampler]
walkers = 8
steps = 4
"""


def call(*args: str | Path) -> Result:
    """Run the command in this process; anything but a clean exit is a bug and comes through."""
    result = CliRunner().invoke(main, [str(arg) for arg in args], prog_name="streamkit")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def refused(*args: str | Path) -> str:
    """Run a command that must be refused, and return its one paragraph."""
    result = call(*args)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("streamkit: ")
    assert "Traceback" not in result.stderr
    assert "\n\n" not in result.stderr
    return result.stderr
