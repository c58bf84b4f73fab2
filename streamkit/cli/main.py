"""The command ``streamkit``: the group with its commands, one file each. Nothing heavy is loaded before its use."""

from __future__ import annotations

import click

from streamkit.cli.ablate import ablate
from streamkit.cli.calibrate import calibrate
from streamkit.cli.check import check
from streamkit.cli.cite import cite
from streamkit.cli.export import export
from streamkit.cli.families import families
from streamkit.cli.group import Commands
from streamkit.cli.host import host
from streamkit.cli.init import init
from streamkit.cli.new import new
from streamkit.cli.plugins import plugins
from streamkit.cli.reference import reference
from streamkit.cli.report import report
from streamkit.cli.run import run
from streamkit.cli.schema import schema
from streamkit.cli.sensitivity import sensitivity
from streamkit.cli.status import status
from streamkit.cli.stream import stream
from streamkit.distribution import VERSION


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(VERSION, message="streamkit %(version)s")
def main() -> None:
    """Weigh a galaxy with a tidal stream.

    Start with 'streamkit init', which lists example run files; then 'streamkit check', 'stream' and 'run'.
    """


for command in (
    init, check, stream, host, ablate, sensitivity, calibrate, families, run, status, report, export, cite, plugins,
    reference, schema, new,
):  # fmt: skip
    main.add_command(command)
