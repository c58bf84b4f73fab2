"""The command `streamkit calibrate`: a test whether the intervals of a fit contain the truth as often as stated."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import click
from click.core import ParameterSource

import streamkit as sk
from streamkit import report
from streamkit.cli.options import SET, load_spec, read_radii, read_settings, with_settings
from streamkit.cli.study import StudyOptions, conduct, study_options
from streamkit.study import calibration as study
from streamkit.study import grid


@click.command()
@SET
@click.option("--draws", default=100, show_default=True, type=click.IntRange(2), metavar="N",
              help="Number of truths that are drawn from the prior, each with a fit of its own.")  # fmt: skip
@click.option("--truth", "truth_file", type=click.Path(path_type=Path), metavar="TRUE.toml",
              help="Draw truths from the priors of this run file, and make the mock data by its model.")  # fmt: skip
@click.option("--truth-set", "truth_settings", multiple=True, metavar="PATH=VALUE",
              help="Replace a field in the model of the mock data, not in that of the fit, such as "
              "stripping.kind=streakline. Repeatable.")  # fmt: skip
@click.option("--radii", metavar="R1,R2,...", help="Radii in kpc of the enclosed masses that are compared.  "
              "[default: 50,100,200]")  # fmt: skip
@click.option("--write-mocks", "mocks", type=click.Path(path_type=Path), metavar="DIR",
              help="Fit nothing: write the mock data of each draw into DIR, for another method.")  # fmt: skip
@click.option("--samples", type=click.Path(path_type=Path), metavar="DIR",
              help="Fit nothing: take the samples of another method from the DIR of --write-mocks.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Keep the draws in DIR, and compute the missing ones.")
@study_options("-calibration")
def calibrate(
    run_file: Path,
    settings: tuple[str, ...],
    truth_file: Path | None,
    truth_settings: tuple[str, ...],
    radii: str | None,
    draws: int,
    mocks: Path | None,
    samples: Path | None,
    resume: bool,
    options: StudyOptions,
) -> None:
    """Test the whole fit on mock data whose truth is known.

    Each draw takes parameters from the prior, makes mock data of their stream with random numbers that the fit does not
    have, and fits them as the run file says. If the fit is right, the rank of the truth among the posterior samples is
    uniform (simulation-based calibration, Talts et al. 2018): the 68 % interval contains the truth in 68 of 100 draws.

    With --truth-set the mock data come from another model, such as another stripping scheme. The ranks then show the
    error that the intervals do not include. If the fit's streams have few particles, give those of the data more
    (--truth-set stripping.particles=10000): a survey's data do not have the noise of the model. Their own noise, which
    `streamkit stream` prints, must be small beside the errors, or it widens the ranks.

    With --truth the model is another run file with the same streams, such as one whose host is of another family.
    Truths are drawn from its priors. Compared are the parameters that both have, by their names and of components of
    one kind, and the hosts: masses inside --radii, the circular velocity at 8 kpc, and the flattening of the potential
    at 20 kpc.

    A second table counts the checks of the fits' pages that are not fine, in draws that miss the truth and in others:
    which of them would have warned a user?

    Each draw is a whole fit. Make it small, as with --set stripping.particles=1000 --set sampler.steps=1000. Finished
    draws are written at once, and --resume makes the missing ones.

    Another method is tested by the same draws. --write-mocks DIR writes of each draw a run file with its mock data
    (mock_000.toml) and a table of the data (mock_000.csv: name, value, error). Put the method's samples beside them, as
    samples_000.csv, .ecsv, .npz or .h5, with a column or array for each free parameter by its name, in the unit of
    truths.ecsv. --samples DIR ranks the truths among them.
    """
    if mocks is not None and samples is not None:
        raise click.UsageError("--write-mocks and --samples: give one, the samples are made between the two")
    if resume and (mocks or samples) is not None:
        raise click.UsageError("--resume: continues fits, and --write-mocks and --samples make none")
    spec = load_spec(run_file, settings)
    other = read_settings(truth_settings, "--truth-set")
    truth = None if truth_file is None else load_spec(truth_file, ())
    truth = with_settings(truth or spec, other) if other else truth
    at = study.MASS_RADII if radii is None else read_radii(radii)
    if mocks is not None:
        _write_mocks(spec, truth, mocks, draws, options)
        return
    report.check_directory(options.out, study.PRODUCTS, "a calibration", options.force or resume)
    if samples is None:
        arguments = (options.out, draws, options.workers, resume)
        count, make = draws, partial(study.calibrate, spec, *arguments, truth=truth, radii=at)
    else:
        given = click.get_current_context().get_parameter_source("draws") != ParameterSource.DEFAULT
        truths = study.read_truths(samples, spec, truth)
        count = draws if given else len(truths)
        make = partial(study.calibrate_samples, spec, samples, options.out, count, truth=truth, radii=at)

    def run(done: Callable[[], object]) -> grid.Products:
        return study.calibration_products(make(done=done))

    conduct(options, count, run, unit="draw")


def _write_mocks(spec: sk.Spec, truth: sk.Spec | None, out: Path, draws: int, options: StudyOptions) -> None:
    """Write mock data with a sentence on what comes next."""
    report.check_directory(out, (study.TRUTHS,), "mock data", options.force)
    with report.locked(out), report.Progress(out.name, draws, "draw", shown=not options.quiet) as bar:
        stopped = study.write_mocks(spec, out, draws, options.workers, bar.update, truth)
    if not options.quiet:
        suffixes = f"{', '.join(study.SUFFIXES[:-2])} or {study.SUFFIXES[-2]}"
        text = (
            f"mock data: {out}. Put the samples of each draw beside them, as samples_000{suffixes}, with the columns "
            f"{', '.join(spec.names)}. Then give --samples {out} in the place of --write-mocks."
        )
        click.echo(report.paragraph(text))
    if stopped:
        click.echo(f"streamkit: {stopped}; the finished draws are written", err=True)
        click.get_current_context().exit(grid.exit_status(stopped))
