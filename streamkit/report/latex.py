"""Names and units as LaTeX writes them, for the tables of papers."""

from __future__ import annotations

LATEX_UNITS = {
    "Msun": r"M$_\odot$", "1e11 Msun": r"$10^{11}$\,M$_\odot$", "km/s": r"km\,s$^{-1}$", "mas/yr": r"mas\,yr$^{-1}$",
}  # fmt: skip
SPECIAL = {letter: rf"\{letter}" for letter in "_%&#${}"} | {
    "<": "$<$", ">": "$>$", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
}  # fmt: skip


def latex_escaped(text: str) -> str:
    """Return a text in which the special characters of LaTeX are escaped."""
    return "".join(SPECIAL.get(letter, letter) for letter in text)
