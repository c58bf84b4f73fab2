"""The command `streamkit families`: the same streams in hosts of several families, as files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from streamkit import report
from streamkit.cli.options import SAMPLER, SET, load_spec
from streamkit.cli.study import StudyOptions, conduct, study_options
from streamkit.study import families as study
from streamkit.study import grid


@click.command()
@click.option("--host", "hosts", multiple=True, required=True, metavar="FILE",
              type=click.Path(path_type=Path, exists=True, dir_okay=False),
              help="A file with another section [potential], such as a run file; nothing else of it is read. "
              "Repeatable.")  # fmt: skip
@SET
@SAMPLER
@click.option("--weights", "by", type=click.Choice(study.WEIGHTS), default=study.EVIDENCE, show_default=True,
              help="What the weights are made from: the evidence of each family, or how well it predicts each stream "
              "from all others.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Keep the finished fits in DIR, and go on with the others.")
@study_options("-families")
def families(
    run_file: Path,
    hosts: tuple[Path, ...],
    settings: tuple[str, ...],
    sampler: str | None,
    by: str,
    resume: bool,
    options: StudyOptions,
) -> None:
    """Fit the same streams in hosts of several families, and average over them.

    The run file is fitted in its own host and in that of each --host, all else being the same. Each fit is a run in
    DIR/NAME, with the name of its file, which `streamkit status`, `report` and `export` read.

    The table gives each family's evidence, its weight (the probability of the family, if all were equally probable
    before the data), its fit and its masses; then the mass and the circular velocity at each radius averaged over the
    families, and apart from it how much the choice of a family moves them. The samplers emulator, nautilus and dynesty
    give evidences; without them the weights are equal. With --weights stacking a family counts as it helps to predict
    each stream from all others: that needs two streams or more, but no evidence.
    """
    report.check_directory(options.out, study.PRODUCTS, "a comparison of families", options.force or resume)
    spec = load_spec(run_file, settings, sampler)
    names = [file.stem for file in (run_file, *hosts)]
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise click.UsageError(f"--host: two hosts are called {twice[0]!r}; fits have the names of their files")
    specs = dict(zip(names, [spec, *(study.host_of(spec, file) for file in hosts)], strict=True))

    def run(done: Callable[[], object]) -> grid.Products:
        tell = None if options.quiet else partial(click.echo, err=True)
        found = study.run_families(specs, options.out, options.workers, resume, options.force, by, done, tell)
        return study.families_products(found)

    conduct(options, len(specs), run, unit="fit")
