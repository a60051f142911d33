"""``mrnav stats``: two conditions compared, paired and as published; power and sample size."""

import json
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from mrnav_server.study.statistics import Analysis
    from mrnav_server.study.statistics_paired import PairedTest
    from mrnav_server.study.statistics_power import Power


class Test(StrEnum):
    """The paired test, as the command line names it."""

    T = "t"
    WILCOXON = "wilcoxon"
    SIGN_FLIP = "sign-flip"


_TESTS: Mapping[Test, "PairedTest"] = {
    Test.T: "paired t",
    Test.WILCOXON: "Wilcoxon signed-rank",
    Test.SIGN_FLIP: "exact sign-flip",
}


def stats(
    file: Annotated[
        Path | None,
        typer.Argument(help="CSV with the columns participant, condition, value; metric too for several."),
    ] = None,
    alpha: Annotated[float, typer.Option(help="Level of the tests.")] = 0.05,
    test: Annotated[
        Test | None, typer.Option(help="The paired test, if you fixed it before you saw the data.")
    ] = None,
    power: Annotated[float | None, typer.Option(help="Plan: chance to find the effect, e.g. 0.8.")] = None,
    effect: Annotated[float | None, typer.Option(help="Plan: d_z of the differences, e.g. 0.8.")] = None,
    participants: Annotated[int | None, typer.Option(help="Plan: how many take part.")] = None,
    tests: Annotated[int, typer.Option(min=1, help="Plan: measures that share alpha by Holm.")] = 1,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Compare two conditions: per participant, and beside it pooled over trials as published.

    Without a file, two of --effect, --participants and --power give the third.
    """
    from dataclasses import asdict

    from mrnav_server.study.statistics import analyse
    from mrnav_server.study.statistics_power import planned
    from mrnav_server.study.statistics_samples import read_samples

    if file is None:
        plan = planned(effect, participants, power, alpha, tests)
        if json_output:
            typer.echo(json.dumps(asdict(plan)))
        else:
            Console().print(_plan_table(plan))
        return
    if power is not None or effect is not None or participants is not None:
        raise ConfigError("leave the file out to plan; --power, --effect and --participants need none")
    if not 0.0 < alpha < 1.0:
        raise ConfigError(f"--alpha must lie between 0 and 1, for example 0.05, not {alpha:g}")
    analyses = analyse(read_samples(file), alpha, _TESTS[test] if test else None)
    if json_output:
        records = {name: each.record() for name, each in analyses.items()}
        only = next(iter(records.values()))
        found = only if len(records) == 1 else {"metrics": records}
        typer.echo(json.dumps({"alpha": alpha, **found}))
        return
    for name, analysis in analyses.items():
        _show(name, analysis)


def _show(name: str, analysis: "Analysis") -> None:
    from mrnav_server.study.statistics import PAIRING
    from mrnav_server.study.statistics_pooled import POOLING

    samples, paired, pooled = analysis.samples, analysis.paired, analysis.pooled
    console = Console()
    table = Table(title=f"{name}: {samples.first} − {samples.second}, {PAIRING}", title_justify="left")
    for column in ("quantity", "value", "interval", "p"):
        table.add_column(column)
    table.add_row("participants", str(paired.participants))
    table.add_row(f"mean {samples.first}", _number(paired.first_mean))
    table.add_row(f"mean {samples.second}", _number(paired.second_mean))
    table.add_row("mean difference", _number(paired.mean_difference), _interval(paired.mean_ci))
    table.add_row("median difference", _number(paired.median_difference), _interval(paired.median_ci))
    table.add_row("d_z", _number(paired.d_z), _interval(paired.d_z_ci))
    table.add_row("matched rank-biserial", _number(paired.rank_biserial))
    table.add_row("Shapiro–Wilk of the differences", "", "", _p(paired.shapiro_p))
    table.add_row(f"paired t ({paired.df} df)", _number(paired.t), "", _p(paired.t_p))
    table.add_row("Wilcoxon signed-rank", _number(paired.wilcoxon_w), "", _p(paired.wilcoxon_p))
    table.add_row("exact sign-flip", "", "", _p(paired.sign_flip_p))
    table.add_row("smallest p by rank or sign", "", "", _p(paired.smallest_p))
    table.add_row(f"[bold]primary: {paired.test or 'none'}", "", "", f"[bold]{_p(paired.p)}")
    table.add_row("primary, by Holm", "", "", _p(analysis.paired_holm))
    console.print(table)
    for warning in paired.warnings:
        console.print(f"[yellow]note:[/] {warning}", highlight=False)
    beside = Table(title=f"{name}: as published, {POOLING}", title_justify="left")
    for column in ("quantity", samples.first, samples.second, "p"):
        beside.add_column(column)
    beside.add_row("trials", str(pooled.first_n), str(pooled.second_n))
    beside.add_row("mean", _number(pooled.first_mean), _number(pooled.second_mean))
    beside.add_row("standard deviation", _number(pooled.first_sd), _number(pooled.second_sd))
    normal = (pooled.first_normality, pooled.second_normality)
    beside.add_row("Shapiro–Wilk p", *(_p(each.p) + (each.note and f" ({each.note})") for each in normal))
    beside.add_row("t-test", f"t = {_number(pooled.t)}", "", _p(pooled.t_p))
    beside.add_row("Mann–Whitney U", f"U = {_number(pooled.u)}", "", _p(pooled.u_p))
    beside.add_row(f"chosen: {pooled.test or 'none'}", "", "", _p(pooled.p))
    beside.add_row("chosen, by Holm", "", "", _p(analysis.pooled_holm))
    console.print(beside)


def _plan_table(plan: "Power") -> Table:
    table = Table(title="Paired comparison, planned", title_justify="left")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    table.add_row("effect d_z", f"{plan.effect:.3f}")
    table.add_row("participants", str(plan.participants))
    table.add_row("power", f"{plan.power:.3f}")
    table.add_row("level of the strictest test", f"{plan.alpha:g}")
    table.add_row("participants by Wilcoxon's test", str(plan.participants_by_rank))
    table.add_row("fewest for any p by rank or sign", str(plan.least_by_rank))
    return table


def _number(value: float) -> str:
    return "–" if value != value else f"{value:.5g}"


def _interval(bounds: tuple[float, float]) -> str:
    return "–" if bounds[0] != bounds[0] else f"{bounds[0]:.4g} to {bounds[1]:.4g}"


def _p(value: float) -> str:
    return "–" if value != value else f"{value:.3g}"
