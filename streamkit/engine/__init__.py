"""The compiled part: what an integrator author may use beside the names of `streamkit`."""

from streamkit.engine.field import (
    LEAPFROG,
    PEFRL,
    RKN4,
    RKN6,
    Field,
    Splitting,
    adaptive_step,
    build_field,
    split_step,
)

__all__ = [
    "LEAPFROG",
    "PEFRL",
    "RKN4",
    "RKN6",
    "Field",
    "Splitting",
    "adaptive_step",
    "build_field",
    "split_step",
]
