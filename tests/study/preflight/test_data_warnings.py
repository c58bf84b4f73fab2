"""`check` on run files and tables with one mistake in each: the warning names it, and there is none without it."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runfiles import FIT

import streamkit as sk
from streamkit.builtin.observables.track.observable import Track
from streamkit.study.preflight import run_preflight
from streamkit.study.preflight.corrections import corrected
from streamkit.study.preflight.data_warnings import _correction, _Measured

EXAMPLES = Path(__file__).parents[3] / "examples"
GD1 = EXAMPLES / "gd1" / "gd1.toml"
TRACK = sk.load(GD1).bind().observable
PC_OF_MODULUS = 10.0  # pc at a distance modulus of zero


def example(path: Path = GD1) -> dict[str, Any]:
    """Return a run file as a dictionary, with the tables of its track as lists, and few particles."""
    run = tomllib.loads(path.read_text())
    run["stripping"]["particles"] = 1000
    observable = run["observable"]
    for name, value in observable.items():
        if isinstance(value, str) and value.endswith(".ecsv"):
            observable[name] = getattr(TRACK, name).to_dict()
    return run


def warnings_of(run: dict[str, Any], draws: int = 24) -> list[str]:
    return list(run_preflight(sk.load(run), draws=draws).warnings)


def scaled(field: str, column: str, factor: float) -> Callable[[dict[str, Any]], None]:
    def change(run: dict[str, Any]) -> None:
        table = run["observable"][field]
        for name in (column, "error") if abs(factor) != 1 else (column,):
            table[name] = [factor * value for value in table[name]]

    return change


def slow(*arguments: Any) -> Any:
    """Return a case of the slow tests: each makes the streams of 24 draws."""
    return pytest.param(*arguments, marks=pytest.mark.slow)


def exchanged_motions(run: dict[str, Any]) -> None:
    first, second = (run["observable"][name] for name in ("pm_phi1_cosphi2", "pm_phi2"))
    first["pm_phi1_cosphi2"], second["pm_phi2"] = second["pm_phi2"], first["pm_phi1_cosphi2"]


def exchanged_angles(run: dict[str, Any]) -> None:
    table = run["observable"]["phi2"]
    table["phi1"], table["phi2"] = table["phi2"], table["phi1"]


def moduli_as_distances(run: dict[str, Any]) -> None:
    table = run["observable"]["distance"]
    modulus = 5 * np.log10(1000 * np.array(table["distance"]) / PC_OF_MODULUS)
    table["distance"] = [float(f"{value:.3f}") for value in modulus]
    table["error"] = [0.1] * len(modulus)


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (scaled("distance", "distance", 1000.0), ("observable.distance", "distance divided by 1000, as numbers in pc")),
        slow(scaled("radial_velocity", "radial_velocity", 1000.0), ("radial_velocity divided by 1000, as",)),
        slow(scaled("pm_phi1_cosphi2", "pm_phi1_cosphi2", -1.0), ("opposite sign of pm_phi1_cosphi2",)),
        slow(scaled("pm_phi1_cosphi2", "pm_phi1_cosphi2", 1e-3), ("pm_phi1_cosphi2 multiplied by 1000, as",)),
        slow(exchanged_motions, ("the columns pm_phi1_cosphi2 and pm_phi2 exchanged",)),
        slow(exchanged_angles, ("observable.phi2", "the columns phi1 and phi2 exchanged")),
    ],
)
def test_a_mistake_in_a_table_is_named(mistake: Callable[[dict[str, Any]], None], words: tuple[str, ...]) -> None:
    run = example()
    mistake(run)
    warnings = [text for text in warnings_of(run) if "trial streams comes near" in text]
    assert warnings
    assert any(all(word in text for word in words) for text in warnings), warnings


def test_a_wrong_unit_of_a_column_is_no_unit_of_the_numbers() -> None:
    """Distances in kpc in a column that says pc come as 1000 times too small: their numbers are not in Mpc."""
    run = example()
    scaled("distance", "distance", 1e-3)(run)
    text = next(text for text in warnings_of(run) if "observable.distance" in text)
    assert "distance multiplied by 1000, as numbers in Mpc or below a wrong unit," in text


def test_no_longitude_along_a_stream_is_said_to_be_in_hours() -> None:
    run = example()
    for name in ("phi2", "distance", "pm_phi1_cosphi2", "pm_phi2", "radial_velocity"):
        table = run["observable"][name]
        table["phi1"] = [angle / 15 for angle in table["phi1"]]
    texts = [text for text, _ in corrected(sk.load(run).bind().observable)]
    assert any("rad" in text for text in texts)
    assert not any("hours" in text for text in texts)


def test_larger_errors_alone_are_no_correction() -> None:
    """A factor of 1000 makes the error of 2 +- 1 so large that any stream is near, and moves the datum farther away."""
    for value, said in ((2.0, ""), (10.0, "the opposite sign of pm_phi2")):
        table = {"phi1": [0.0], "pm_phi2": [value], "error": [1.0]}
        track = Track(frame="GD1Koposov10", kernel=5, pm_phi2=table)
        details = {"spread": np.zeros(1), "ln_coverage": np.zeros(1)}
        streams = [sk.Prediction(track.names, np.array([mean]), np.zeros(1), details=details)
                   for mean in np.linspace(-10.1, -9.9, 10)]  # fmt: skip
        trials: list[Any] = list(streams)
        measured = _Measured("observable", track, trials, streams, lambda _, trial: trial)
        assert _correction(measured, "pm_phi2") == said


def test_the_example_without_a_mistake_has_no_such_warning() -> None:
    assert warnings_of(example()) == []


@pytest.mark.slow
def test_moduli_in_the_column_of_distances_are_named() -> None:
    """GD-1 at 8 kpc has a modulus of 14.5: only a small error makes that another distance than 14.5 kpc."""
    run = example()
    moduli_as_distances(run)
    run["observable"]["distance"]["error"] = [0.05] * len(run["observable"]["distance"]["error"])
    assert any("read in mag (a distance modulus)" in text for text in warnings_of(run))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("leading", "trailing", "words"),
    [
        (["-47.8 kpc", "0.5 kpc"], ["102.5 kpc", "2.5 kpc"], "the opposite sign of leading"),
        ([47800.0, 500.0], ["102.5 kpc", "2.5 kpc"], "leading divided by 1000, as numbers in pc"),
    ],
)
def test_a_mistake_in_a_datum_is_named(leading: list[Any], trailing: list[Any], words: str) -> None:
    run = tomllib.loads((EXAMPLES / "sagittarius" / "sagittarius.toml").read_text())
    run["stripping"]["particles"] = 1000
    run["observable"] |= {"leading": leading, "trailing": trailing}
    texts = [text for text in warnings_of(run) if "trial streams comes near" in text]
    assert len(texts) == 1
    assert texts[0].startswith("observable.leading: ")
    assert words in texts[0]


def test_data_on_the_host_are_judged_too() -> None:
    run = example()
    run["data"] = {"mass": {"kind": "enclosed_mass", "radius": "20 kpc", "mass": [2.1e14, 1e12]}}
    (text,) = warnings_of(run)
    assert text.startswith("data.mass: none of ")
    assert "Check unit, sign, column names and frame of the data, and the priors." in text


def test_a_run_file_without_priors_is_judged_by_its_one_stream() -> None:
    run = example()
    spec = sk.load(run)
    for path, value in zip(spec.names, spec.centre().tolist(), strict=True):
        section: Any = run
        *folders, name = path.split(".")
        for folder in folders:
            section = section[folder]
        section[name] = value
    scaled("distance", "distance", 1000.0)(run)
    texts = warnings_of(run)
    assert any("the trial stream does not come near these data" in text and "in pc" in text for text in texts)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("radius", 30.0, ("larger than its tidal radius", "Write it with its unit, such as '30 pc'")),
        ("mass", 4.3, ("larger than its tidal radius", "4.3 Msun, a logarithm?")),
        ("mass", "2e4 kg", ("larger than its tidal radius", "Check the radius, and the exponent of the mass")),
        ("mass", 2e14, ("heavier than its host", "Check the exponent")),
        ("frame", "Pal5PriceWhelan18", ("'Pal5PriceWhelan18' and 'GD1Koposov10'", "Give both the same frame")),
    ],
)
def test_a_mistake_in_the_progenitor_is_named(field: str, value: Any, words: tuple[str, ...]) -> None:
    run = example()
    run["progenitor"][field] = value
    texts = warnings_of(run, draws=0)
    assert any(all(word in text for word in words) for text in texts), texts


def test_a_mass_in_log10_is_named_and_no_narrower_prior() -> None:
    run = example()
    run["potential"] = {"kind": "nfw", "mass": {"uniform": [11, 13]}, "rs": "16 kpc"}
    texts = warnings_of(run)
    assert any("potential.mass = 12 Msun at the prior's centre: is that a logarithm?" in text for text in texts)
    assert not any("Narrow the priors" in text for text in texts)


def test_a_frame_given_by_its_matrix_is_the_same_frame() -> None:
    run = example()
    run["progenitor"]["frame"] = np.round(sk.sky_matrix("GD1Koposov10"), 6).tolist()
    assert not any("frame" in text for text in warnings_of(run, draws=0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stripping": {"particles": 3}}, "stripping.particles = 3 is too few"),
        slow({"potential": {"v0": {"uniform": ["40 m/s", "400 m/s"]}}}, "Is a speed in m/s"),
        ({"potential": {"v0": {"uniform": [40e3, 400e3]}}}, "Is a speed in m/s"),
    ],
)
def test_rare_streams_are_not_always_the_priors_fault(change: dict[str, Any], words: str) -> None:
    run = tomllib.loads((EXAMPLES / "sagittarius" / "sagittarius.toml").read_text())
    run["stripping"]["particles"] = 1000
    for section, fields in change.items():
        run[section] |= fields
    rare = [text for text in warnings_of(run, draws=12) if text.startswith("Only 0 of 12 points")]
    assert len(rare) == 1
    assert words in rare[0]
    assert "Narrow the priors" not in rare[0]


def test_a_host_in_other_units_is_named_where_its_progenitor_is_unbound() -> None:
    run = example()
    run["potential"]["v0"] = {"uniform": ["150 m/s", "300 m/s"]}
    assert any("is unbound" in text and "Is a speed in m/s" in text for text in warnings_of(run, draws=0))


def test_the_centre_of_the_prior_alone_is_no_reason_to_doubt_the_data():
    assert warnings_of(example(), draws=0) == []


def test_a_wrong_sign_is_seen_where_a_wide_prior_hides_it() -> None:
    """Two velocities of some 27 errors, with the sign exchanged; streams of the prior reach from -500 to 800 km/s."""
    run = copy.deepcopy(FIT)
    run["progenitor"]["v_los"] = {"normal": [153, 200]}
    assert not [text for text in warnings_of(run, 8) if "opposite sign" in text]
    velocities = run["observable"]["radial_velocity"]
    velocities["radial_velocity"] = [-value for value in velocities["radial_velocity"]]
    (found,) = (text for text in warnings_of(run, 8) if "opposite sign of radial_velocity" in text)
    assert found.startswith("observable.radial_velocity: the median datum is")
