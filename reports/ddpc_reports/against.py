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
        labels = self.labels
        if len(labels) < 2 or not self.ranking.keys:
            return None
        pairs = {
            name: [[_of_script(cell) for cell in cells] for cells in self._against(name).values()]
            for name in labels
        }
        return {
            "table": table,
            "labels": labels,
            "chosen": self.chosen if self.chosen in labels else "",
            "json": json.dumps({"details": self._details, "pairs": pairs}, ensure_ascii=False),
        }

    @property
    def _details(self) -> list[str]:
        several = len(self.ranking.keys) > 1
        return [(metric_signal(key) or "money") if several else "" for key in self.ranking.keys]

    def _against(self, baseline: str) -> Mapping[str, list[Cell]]:
        ranking = with_baseline(self.ranking, self.cases, baseline)
        return {
            controller.key: [_cell(ranking, key, baseline, controller.key) for key in ranking.keys]
            for controller in self.order
        }


def _cell(ranking: Standings, key: str, baseline: str, controller: str) -> Cell:
    if controller == baseline:
        return Cell(_OWN, 0.0, tone="versus")
    told = against(ranking, key, baseline, controller)
    if told is None or told.verdict is Verdict.UNKNOWN:
        return Cell(MISSING, math.nan, tone="versus", title=str(Verdict.UNKNOWN))
    tone = _TONES[told.verdict] if told.is_told else "versus"
    value = told.difference.median if math.isnan(told.percent) else told.percent
    return Cell(f"{_size(told, key)} {told.word}", value, tone=tone)


def _size(told: Against, key: str) -> str:
    """Write a difference with its sign: in percent, or in the unit of the metric."""
    size = told.difference.median if math.isnan(told.percent) else told.percent
    sign = MINUS if size < 0 else "+" if size > 0 else ""
    if math.isnan(told.percent):
        return sign + with_unit(significant(abs(size), 3), metric_unit(key))
    return f"{sign}{fixed(abs(size), 0 if abs(size) >= 9.95 else 1)}\u00a0%"


def _of_script(cell: Cell) -> list[Any]:
    value = float(cell.raw)
    return [cell.text, cell.tone, value if math.isfinite(value) else None]


def baselines_of(
    ranking: Standings, cases: Iterable[CaseResult], order: Sequence[ControllerResults], chosen: str | None
) -> Baselines:
    """Return what a ranking says against others, with the study's own baseline if it names one."""
    return Baselines(ranking, [*cases], order, chosen or "")
