"""The command `streamkit calibrate`: whether the intervals of a fit hold the truth as often as they say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from streamkit import report
from streamkit.cli.options import FORCE, JSON, PDF, QUIET, RUN_FILE, SET, WORKERS, directory, load_spec, read_settings
from streamkit.cli.study import conduct
from streamkit.study import calibration as study
from streamkit.study import grid


@click.command()
@RUN_FILE
@SET
@click.option("--draws", default=100, show_default=True, type=click.IntRange(2), metavar="N",
              help="Truths that are drawn from the prior, each with a fit of its own.")  # fmt: skip
@click.option("--truth-set", "truth_settings", multiple=True, metavar="PATH=VALUE",
              help="Replace a field for the streams that the data are made of, and not for the fit: "
              "stripping.kind=streakline. Repeatable.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Keep the draws in DIR, and make those that are missing.")
@WORKERS
@directory("-calibration")
@FORCE
@PDF
@JSON
@QUIET
def calibrate(
    run_file: Path,
    settings: tuple[str, ...],
    truth_settings: tuple[str, ...],
    draws: int,
    resume: bool,
    workers: int,
    output: Path | None,
    force: bool,
    pdf: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Test the whole fit on mock data whose truth is known.

    Parameters are drawn from the prior, data made of their stream with other random numbers, and these fitted as the
    run file says. If everything is right, the rank of the truth among the posterior samples is uniform
    (simulation-based calibration, Talts et al. 2018), and the 68 % interval holds it in 68 of 100 draws.

    With --truth-set the data come from other streams than those that are fitted, such as another stripping scheme's,
    with the same free parameters: it shows the error that the intervals do not hold. Where the streams of the fit have
    few particles give those of the data more, as with --truth-set stripping.particles=10000: a survey's data do not
    have the noise of the model.

    Each draw is a whole fit: make it small, as with --set stripping.particles=1000 --set sampler.steps=1000. Draws are
    kept as they are finished, and --resume goes on.
    """
    out = output if output is not None else Path(f"{run_file.stem}-calibration")
    report.check_directory(out, study.PRODUCTS, "a calibration", force or resume)
    spec = load_spec(run_file, settings)
    other = read_settings(truth_settings, "--truth-set")
    truth = spec.with_values(other) if other else None

    def run(done: Callable[[], object]) -> grid.Products:
        return study.calibration_products(study.calibrate(spec, out, draws, workers, resume, done, truth))

    conduct(out, draws, run, quiet=quiet, as_json=as_json, pdf=pdf, unit="draw")
