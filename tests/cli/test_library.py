"""Libraries of known streams: `init --stream` writes what an installed one gives, or says what is missing."""

from importlib.metadata import EntryPoint

import pytest
from commands import call, refused

from streamkit import StreamkitError
from streamkit.cli import Written, library


class OneStream:
    """A library of one stream."""

    def names(self):
        return ["known"]

    def write(self, names):
        if list(names) != ["known"]:
            raise StreamkitError(f"no stream {names[0]!r} here")
        return Written("known.toml", "# a stream\n", {"known.ecsv": "phi1\n1\n"})


class Broken:
    def __init__(self):
        raise RuntimeError("no data")


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """Pretend that libraries are installed: classes of this module by the names of their entry points."""
    monkeypatch.chdir(tmp_path)

    def install(**classes):
        points = [EntryPoint(name, f"{__name__}:{cls.__name__}", library.GROUP) for name, cls in classes.items()]
        monkeypatch.setattr(library, "entry_points", lambda group: points)

    return install


def test_a_run_file_and_its_tables_are_written_side_by_side(installed, tmp_path):
    installed(mine=OneStream)
    (tmp_path / "there").mkdir()
    assert call("init", "--stream", "known", "-o", "there/mine.toml").exit_code == 0
    assert (tmp_path / "there" / "mine.toml").read_text() == "# a stream\n"
    assert (tmp_path / "there" / "known.ecsv").read_text() == "phi1\n1\n"
    (tmp_path / "there" / "mine.toml").unlink()
    assert "known.ecsv': the file exists; add --force" in refused("init", "--stream", "known", "-o", "there/mine.toml")
    assert not (tmp_path / "there" / "mine.toml").exists()


def test_a_name_that_no_library_has_is_refused_by_each(installed):
    installed(first=OneStream, second=OneStream)
    assert refused("init", "--stream", "other").count("no stream 'other' here") == 2


def test_without_a_library_its_package_is_named(installed):
    installed()
    assert "no library of streams is installed. 'galstreams' is in streamkit-galstreams: pip" in refused(
        "init", "--stream", "GD-1"
    )


def test_a_broken_library_and_one_that_is_switched_off(installed, monkeypatch):
    installed(broken=Broken)
    told = "the library of streams 'broken' cannot be loaded (RuntimeError: no data)"
    assert told in refused("init", "--stream", "known")
    monkeypatch.setenv("STREAMKIT_DISABLE_PLUGINS", "broken")
    assert "no library of streams is installed" in refused("init", "--stream", "known")


def test_examples_are_written_one_at_a_time(installed):
    assert "one example at a time; found gd1 pal5" in refused("init", "gd1", "pal5")
    assert "-o FILE: which example?" in refused("init", "-o", "mine.toml")
    assert "--own writes a template; found the example 'gd1' too" in refused("init", "--own", "gd1")
