"""What each stripping scheme is worth: streams at the true parameters beside live satellites.

    python tests/benchmarks/schemes.py [DIR ...] [--seeds N] [--particles N] [--only SCHEME ...] [--without-stored]

The live satellites of figure 5 and of mock 1 are in tests/data; others are in directories of `streamkit nbody`, such as
of the truths of examples/mocks. For each it prints what the scheme has minus what the live satellite has: the
apocentres (leading, trailing, precession) by each rule with the shift of a fitted mass that they make, the mean (rms)
difference of the leading and trailing tracks in distance and radial velocity, and the rms over time of the bound mass,
in units of the first; then the apocentres by stripping passage, and the rms over the satellites. Where the run file of
a directory has stars (`stripping.stars_radius`), the live particles are weighed by their share of stars.

A host of the right shape whose mass is off by a factor f moves the apocentres as the true host does with a progenitor
whose velocity, dispersion and rate of time are divided by sqrt f, and its mass by f. That gives d(apocentres)/d ln M,
and the mass that a fit of the three numbers would find; not beside a moving body, whose own velocity is known.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from nbody_recovery import place_of
from streamkit_nbody.plan import Options
from streamkit_nbody.runner import RUN_FILE, SNAPSHOT
from streamkit_nbody.simulation import Simulation

import streamkit as sk
from streamkit.builtin.observables.track.lines import gather, local_lines
from streamkit.builtin.stripping.restricted_nbody import RestrictedNbody, star_density
from streamkit.model import Equilibrium
from streamkit.nbody import as_stream, read_snapshot
from streamkit.study.ablation.measures import match_rate

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "support"))
from snapshots import nbody_stream, run_file  # noqa: E402  the live satellites of the tests

RULES = "literal", "epoch_aware", "turning"
ARMS = {"leading": 1, "trailing": -1}
# The apocentres of G14's first mock: only their errors are used.
ERRORS = {"leading": [54.0, 1.0], "trailing": [90.0, 1.2], "precession": [100.0, 1.3]}
# Degrees: the kernel of the mean tracks, and the grid from where on they are compared.
KERNEL, STEP, FIRST = 5.0, 2.0, 6.0
FEW = 20  # particles under a kernel below which a track is not looked at
STRETCH = 0.05  # ln of the factor in mass by which the derivative is taken


class Case(NamedTuple):
    """A live satellite, the run file at its true parameters, and the share of its mass that it has lost.

    Of one by `streamkit nbody` also (2, k) the times and the bound mass in units of the first.
    """

    name: str
    spec: sk.Spec
    live: sk.Stream
    lost: float
    mass: np.ndarray | None = None


def stored(name: str, letter: str) -> Case:
    """One of the tests' own, which has lost a third of its mass."""
    return Case(name, run_file(letter), nbody_stream(letter), 0.34)


def simulated(folder: Path) -> Case:
    """One by `streamkit nbody`, with the progenitor where its core is."""
    import h5py

    path, begun = folder / SNAPSHOT.format(1), sk.load(folder / RUN_FILE)
    with h5py.File(path) as file:
        track = file["Progenitor"]
        place = place_of(begun, track.attrs["Position"], track.attrs["Velocity"])
        t, mass = track["Times"][:], track["BoundMass"][:]
    spec, left = begun.with_values(place), mass / mass[0]
    live = as_stream(read_snapshot(path), spec.bind())
    live = replace(live, weight=stars(begun, len(live)))
    return Case(folder.name, spec, live, 1 - left[-1], np.array([t - t[-1], left]))


def stars(begun: sk.Spec, particles: int) -> np.ndarray:
    """(particles,) How many stars each live particle stands for; 1 where they are distributed as the mass is."""
    scheme = begun.bind().stripping
    if not isinstance(scheme, RestrictedNbody) or scheme.stars_radius is None:
        return np.ones(particles)
    start = Simulation.of(begun, Options(particles)).start()
    density = partial(star_density, scheme.stars, scheme.stars_radius)
    return Equilibrium(begun.bind().satellite).weigh(start.q - start.track.q, start.v - start.track.v, density)


def schemes(case: Case) -> dict[str, tuple[dict[str, object], bool]]:
    """The fields of each scheme, and whether its debris is weighed by the live satellite's rate."""
    lost = {"stripping.kind": "mlcs", "stripping.mass_loss": round(case.lost, 2)}
    return {
        "mlcs": ({"stripping.kind": "mlcs"}, False),
        "mlcs, mass loss, bursts": ({**lost, "stripping.release_times": "pericentre"}, False),
        "mlcs, mass loss, live rate": (lost, True),
        "streakline": ({"stripping.kind": "streakline"}, False),
        "fardal15": ({"stripping.kind": "fardal15"}, False),
        "chen25": ({"stripping.kind": "chen25"}, False),
        "restricted_nbody": ({"stripping.kind": "restricted_nbody"}, False),
    }


