"""What a report holds, in order: its words, figures and tables, from a study alone (docs/report.md)."""

from collections.abc import Sequence
from dataclasses import dataclass

from mrnav_server.study.figure import ReportFigure
from mrnav_server.study.figure_paths import tasks
from mrnav_server.study.measures import FIVE, FURTHER, HANDOVER, WORKLOAD, Measure
from mrnav_server.study.report_appendix import (
    environment_table,
    left_out_table,
    trials_table,
    values_table,
)
from mrnav_server.study.report_figures import (
    WINDOW,
    boxes_figure,
    handover_figure,
    pairs_figure,
    paths_figure,
    workload_figure,
)
from mrnav_server.study.report_table import Table
from mrnav_server.study.report_tables import (
    Analyses,
    comparison,
    means_table,
    normality_table,
    paired_table,
    pooled_table,
)
from mrnav_server.study.statistics import analyse
from mrnav_server.study.study_data import Study


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


def report(study: Study) -> Report:
    """Return a study's report."""
    five, handed, further = (_analyses(study, measures) for measures in (FIVE, HANDOVER, FURTHER))
    sections = [
        Section("Summary", _summary(study), (comparison(study, FIVE, five), boxes_figure(study, five))),
        Section("Paired analysis", "", (_paired(study, five), pairs_figure(study, five))),
        Section(
            "The published analysis, reproduced", "", (pooled_table(FIVE, five), normality_table(FIVE, five))
        ),
        Section("Hand-over", WINDOW, (handover_figure(study, handed), _handover_table(study, handed))),
        Section("Further metrics", "", (_further_table(study, further),)),
        Section("Mean trajectories", "", (paths_figure(study),) if tasks(study) else ()),
        _workload(study),
        Section("Provenance", "", (environment_table(study), *_left_out(study))),
        Section("Trials", "", (trials_table(study),)),
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


def _paired(study: Study, analyses: Analyses) -> Table:
    note = "p Holm is adjusted over the five metrics."
    return paired_table("paired", "Paired analysis of the five metrics", FIVE, analyses, study.people, note)


def _handover_table(study: Study, analyses: Analyses) -> Table:
    compared = [each for each in HANDOVER if each.symbol != "take-over"]
    take_over = analyses["take-over"].pooled
    note = "Exploratory; p Holm is adjusted over these four."
    if take_over.first_n > 1:
        note += (
            f" Take-over time with autonomy: {take_over.first_mean:.2f} s, SD {take_over.first_sd:.2f} s"
            f" over {take_over.first_n} trials."
        )
    return paired_table(
        "handover", "Paired analysis of the hand-over", compared, analyses, study.people, note
    )


def _further_table(study: Study, analyses: Analyses) -> Table:
    return means_table("further", "Means of the further metrics", study, FURTHER, analyses, "Not tested.")


def _workload(study: Study) -> Section:
    """Return what people answered; nothing where nobody did, and simulated operators never do."""
    if study.operator_kind == "simulated" or not any(trial.answers for trial in study.trials):
        return Section("Workload", "", ())
    analyses = _analyses(study, WORKLOAD)
    note = "p Holm is adjusted over the eight scores, of which the weighted one was published as the result."
    table = paired_table("workload", "NASA-TLX, paired", WORKLOAD, analyses, study.people, note)
    return Section("Workload", "", (workload_figure(study, analyses), table))


def _left_out(study: Study) -> tuple[Table, ...]:
    return (left_out_table(study),) if study.left_out else ()
