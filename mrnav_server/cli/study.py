"""``mrnav study``: a user study from its plan to its report."""

import typer

from mrnav_server.cli.export import export, study_import
from mrnav_server.cli.study_plan import new, status, tell
from mrnav_server.cli.study_report import study_report
from mrnav_server.cli.study_simulate import simulate

studies = typer.Typer(no_args_is_help=True, help="User studies: plan, run, simulate, report, export.")


@studies.callback()
def _group() -> None:
    """User studies."""


studies.command("report")(study_report)
studies.command("export")(export)
studies.command("import")(study_import)
for command in (new, status, tell, simulate):
    studies.command()(command)