def made(case: Case, fields: dict[str, object], seeds: int, particles: int, live_rate: bool) -> list[sk.Stream]:
    """The scheme's streams."""
    found = []
    for seed in range(seeds):
        spec = case.spec.with_values({**fields, "stripping.particles": particles, "seed": seed + 1})
        stream = sk.Model(spec).stream()
        found.append(match_rate(stream, case.live) if live_rate else stream)
    return found


def apocentres(stream: sk.Stream, rule: str) -> np.ndarray:
    """(3,) Leading, trailing, precession; NaN where there is none."""
    return np.array(measured(stream, rule).mean)


def measured(stream: sk.Stream, rule: str) -> sk.Prediction:
    """What the observable says."""
    spec = sk.load(ROOT / "examples" / "mocks" / "mock_tf.toml")
    fields = {f"observable.{name}": pair for name, pair in ERRORS.items()}
    observable = spec.with_values({**fields, "observable.recent_debris": rule}).bind().observable
    assert observable is not None
    return observable.predict(stream)


def mass_slopes(case: Case, seeds: int, particles: int) -> dict[str, np.ndarray]:
    """By rule (3,) d(apocentres) / d ln M of the host at its own shape, by mLCS; NaN beside a moving body."""
    inputs, sides = case.spec.bind(), []
    if inputs.bodies:
        return {rule: np.full(3, np.nan) for rule in RULES}
    for sign in (1, -1):
        root = np.exp(0.5 * sign * STRETCH)
        fields: dict[str, object] = {
            f"progenitor.{key}": float(v / root) for key, v in zip(("vx", "vy", "vz"), inputs.v, strict=True)
        }
        fields |= {
            "progenitor.mass": inputs.mass / root**2,
            "progenitor.lookback": inputs.lookback * root,  # Gyr
            "stripping.kind": "mlcs",
            "stripping.sigma": 10.0 / root,
        }
        streams = made(case, fields, seeds, particles, False)
        sides.append({rule: np.mean([apocentres(stream, rule) for stream in streams], axis=0) for rule in RULES})
    return {rule: (sides[0][rule] - sides[1][rule]) / (2 * STRETCH) for rule in RULES}


