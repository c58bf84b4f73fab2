"""What the weights of families are made from. Nothing heavy is imported: the command's help names them."""

from __future__ import annotations

EVIDENCE, STACKING = WEIGHTS = ("evidence", "stacking")
