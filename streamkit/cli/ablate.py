"""The command `streamkit ablate`: variants of a run file beside each other and an N-body snapshot, as files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from streamkit import report, runfile
from streamkit.cli.completion import settings as complete_settings
from streamkit.cli.options import SEEDS, SET, load_spec
from streamkit.cli.study import StudyOptions, conduct, study_options
from streamkit.study import ablation as study
from streamkit.study import grid


@click.command()
@click.option("--vary", "variations", multiple=True, required=True, metavar="PATH=V1,V2,...",
              shell_complete=complete_settings,
              help="A field and its values, such as stripping.kind=mlcs,streakline. "
              "Several --vary: every combination of their values.")  # fmt: skip
@SET
@click.option("--stream", metavar="NAME", help="The stream to compare, if the run file has several.")
@click.option("--reference", metavar="SNAPSHOT|KIND",
              help="N-body snapshot to compare with: HDF5 in the Gadget layout (FILE.hdf5, or "
              "FILE.hdf5:PartType2) or a plain table (FILE.npz); or a live progenitor by its kind, such as "
              "restricted_nbody. Default: the first variant.")  # fmt: skip
@click.option("--match-rate", is_flag=True,
              help="Weigh the particles so that the stripping rate is the snapshot's: this compares where a scheme "
              "puts the debris, whatever its rate.")  # fmt: skip
@SEEDS
@study_options("-ablation")
def ablate(
    run_file: Path,
    variations: tuple[str, ...],
    settings: tuple[str, ...],
    stream: str | None,
    reference: str | None,
    match_rate: bool,
    seeds: int,
    options: StudyOptions,
) -> None:
    """Compare variants of a model with each other and with an N-body snapshot.

    Every combination of the values is run on the same seeds. Free parameters are at the prior's centre unless --set or
    --vary gives them a value. The tables, printed and written to DIR, hold for every variant the length of each tail,
    the distance of its mean track from the reference's, widths, density, observables, energies and angular momenta.
    The pictures are written to DIR.

    A kind other than the run file's starts from its own defaults. Fields that only the run file's kind has (sigma of
    mlcs) are not passed on; fields that all kinds have (particles, progenitor_gravity) are. A value of --vary holds
    for every kind in the grid.

    A variant without a stream is listed with the reason, and the other variants are finished. Ctrl-C ends the command;
    the finished streams are written.
    """
    if match_rate and reference is None:
        raise click.UsageError("--match-rate needs a --reference, whose stripping rate is taken")
    report.check_directory(options.out, study.PRODUCTS, "an ablation", options.force)
    spec = load_spec(run_file, settings)
    variants = study.variants_of(spec, read_variations(variations))
    name = spec.stream_name(stream)
    beside = None if reference is None else study.read_reference(reference, spec, name)

    def run(done: Callable[[], object]) -> grid.Products:
        ablation = study.run_ablation(
            spec, variants, beside, stream=name, seeds=seeds, workers=options.workers, match=match_rate, done=done
        )
        header = {"reference": reference or ablation.beside, "match_rate": match_rate, "seeds": seeds}
        header |= {"stream": name} if len(spec.streams) > 1 else {}
        return study.ablation_products(ablation, header)

    conduct(options, seeds * len(variants), run)


def read_variations(variations: Sequence[str]) -> dict[str, list[Any]]:
    """Turn ``PATH=V1,V2,...`` arguments into fields and their values, read as a run file reads them.

    A comma inside quotes, brackets or braces does not separate values.
    """
    fields: dict[str, list[Any]] = {}
    for variation in variations:
        path, equals, text = (part.strip() for part in variation.partition("="))
        values = [runfile.literal(value.strip()) for value in _split(text)]
        if not (equals and path) or any(value == "" for value in values):
            raise click.UsageError(
                f"--vary {variation!r}: expected PATH=V1,V2,..., such as stripping.kind=mlcs,streakline"
            )
        if twice := next((value for i, value in enumerate(values) if value in values[:i]), None):
            raise click.UsageError(f"--vary {path}: the value {twice!r} is given twice")
        if path in fields:
            raise click.UsageError(f"--vary {path}: given twice; give all its values at once")
        fields[path] = values
    return fields


def _split(text: str) -> list[str]:
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        depth += (letter in "[{") - (letter in "]}") if not quote else 0
        if letter == "," and not quote and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts
