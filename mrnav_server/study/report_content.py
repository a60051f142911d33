"""What a report holds, in order: its words, figures and tables, from a study alone (docs/report.md)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from mrnav_server.study.figure import ReportFigure
from mrnav_server.study.figure_boxes import operator_means
from mrnav_server.study.figure_paths import tasks
from mrnav_server.study.measures import FIVE, FURTHER, HANDOVER, WORKLOAD, Measure
from mrnav_server.study.report_appendix import (
    environment_table,
    left_out_table,
    trials_table,
    values_table,
)
from mrnav_server.study.report_figures import (
    boxes_figure,
    handover_figure,
    pairs_figure,
    paths_figure,
    workload_figure,
)
from mrnav_server.study.report_table import Table
from mrnav_server.study.report_tables import (
    ARROWS,
    Analyses,
    comparison,
    means_table,
    normality_table,
    paired_table,
    pooled_table,
)
from mrnav_server.study.statistics import analyse
from mrnav_server.study.study_data import Study

_WORKLOAD = "Workload"
_SCALES = "↓ lower is less workload; performance runs from good (0) to poor (100)."


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a report.

    Attributes:
        heading: Its name.
        words: What to read first; "" for nothing.
        items: Its figures and tables.
    """

    heading: str
    words: str
    items: tuple[Table | ReportFigure, ...]


@dataclass(frozen=True, slots=True)
class Report:
    """A report before it is laid out.

    Attributes:
        title: Of the whole.
        origin: Where the figures come from, said on every page.
        sections: In order.
        files: Tables that are kept as files alone.
    """

    title: str
    origin: str
    sections: tuple[Section, ...]
    files: tuple[Table, ...]

    @property
    def figures(self) -> list[ReportFigure]:
        """All of them, in order."""
        return [each for part in self.sections for each in part.items if isinstance(each, ReportFigure)]

    @property
    def tables(self) -> list[Table]:
        """Those that are read, in order."""
        return [each for part in self.sections for each in part.items if isinstance(each, Table)]

    def number(self, item: Table | ReportFigure) -> int:
        """Return which of the figures, or of the tables, one of them is, from 1."""
        among = self.figures if isinstance(item, ReportFigure) else self.tables
        return 1 + [each.name for each in among].index(item.name)


def report(study: Study) -> Report:
    """Return a study's report."""
    five, handed = (_analyses(study, measures) for measures in (FIVE, HANDOVER))
    sections = [
        Section("Summary", _summary(study), (_comparison(study, five), boxes_figure(study, five))),
        Section("Paired analysis", "", (_paired(study, five), pairs_figure(study, five))),
        Section(
            "The published analysis, reproduced", "", (pooled_table(FIVE, five), normality_table(FIVE, five))
        ),
        Section("Hand-over", "", (handover_figure(study, handed), _handover_table(study, handed))),
        Section("Further metrics", "", (_further_table(study),)),
        _paths(study),
        *_by_task(study),
        _workload(study),
        Section("Trials", "", (trials_table(study),)),
        Section("Provenance", "", (environment_table(study), *_left_out(study))),
    ]
    title = ", ".join(filter(None, ("Study report", study.mark)))
    return Report(title, study.origin, tuple(sections), (values_table(study),))


def _analyses(study: Study, measures: Sequence[Measure]) -> Analyses:
    return analyse({each.symbol: each.samples(study) for each in measures})


def _summary(study: Study) -> str:
    count = len(tasks(study))
    words = (
        f"{len(study.trials)} finished trials of {len(study.operators)} {study.people},"
        f" {count} {'task' if count == 1 else 'tasks'}, with and without autonomy."
    )
    if study.operator_kind == "simulated":
        words += (
            " Everything here is simulated: it exercises the software and says nothing about people."
            " Simulated operators are no participants, and answer no questionnaire."
        )
    elif study.simulated:
        words += " People steered a simulated rig: nothing here was measured on hardware."
    return words


def _comparison(study: Study, analyses: Analyses) -> Table:
    title = "The five metrics, beside the published ones"
    return comparison("comparison", title, FIVE, analyses, study.people, ARROWS)


def _paired(study: Study, analyses: Analyses) -> Table:
    note = "p Holm is adjusted over the five metrics."
    return paired_table("paired", "Paired analysis of the five metrics", FIVE, analyses, study.people, note)


def _handover_table(study: Study, analyses: Analyses) -> Table:
    compared = [each for each in HANDOVER if each.symbol != "take-over"]
    take_over_s = operator_means(analyses["take-over"], "with_autonomy")
    note = "Exploratory; p Holm is adjusted over these four."
    if take_over_s.size > 1:
        note += (
            f" Take-over time with autonomy: {take_over_s.mean():.2f} s, SD {take_over_s.std(ddof=1):.2f} s"
            f" over the own means of {take_over_s.size} {study.people}."
        )
    return paired_table(
        "handover", "Paired analysis of the hand-over", compared, analyses, study.people, note
    )


def _paths(study: Study) -> Section:
    if tasks(study):
        return Section("Mean trajectories", "", (paths_figure(study),))
    return Section("Mean trajectories", "No trial reached its target: there is no way to average.", ())


def _further_table(study: Study) -> Table:
    return means_table("further", "Means of the further metrics", FURTHER, {"": study}, study.people)


def _by_task(study: Study) -> tuple[Section, ...]:
    """Return the five metrics of each task by itself; nothing where there is but one."""
    parts = {
        name: replace(study, trials=tuple(trial for trial in study.trials if trial.task == name))
        for name in sorted({trial.task for trial in study.trials})
    }
    both = {
        name: part
        for name, part in parts.items()
        if len({trial.header.condition for trial in part.trials}) == 2
    }
    if len(parts) < 2 or not both:
        return ()
    table = means_table("by-task", "The five metrics of each task", FIVE, both, study.people)
    return (Section("Each task by itself", "", (table,)),)


def _workload(study: Study) -> Section:
    """Return what people answered, or why there is nothing; simulated operators never answer."""
    if study.operator_kind == "simulated":
        words = "No chart: simulated operators answer no questionnaire, and NASA-TLX is never simulated."
        return Section(_WORKLOAD, words, ())
    if not any(trial.answers for trial in study.trials):
        words = (
            "No chart: none of these trials holds answers. They are given at /tlx after a block's last trial."
        )
        return Section(_WORKLOAD, words, ())
    analyses = _analyses(study, WORKLOAD)
    if not any(analyses[each.symbol].samples.pairs().participants for each in WORKLOAD):
        return Section(_WORKLOAD, "No chart: nobody answered the questionnaire in both conditions.", ())
    note = "p Holm is adjusted over the eight scores, of which the weighted one was published as the result."
    return Section(
        _WORKLOAD,
        "",
        (
            workload_figure(study, analyses),
            comparison(
                "tlx", "NASA-TLX, beside the published one", WORKLOAD, analyses, study.people, _SCALES
            ),
            paired_table("workload", "NASA-TLX, paired", WORKLOAD, analyses, study.people, note),
        ),
    )


def _left_out(study: Study) -> tuple[Table, ...]:
    return (left_out_table(study),) if study.left_out else ()
