"""The ranking against one controller, such as the one in use today, which study or reader choose."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ddpc_cosim import CaseResult
from ddpc_cosim.files.tables import Cell, Heading
from ddpc_cosim.study.verdicts.baselines import Against, Verdict, against, with_baseline
from ddpc_cosim.study.verdicts.standings import Standings
from ddpc_reports.comparison import ControllerResults, metric_signal, metric_unit
from ddpc_reports.numbers import MINUS, MISSING, fixed, significant, with_unit
from ddpc_reports.tables.table import Column

_TONES = {Verdict.BETTER: "versus met", Verdict.WORSE: "versus missed"}
_OWN = "baseline"
_NOT_RUN = Cell(MISSING, math.nan, tone="versus", title=str(Verdict.UNKNOWN))


@dataclass(frozen=True)
class Baselines:
    """What a ranking says against each controller that the reader may choose.

    Parameters
    ----------
    ranking : Standings
        Where the controllers stand.
    cases : sequence of CaseResult
        The runs, those of controllers that do not compete too.
    order : sequence of ControllerResults
        The controllers as the table has them.
    chosen : str
        The study's baseline; empty: it names none.
    """

    ranking: Standings
    cases: Sequence[CaseResult]
    order: Sequence[ControllerResults]
    chosen: str

    @property
    def labels(self) -> dict[str, str]:
        """The controllers that may be chosen: those that compete, and the study's own baseline."""
        known = {*next(iter(self.ranking.runs.values()), {}), self.chosen}
        return {controller.key: controller.label for controller in self.order if controller.key in known}

    def columns(self) -> list[Column]:
        """Return the columns against the study's baseline, one for each metric that is ranked by."""
        if self.chosen not in self.labels:
            return []
        table = self._against(self.chosen)
        title = f"against {self.labels[self.chosen]}"
        return [
            (Heading(title, detail), [cells[place] for cells in table.values()])
            for place, detail in enumerate(self._details)
        ]

    def notes(self) -> tuple[str, ...]:
        """Say what the columns are; nothing without any."""
        if self.chosen not in self.labels:
            return ()
        name = self.labels[self.chosen]
        return (
            f"Against {name}: the median of the differences in pairs of the same scenario and seed, in % of "
            f"the median of {name} over these runs; in the metric's unit where that is next to nothing. "
            "Better and worse are told as ranks are; n.\u00a0s.: the seeds do not tell the two apart; "
            "negligible: below what matters; untested: too few seeds, or runs failed.",
        )

    def choice(self, table: str) -> dict[str, Any] | None:
        """Return what the page's script chooses from; None where there is nothing to choose.

        ``table`` is the name of the ranking in the page.
        """
        if not self.ranking.keys:
            return None
        pairs = {name: [*self._against(name).values()] for name in self.labels}
        return _choice(table, self.labels, self.chosen, self._details, pairs)

    def verdict(self, baseline: str, controller: str) -> Verdict | None:
        """Return what is told of a controller against another over all that is ranked by, as ranks are.

        It is better if it is told to be so in something, and worse in nothing; None where one did not run.
        """
        comparisons = [against(self._with(baseline), key, baseline, controller) for key in self.ranking.keys]
        verdicts = {pair.verdict if pair.is_told else Verdict.LEVEL for pair in comparisons if pair}
        if not verdicts:
            return None
        telling = verdicts & {Verdict.BETTER, Verdict.WORSE}
        return telling.pop() if len(telling) == 1 else Verdict.LEVEL

    @property
    def _details(self) -> list[str]:
        several = len(self.ranking.keys) > 1
        return [(metric_signal(key) or "money") if several else "" for key in self.ranking.keys]

    def _with(self, baseline: str) -> Standings:
        return with_baseline(self.ranking, self.cases, baseline)

    def _against(self, baseline: str) -> Mapping[str, list[Cell]]:
        ranking = self._with(baseline)
        return {
            controller.key: [_cell(ranking, key, baseline, controller.key) for key in ranking.keys]
            for controller in self.order
        }


def _cell(ranking: Standings, key: str, baseline: str, controller: str) -> Cell:
    if controller == baseline:
        return Cell(_OWN, 0.0, tone="versus")
    comparison = against(ranking, key, baseline, controller)
    if comparison is None or comparison.verdict is Verdict.UNKNOWN:
        return _NOT_RUN
    tone = _TONES[comparison.verdict] if comparison.is_told else "versus"
    value = comparison.difference.median if math.isnan(comparison.percent) else comparison.percent
    return Cell(f"{_size(comparison, key)} {comparison.word}", value, tone=tone)


