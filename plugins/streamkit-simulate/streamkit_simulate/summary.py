"""What the command says when all draws are made."""

from __future__ import annotations

from streamkit.report import paragraph, seconds
from streamkit_simulate.runner import Simulated

REASONS = 3  # the commonest ones are named


def describe(done: Simulated) -> str:
    """Return the time of a draw, and how many have no stream, with the reasons."""
    new = f"{done.new} draws in {seconds(done.seconds)}" if done.new else "there was nothing left to draw"
    each = f", {1e3 * done.seconds / done.new:.3g} ms each" if done.new else ""
    lost = done.reasons.total()
    if not lost:
        why = "Every draw has a stream."
    else:
        told = "; ".join(f"{reason} ({count})" for reason, count in done.reasons.most_common(REASONS))
        why = f"{lost} of {done.draws} draws ({lost / done.draws:.0%}) have no measurable stream and are NaN: {told}."
    return paragraph(f"{done.path}: {new}{each}. {why}")
