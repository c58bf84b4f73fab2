"""A live progenitor in words."""

from __future__ import annotations

from streamkit.components import LiveStripping


def describe_live(scheme: LiveStripping) -> str:
    """Say to which time the mass and the radius belong, and which numbers of passages are tried."""
    begins = "a live progenitor: its mass and radius are those at"
    if scheme.passages is None:
        return f"{begins} the look-back time, whatever number of pericentre passages that holds"
    return (
        f"{begins} the apocentre before {scheme.passages} pericentre passages; no other number of passages is tried: "
        "each is a fit of its own"
    )
