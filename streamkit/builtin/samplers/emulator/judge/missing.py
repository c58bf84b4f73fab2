"""What is missing before a posterior may be tested, or given, as sentences, and which factors are called for that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.certificate import BLURRED
from streamkit.builtin.samplers.emulator.changes import difference
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.walk.populations import Populations

# Standard deviations that a parameter, or a principal axis, may move between rounds, and the fraction by which its
# width may change; or as much as the noise of the calls may move it, where that is more and still little enough.
SETTLED = 0.1
# What the noise of the calls may move of any mean or width, in standard deviations, in nine of ten cases at most. Many
# parameters have one that is moved by chance: the standard error of each is about half of it.
UNCERTAIN = 0.15
NOISE = 0.5 * UNCERTAIN
# The part of `NOISE`, squared, that one of K factors may have without new calls is this divided by K.
SHARE = 0.5
# New points of a round for each parameter, in any case, and as a fraction of all calls so far, unless a factor of
# several is well known already; the least of several is larger by the last: sampling all of them costs more than so
# many calls of each.
ROUND, LEAST_ROUND, GROWTH, TIMES_OF_SEVERAL = 8, 80, 0.15, 2
# A factor with fewer calls left than this is called no more.
FEW = 16
# Standard deviations that the posterior may move after a factor's last calls: beyond, a polynomial extrapolates. Beyond
# `FAR` it is called at once. Else it waits until the others are learned: what moves the posterior is one of these.
LEFT, FAR = 0.5, 1.5
# A factor is called for a trend of all if its own moves the posterior by this fraction of the largest one.
MOST_OF_TREND = 0.5


def before_a_test(known: Sequence[Known], samples: Array, moved: float, uncertain: float) -> str:
    """Say what is missing before fresh calls may test the emulators; empty if nothing is.

    ``samples`` (n, d) are those of the posterior, ``moved`` and ``uncertain`` standard deviations, see `Progress`.
    """
    if not np.isfinite(moved):
        return "too few rounds"
    if fault := blurred(known):
        return fault
    if moves(moved, uncertain):
        return f"the posterior still moves by {moved:.2f} standard deviations"
    if uncertain >= UNCERTAIN:
        noisiest = max(known, key=lambda each: each.share).factor.name
        most = f", most of it that of {noisiest}, which needs more particles" if len(known) > 1 else ""
        return f"the noise of the calls may move a mean or a width by {uncertain:.2f} standard deviations{most}"
    if left := [each.factor.name for each in known if moved_away(each, samples) >= LEFT]:
        return f"the posterior has moved away from the last calls of {', '.join(left)}"
    return ""


def moves(moved: float, uncertain: float) -> bool:
    """Whether the posterior moves by more than is settled, and more than the noise of all calls may move it."""
    return moved >= max(SETTLED, min(uncertain, UNCERTAIN))


def noise_matters(known: Sequence[Known], moved: float) -> bool:
    """Whether it is asked what the noise of the calls moves: not of one factor whose posterior moves by more anyway."""
    return len(known) > 1 or moved < UNCERTAIN


def new_calls(known: Sequence[Known]) -> list[int]:
    """Return how many new calls of each factor a round makes.

    The variance that the noise of n_k calls of factor k leaves is V_k / n_k. Of several factors each gets the n_k that
    bring the sum to `NOISE` squared with the fewest calls, sqrt(V_k) sum_j sqrt(V_j) / `NOISE`^2 (Neyman 1934). None
    gets more than it has, and the others get as much less: noise is measured where the posterior is by now.
    """
    several, made = len(known) > 1, np.array([len(each.calls) for each in known])
    roots = np.sqrt([each.share / len(known) * len(each.calls) for each in known])
    scale = min(roots.sum() / NOISE**2, 2 * float(np.min(made / np.maximum(roots, 1e-300))))
    fewest = roots * scale - made if several else np.zeros(1)
    parameters = np.array([each.factor.problem.size for each in known])
    least = np.maximum(ROUND * parameters, LEAST_ROUND) * (TIMES_OF_SEVERAL if several else 1)
    more = GROWTH * made * [not (several and is_described(each)) for each in known]
    return [int(each) for each in np.maximum(np.maximum(least, more.astype(int)), fewest)]


def to_be_called(
    known: Sequence[Known], samples: Array, moved: float, uncertain: float, max_calls: int, trend: bool = False
) -> list[Known]:
    """Return the factors below their most calls that are not learned at samples (n, d) of the posterior.

    Those that the posterior has left wait until it moves no more. If all of several are learned, return none as long as
    there were too few rounds to say how far it has moved, and then those that move it; or all. Where the ``trend`` of
    all was refused, return those that make most of it; or none after a test by fresh calls alone: these have been
    learned from, and calls held out test the posterior again.
    """
    left, quiet = with_calls_left(known, max_calls), uncertain < UNCERTAIN
    away = [moved_away(each, samples) if is_learned(each, quiet) else np.inf for each in left]
    for by in (FAR, LEFT) if moves(moved, uncertain) else (LEFT,):
        if wanted := [each for each, far in zip(left, away, strict=True) if far >= by]:
            return wanted
    if len(known) > 1 and not np.isfinite(moved):  # of one stream: calls of the first rounds look for other modes
        return []
    if trend and not any(each.certificate is not None and each.certificate.held_out for each in known):
        return []
    if trend:
        return [each for each in left if each.trend >= MOST_OF_TREND * max(one.trend for one in left)]
    return [each for each in left if each.moves >= SETTLED / np.sqrt(len(known))] or left


def is_learned(each: Known, quiet: bool) -> bool:
    """Whether a factor needs no more calls where it was last called; ``quiet`` if the noise of all is small."""
    return is_described(each) and (quiet or each.share < SHARE * NOISE**2) and each.taught < SETTLED


def is_described(each: Known) -> bool:
    """Whether the emulator of a factor lacks nothing, but for the noise of its calls."""
    return (each.certificate is None or not each.certificate.faults) and each.blur < BLURRED


def with_calls_left(known: Sequence[Known], max_calls: int) -> list[Known]:
    """Return the factors that may be called again, where each may have so many calls."""
    return [each for each in known if max_calls - len(each.calls) >= FEW]


def moved_away(each: Known, samples: Array) -> float:
    """Return by how many standard deviations samples (n, d) differ from where a factor was last called.

    It is infinite before the first calls.
    The error of an emulator is measured on its calls. It says little elsewhere. Calls of an earlier run are taken to be
    there until fresh calls say otherwise. Coordinates that no prediction depends on, such as extra errors, are left
    out: a call is the same anywhere along them.
    """
    if not len(each.called_at):
        return 0.0 if len(each.factor.earlier) else np.inf
    matters = each.factor.problem.coordinates
    return difference(each.called_at[:, matters], samples[:, each.factor.columns[matters]])


def blurred(known: Sequence[Known]) -> str:
    """Say that an emulator's own error changes too much; empty if it does not."""
    worst = max(known, key=lambda each: each.blur)
    if worst.blur < BLURRED:
        return ""
    return f"the error of the emulator of {worst.factor.name} changes a mean or a width by {worst.blur:.2f} sd"


def apart(result: Populations) -> str:
    """Say that two populations do not agree; empty if they do."""
    if result.agree:
        return ""
    return (
        f"two populations of the posterior do not agree, or are too short (R-hat {result.r_hat:.3f}, {result.sweeps} "
        f"sweeps with an autocorrelation time of {result.time:.0f})"
    )