def lines(stream: sk.Stream, arm: str, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean distance and radial velocity (2, m) of an arm at angles from the progenitor, and ln of the count there."""
    chosen = stream.arm == ARMS[arm]
    v_r = (stream.q * stream.v).sum(axis=0) / stream.r
    angle = np.abs(np.degrees(stream.winding[chosen]))
    debris = gather(angle, [stream.r[chosen], v_r[chosen]], stream.weight[chosen])
    found = local_lines(debris, at, KERNEL)
    return found.value, found.ln_count


def track_differences(case: Case, streams: list[sk.Stream]) -> dict[str, tuple[float, ...]]:
    """For each arm the mean and rms difference of distance, then of radial velocity, from 6 deg to the apocentre."""
    out = {}
    peaks = measured(case.live, "turning").details
    for arm in ARMS:
        at = np.arange(FIRST, abs(float(peaks[f"{arm}_peak"][0])) + STEP, STEP)
        theirs, count = lines(case.live, arm, at)
        ours = [lines(stream, arm, at) for stream in streams]
        good = (count > np.log(FEW)) & np.all([each[1] > np.log(FEW) for each in ours], axis=0)
        away = (np.mean([each[0] for each in ours], axis=0) - theirs)[:, good]
        mean, rms = away.mean(axis=1), np.sqrt((away**2).mean(axis=1))
        out[arm] = (mean[0], rms[0], mean[1], rms[1])
    return out


def mass_difference(case: Case, streams: list[sk.Stream]) -> str:
    """The rms over time of the bound mass minus the live one, and that of today, in units of the first."""
    if case.mass is None:
        return ""
    t, live = case.mass
    left = [each.orbit.mass_left / each.orbit.mass_left[0] for each in streams]
    away = np.mean([np.interp(t, each.orbit.t, x) for each, x in zip(streams, left, strict=True)], axis=0) - live
    return f"{np.sqrt((away**2).mean()):.3f}; {away[-1]:+.3f}"


def passages(stream: sk.Stream, peaks: dict[str, np.ndarray]) -> dict[str, list[str]]:
    """By arm, for each stripping passage, latest first: where its track turns round, and what it does at the peak.

    That is the distance and radial velocity at the angle of the arm's apocentre, and how well the radial velocity of
    the particles there tells them from those of the passage before: the share of pairs that it puts in order.
    """
    ends = [0.0, *stream.orbit.apocentres()[::-1].tolist(), -np.inf]
    found = {}
    v_r = (stream.q * stream.v).sum(axis=0) / stream.r
    for arm, sign in ARMS.items():
        where, told, before = abs(float(peaks[f"{arm}_peak"][0])), [], None
        angle = np.abs(np.degrees(stream.winding))
        for late, early in pairwise(ends):
            chosen = (stream.arm == sign) & (stream.t_strip < late) & (stream.t_strip >= early)
            near = chosen & (np.abs(angle - where) < KERNEL)
            if near.sum() < FEW:
                told.append("-")
                continue
            at = np.arange(max(where - 90.0, FIRST), where + 90.0)
            fit = local_lines(gather(angle[chosen], [stream.r[chosen], v_r[chosen]], stream.weight[chosen]), at, KERNEL)
            r = np.where(fit.ln_count > np.log(FEW), fit.value[0], -np.inf)
            k = int(np.argmax(r))
            inside = 5 < k < len(at) - 6 and np.isfinite(r[[k - 5, k + 5]]).all()
            here = int(np.argmin(np.abs(at - where)))
            text = f"{r[k]:.1f} at {at[k]:.0f}" if inside else "no turn"
            text += f"; {fit.value[0, here]:.0f} kpc, {fit.value[1, here]:+.0f} km/s"
            if before is not None:
                order = (v_r[near][:, None] > before).mean()
                text += f", {max(order, 1 - order):.2f}"
            told.append(text)
            before = v_r[near]
        found[arm] = told
    return found


def row(*cells: object) -> None:
    """Print one row of Markdown."""
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("live", type=Path, nargs="*", metavar="DIR", help="a directory of `streamkit nbody`")
    parser.add_argument("--without-stored", action="store_true", help="only the directories")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=[], metavar="SCHEME", help="such as restricted_nbody")
    parser.add_argument("--particles", type=int, default=10000)
    given = parser.parse_args()
    cases = [] if given.without_stored else [stored("figure 5", "A"), stored("mock 1", "B")]
    cases += [simulated(folder) for folder in given.live]
    errors = np.array([pair[1] for pair in ERRORS.values()])
    every: dict[tuple[str, str], list[np.ndarray]] = {}
    for case in cases:
        print(f"\n{case.name}: {case.lost:.0%} of the mass lost")
        slopes = mass_slopes(case, given.seeds, given.particles)
        live = {rule: apocentres(case.live, rule) for rule in RULES}
        row(
            "scheme",
            *(f"{rule}: kpc, kpc, deg; ln M" for rule in RULES),
            "distance L; T",
            "v_r L; T",
            "M(t)/M0: rms; end",
        )
        row("live", *(", ".join(f"{x:.1f}" for x in live[rule]) for rule in RULES), "", "", "")
        row("d / d ln M", *(", ".join(f"{x:+.0f}" for x in slopes[rule]) for rule in RULES), "", "", "")
        for label, (fields, live_rate) in schemes(case).items():
            if given.only and label not in given.only:
                continue
            streams = made(case, fields, given.seeds, given.particles, live_rate)
            cells = []
            for rule in RULES:
                away = np.mean([apocentres(stream, rule) for stream in streams], axis=0) - live[rule]
                shift = -(slopes[rule] * away / errors**2).sum() / (slopes[rule] ** 2 / errors**2).sum()
                every.setdefault((label, rule), []).append(np.append(away, 100 * shift))
                cells.append(", ".join(f"{x:+.1f}" for x in away) + f"; {shift:+.1%}")
            tracks = track_differences(case, streams)
            for first in (0, 2):
                cells.append("; ".join(f"{each[first]:+.1f} ({each[first + 1]:.1f})" for each in tracks.values()))
            row(label, *cells, mass_difference(case, streams))
        peaks = measured(case.live, "turning").details
        mlcs = made(case, {"stripping.kind": "mlcs"}, 1, 4 * given.particles, False)[0]
        for label, stream in (("live", case.live), ("mlcs", mlcs)):
            for arm, told in passages(stream, peaks).items():
                row(f"by passage, {label}, {arm}", *told)
    print("\nrms over the mocks: kpc, kpc, deg, per cent of M")
    for label in dict.fromkeys(label for label, _ in every):
        rms = [np.sqrt(np.nanmean(np.square(every[label, rule]), axis=0)) for rule in RULES]
        row(label, *(", ".join(f"{x:.1f}" for x in each) for each in rms))


if __name__ == "__main__":
    main()