def _size(comparison: Against, key: str) -> str:
    """Write a difference with its sign: in percent, or in the unit of the metric."""
    size = comparison.difference.median if math.isnan(comparison.percent) else comparison.percent
    sign = MINUS if size < 0 else "+" if size > 0 else ""
    if math.isnan(comparison.percent):
        return sign + with_unit(significant(abs(size), 3), metric_unit(key))
    return f"{sign}{fixed(abs(size), 0 if abs(size) >= 9.95 else 1)}\u00a0%"


def _of_script(cell: Cell) -> list[Any]:
    value = float(cell.raw)
    return [cell.text, cell.tone, float(f"{value:.4g}") if math.isfinite(value) else None]


@dataclass(frozen=True)
class OverallBaselines:
    """What is told over all problems of a study against each controller that the reader may choose.

    Parameters
    ----------
    problems : sequence of Baselines
        What is told in each.
    order : sequence of ControllerResults
        The controllers as the table has them.
    """

    problems: Sequence[Baselines]
    order: Sequence[ControllerResults]

    @property
    def chosen(self) -> str:
        """The baseline of all problems; empty where they name none, or not the same."""
        named = {problem.chosen for problem in self.problems}
        return named.pop() if len(named) == 1 else ""

    @property
    def labels(self) -> dict[str, str]:
        """The controllers that may be chosen in some problem."""
        known = {key for problem in self.problems for key in problem.labels}
        return {controller.key: controller.label for controller in self.order if controller.key in known}

    def columns(self) -> list[Column]:
        """Return the column against the study's baseline; none without."""
        if self.chosen not in self.labels:
            return []
        return [(Heading(f"against {self.labels[self.chosen]}", "problems"), self._against(self.chosen))]

    def notes(self) -> tuple[str, ...]:
        """Say what the column is, or would be for a baseline that the reader chooses."""
        if len(self.labels) < 2:
            return ()
        return (
            "Against a baseline: in how many problems the seeds tell a controller to be better and worse, as "
            "ranks are told: of several outputs in one of them, and the reverse in none.",
        )

    def choice(self, table: str) -> dict[str, Any] | None:
        """Return what the page's script chooses from; None where there is nothing to choose."""
        pairs = {name: [[cell] for cell in self._against(name)] for name in self.labels}
        return _choice(table, self.labels, self.chosen, ["problems"], pairs)

    def _against(self, baseline: str) -> list[Cell]:
        return [self._cell(baseline, controller.key) for controller in self.order]

    def _cell(self, baseline: str, controller: str) -> Cell:
        if controller == baseline:
            return Cell(_OWN, 0.0, tone="versus")
        verdicts = [problem.verdict(baseline, controller) for problem in self.problems]
        if not any(verdicts):
            return _NOT_RUN
        better, worse = verdicts.count(Verdict.BETTER), verdicts.count(Verdict.WORSE)
        # A tone where no problem says the reverse.
        verdict = Verdict.BETTER if better and not worse else Verdict.WORSE if worse and not better else None
        text = f"{better} better, {worse} worse" if better or worse else "n.\u00a0s."
        return Cell(text, float(worse - better), tone=_TONES[verdict] if verdict else "versus")


def _choice(
    table: str,
    labels: Mapping[str, str],
    chosen: str,
    details: Sequence[str],
    pairs: Mapping[str, Sequence[Sequence[Cell]]],
) -> dict[str, Any] | None:
    """Return what the page's script chooses from: of each baseline the cells, row by row."""
    if len(labels) < 2:
        return None
    cells = {name: [[*map(_of_script, row)] for row in rows] for name, rows in pairs.items()}
    return {
        "table": table,
        "labels": labels,
        "chosen": chosen if chosen in labels else "",
        "json": json.dumps({"details": details, "pairs": cells}, ensure_ascii=False),
    }


def baselines_of(
    ranking: Standings, cases: Iterable[CaseResult], order: Sequence[ControllerResults], chosen: str | None
) -> Baselines:
    """Return what a ranking says against others, with the study's own baseline if it names one."""
    return Baselines(ranking, [*cases], order, chosen or "")
