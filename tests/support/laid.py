"""Distributions that lie on the path as pip lays them."""

from pathlib import Path


def lay(folder: Path, name: str, entry_points: str = "", version: str = "1.2", metadata: str = "") -> Path:
    """Lay the metadata of a distribution into a folder; return theirs."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{metadata}")
    (info / "entry_points.txt").write_text(entry_points)
    return info
