"""Live progenitors that cannot be: one sentence with the run file's path, status 2, no traceback."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import refused

LIVE = """version = 1
seed = 1

[potential]
kind = "tf"
v0 = "215 km/s"
rs = "12 kpc"
alpha = 0.45

[progenitor]
{progenitor}
x = 25
y = 0
z = 0
vx = 0
vy = 120
vz = 100
lookback = 1

[stripping]
kind = "{kind}"
{stripping}
"""
PLUMMER = 'kind = "plummer"\nmass = "6e8 Msun"\nradius = "{radius}"'
HOT = '''
from streamkit import LiveStripping, Population, Remnant, hookimpl
from streamkit.builtin.stripping.restricted_nbody import RestrictedNbody

class Hot(LiveStripping):
    """Particles at twice their speeds."""

    kind = "hot"

    def populate(self, core, satellite, points):
        cold = super().populate(core, satellite, points)
        return Population(cold.q, core[3:6, None] + 3 * (cold.v - core[3:6, None]), cold.mass, cold.weight)

    def update_remnant(self, edge, satellite, previous):
        return RestrictedNbody(particles=100).update_remnant(edge, satellite, previous)

@hookimpl
def streamkit_components():
    return [Hot]
'''


@pytest.mark.parametrize(
    ("progenitor", "stripping", "words"),
    [
        ('kind = "nfw"\nmass = 1e9\nrs = 1', "", ["nfw", "an infinite mass", "nfw_truncated"]),
        ('kind = "miyamoto_nagai"\nmass = 1e9\na = 1\nb = 0.2', "", ["is no sphere", "plummer, hernquist"]),
        (
            'kind = "hernquist"\nmass = 1e9\na = 1',
            'stars = "plummer"\nstars_radius = 0.5',
            ["the stars have no isotropic equilibrium", "a core in a cusp"],
        ),
        (PLUMMER.format(radius="12 kpc"), "", ["larger than its tidal radius at the look-back time"]),
        (PLUMMER.format(radius="0.2 pc"), "", ["more than 20000 time steps", "too dense"]),
        (PLUMMER.format(radius="0.8 kpc"), "particles = 10", ["stripping.particles", "10", "50"]),
        (PLUMMER.format(radius="0.8 kpc"), "passages = 9", ["fewer pericentre passages than stripping.passages"]),
    ],
)
def test_what_cannot_be_is_a_sentence(tmp_path: Path, progenitor: str, stripping: str, words: list[str]) -> None:
    file = tmp_path / "live.toml"
    if "particles" not in stripping:
        stripping += "\nparticles = 200"
    file.write_text(LIVE.format(progenitor=progenitor, kind="restricted_nbody", stripping=stripping))
    message = refused("stream", file)
    for word in [file.name, *words]:
        assert word in message
    assert list(tmp_path.iterdir()) == [file]


def test_particles_faster_than_their_escape_speed_are_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "hot.py").write_text(HOT)
    file = tmp_path / "live.toml"
    text = LIVE.format(progenitor=PLUMMER.format(radius="0.8 kpc"), kind="hot", stripping="particles = 200")
    file.write_text('plugins = ["./hot.py"]\n' + text)
    message = refused("stream", file)
    assert "less than half of the progenitor plummer is bound at the look-back time" in message
    assert "faster than its escape speed" in " ".join(message.split())


def test_a_progenitor_that_dissolves_at_once_is_a_sentence(tmp_path: Path) -> None:
    """Half its mass is just inside its tidal radius when it falls through its pericentre."""
    file = tmp_path / "live.toml"
    text = LIVE.format(progenitor=PLUMMER.format(radius="1 kpc"), kind="restricted_nbody", stripping="particles = 200")
    file.write_text(text.replace("x = 25", "x = 12").replace("vy = 120\nvz = 100", "vy = 40\nvz = 50"))
    message = " ".join(refused("stream", file).split())
    assert file.name in message
    assert "dissolves at once: within 10 of its dynamical times" in message
