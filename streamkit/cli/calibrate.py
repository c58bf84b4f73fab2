"""The command `streamkit calibrate`: a test whether the intervals of a fit contain the truth as often as stated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from streamkit import report
from streamkit.cli.options import SET, load_spec, read_settings, with_settings
from streamkit.cli.study import StudyOptions, conduct, study_options
from streamkit.study import calibration as study
from streamkit.study import grid


@click.command()
@SET
@click.option("--draws", default=100, show_default=True, type=click.IntRange(2), metavar="N",
              help="Number of truths that are drawn from the prior, each with a fit of its own.")  # fmt: skip
@click.option("--truth-set", "truth_settings", multiple=True, metavar="PATH=VALUE",
              help="Replace a field in the model of the mock data, not in that of the fit, such as "
              "stripping.kind=streakline. Repeatable.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Keep the draws in DIR, and compute the missing ones.")
@study_options("-calibration")
def calibrate(
    run_file: Path,
    settings: tuple[str, ...],
    truth_settings: tuple[str, ...],
    draws: int,
    resume: bool,
    options: StudyOptions,
) -> None:
    """Test the whole fit on mock data whose truth is known.

    Each draw takes parameters from the prior, makes mock data of their stream with random numbers that the fit does not
    have, and fits them as the run file says. If the fit is right, the rank of the truth among the posterior samples is
    uniform (simulation-based calibration, Talts et al. 2018): the 68 % interval contains the truth in 68 of 100 draws.

    With --truth-set the mock data come from another model with the same free parameters, such as another stripping
    scheme. The ranks then show the error that the intervals do not include. If the fit's streams have few particles,
    give those of the data more (--truth-set stripping.particles=10000): a survey's data do not have the noise of the
    model.

    Each draw is a whole fit. Make it small, as with --set stripping.particles=1000 --set sampler.steps=1000. Finished
    draws are written at once, and --resume makes the missing ones.
    """
    report.check_directory(options.out, study.PRODUCTS, "a calibration", options.force or resume)
    spec = load_spec(run_file, settings)
    other = read_settings(truth_settings, "--truth-set")
    truth = with_settings(spec, other) if other else None

    def run(done: Callable[[], object]) -> grid.Products:
        calibration = study.calibrate(spec, options.out, draws, options.workers, resume, done, truth)
        return study.calibration_products(calibration)

    conduct(options, draws, run, unit="draw")
