"""The packages of components and commands that are known, for those who ask for one that is not installed."""

from __future__ import annotations

from collections.abc import Mapping

# Package -> role, or ``command`` -> names.
KNOWN: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "streamkit-spray": {"stripping": ("fardal15", "fardal15_gala", "chen25")},
    "streamkit-nautilus": {"sampler": ("nautilus",)},
    "streamkit-dynesty": {"sampler": ("dynesty",)},
    "streamkit-nbody": {"command": ("nbody",)},
    "streamkit-gala": {"potential": ("gala",)},
    "streamkit-galpy": {"potential": ("galpy",)},
    "streamkit-agama": {"potential": ("agama",)},
}


def where_to_find(role: str, name: str) -> str:
    """Return a sentence with the package that has a component or command, empty if none is known to."""
    for package, offers in KNOWN.items():
        if name in offers.get(role, ()):
            return (
                f" {name!r} is in {package}: pip install {package} (in a clone of streamkit: "
                f"pip install plugins/{package})."
            )
    return ""
