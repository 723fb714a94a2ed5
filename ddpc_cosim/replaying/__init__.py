"""Replay: what a controller of a study would have done, at each sample of a log, beside what was done.

It is a case of the study in which the log stands in for the plant. Its outputs do not answer to what the
controller decides: at every sample it begins anew with the log as its past, and says what it would do if it
took over there.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ddpc_cosim.controller import OK
from ddpc_cosim.errors import CosimError
from ddpc_cosim.files.csv_files import write_table
from ddpc_cosim.files.durations import shown
from ddpc_cosim.files.tables import Cell, Heading, Row, Table, text_headings
from ddpc_cosim.loop.logged import WITHOUT_PAST
from ddpc_cosim.loop.plotting import Picture
from ddpc_cosim.loop.safe_calls import CLIPPED
from ddpc_cosim.loop.trace import Trace
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.replaying.prepared import NO_COLUMNS, prepare
from ddpc_cosim.study.case_files import load_case
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.objects import Silent, Study
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.runner import Progress, Update, run_cases
from ddpc_cosim.study.single import single_case
from ddpc_cosim.variables import FloatArray, Variable

if TYPE_CHECKING:
    import pandas as pd

LOGGED = "log"
"""What the inputs of the log are called."""
_AT_LIMIT = 1e-9
"""How near to a limit is at it, in parts of the range."""

SHOWS = (
    "Open loop: the outputs of the log did not answer to these inputs. At each sample the controller took "
    "over from what was really applied before, so each answer is advice for one sample. It shows whether the "
    "inputs are plausible: their sign and size, how often they are at a limit, how far they move at once, "
    "failed solves, and the time of a step. It does not show how well the controller would have controlled, "
    "nor whether the loop would have been stable."
)
"""What a replay can show, and what it cannot."""


class Difference(NamedTuple):
    """How far the inputs of a controller are from those of a log, of one input over K samples.

    Parameters
    ----------
    input : Variable
        The input.
    median, largest : float
        Median and largest size of the difference, in the input's unit.
    time : float
        When it is largest [s].
    range : float
        Width of the limits, or of what the log reached where an input has no two limits.
    at_limit, log_at_limit : float
        Share of the samples at which the controller's and the log's input is at a limit.
    beyond : float
        Share of the samples at which the log's input is beyond the limits of the study.
    move, log_move : float
        Root mean square of what the controller's and the log's input differ by from the input that was
        applied at the sample before, in the input's unit.
    same_way : float
        Share of the samples at which both move that they move the same way; NaN where there is none.
    """

    input: Variable
    median: float
    largest: float
    time: float
    range: float
    at_limit: float
    log_at_limit: float
    beyond: float
    move: float
    log_move: float
    same_way: float


@dataclass(frozen=True, slots=True)
class Replay:
    """What a controller would have done, sample by sample, beside what was done.

    Parameters
    ----------
    log : str
        The log's name.
    study, controller : str
        The study, and the controller's name there.
    trace : Trace
        The answered samples: ``u`` is what the controller decided, the outputs are those of the log.
    applied : array, shape (K, m)
        The inputs of the log.
    before : array, shape (m,)
        Those of the sample before.
    rows : int
        Rows of the log.
    notes : tuple of str
        What was chosen where nothing was said, and what speaks against the data.
    """

    log: str
    study: str
    controller: str
    trace: Trace
    applied: FloatArray
    before: FloatArray
    rows: int
    notes: tuple[str, ...] = ()

    def differences(self) -> tuple[Difference, ...]:
        """Return how far the controller's inputs are from the log's, an entry per input."""
        return tuple(self._difference(i, variable) for i, variable in enumerate(self.trace.inputs))

    def _difference(self, i: int, variable: Variable) -> Difference:
        trace, rows = self.trace, slice(0, self.trace.decided)
        u, applied = trace.u[rows, i], self.applied[rows, i]
        low = np.broadcast_to(trace.bounds.u_min[i], len(u))
        high = np.broadcast_to(trace.bounds.u_max[i], len(u))
        if variable.name in trace.moving_limits:
            low, high = trace.input_limits[rows, i].T
        span = float(trace.bounds.u_max[i] - trace.bounds.u_min[i])
        span = span if np.isfinite(span) else float(np.ptp(applied))
        near = _AT_LIMIT * span
        last = np.concatenate([[self.before[i]], applied[:-1]])
        size, moves, log_moves = np.abs(u - applied), u - last, applied - last
        both = (np.abs(moves) > near) & (np.abs(log_moves) > near)
        most = int(np.argmax(size))
        return Difference(
            variable,
            float(np.median(size)),
            float(size[most]),
            float(trace.time[most]),
            span,
            float(np.mean((u <= low + near) | (u >= high - near))),
            float(np.mean((applied <= low + near) | (applied >= high - near))),
            float(np.mean((applied < low - near) | (applied > high + near))),
            float(np.sqrt(np.mean(moves**2))),
            float(np.sqrt(np.mean(log_moves**2))),
            float(np.mean(moves[both] * log_moves[both] > 0.0)) if both.any() else np.nan,
        )

    @property
    def failures(self) -> dict[str, int]:
        """At how many samples the controller returned a fallback, by its reason."""
        return dict(Counter(status for status in self.trace.status[: self.trace.decided] if status != OK))

    def summary(self) -> tuple[str, ...]:
        """Return in sentences how far both differ, how the controller fared, and what that can show."""
        trace = self.trace
        count, said = trace.decided, list[str]()
        for part in self.differences() if count else ():
            unit, name = part.input.unit or "1", part.input.name
            share = f" ({100 * part.median / part.range:.3g} % of the range)" if part.range else ""
            most = f", {100 * part.largest / part.range:.3g} %," if part.range else ""
            said.append(
                f"{name}: differs from the log by {part.median:.4g} {unit} in the median{share}, and by "
                f"{part.largest:.4g} {unit}{most} at most, at t = {shown(part.time)}; it is at a limit at "
                f"{100 * part.at_limit:.3g} % of the samples (the log: {100 * part.log_at_limit:.3g} %), and "
                f"moves from what was applied at the sample before by {part.move:.4g} {unit}, root mean "
                f"square (the log: {part.log_move:.4g} {unit})"
                + self._same_way(part)
                + self._beyond(part)
                + "."
            )
        said.append(self._of_solves())
        if trace.diagnostics.get(WITHOUT_PAST) == 1.0:
            said.append(
                "Its answer in the middle of the log is the same without any past: it has no memory, or it "
                "does not take over a running plant, and answers as from rest."
            )
        if not trace.completed:
            said.append(f"It ended early: {trace.outcome}: {trace.reason}.")
        return (*said, SHOWS)

    def _same_way(self, part: Difference) -> str:
        if np.isnan(part.same_way):
            return ""
        return f"; where both move, they move the same way at {100 * part.same_way:.3g} % of the samples"

    def _beyond(self, part: Difference) -> str:
        return f"; the log is beyond the study's limits at {100 * part.beyond:.3g} %" if part.beyond else ""

    def _of_solves(self) -> str:
        """Return how many answers are fallbacks, where it first was clipped, and how long a step took."""
        trace = self.trace
        count, text = trace.decided, "No answer is a fallback"
        if failures := self.failures:
            reasons = "; ".join(f"{reason} ({number})" for reason, number in failures.items())
            text = f"{sum(failures.values())} of {count} answers are fallbacks: {reasons}"
            clipped = [k for k, status in enumerate(trace.status[:count]) if CLIPPED in status]
            if clipped:
                text += f"; first beyond its bounds at t = {shown(float(trace.time[clipped[0]]))}"
        if count:
            median, most_of, longest = np.quantile(1e3 * trace.solve_time[:count], [0.5, 0.95, 1.0])
            text += f". A step took {median:.3g} ms in the median, {most_of:.3g} ms at 95 %, "
            text += f"{longest:.3g} ms at most"
        return f"{text}."

    def table(self) -> Table:
        """Return the differences as a table, a row per input."""
        titles = ("median difference", "largest", "at", "at a limit", "log at a limit", "move", "log's move")
        headings = (*text_headings("input"), *map(Heading, titles), *text_headings("unit"))
        rows = []
        for part in self.differences() if self.trace.decided else ():
            figures = (part.median, part.largest, part.time, part.move, part.log_move)
            median, largest, time, move, log_move = (Cell(f"{value:.4g}", value) for value in figures)
            shares = (part.at_limit, part.log_at_limit)
            limit, log_limit = (Cell(f"{100 * share:.3g} %", share) for share in shares)
            cells = (median, largest, replace(time, text=shown(part.time)), limit, log_limit, move, log_move)
            rows.append(Row(part.input.name, (*cells, Cell(part.input.unit or "1"))))
        return Table("replay-table", f"{self.controller} beside {self.log}", headings, tuple(rows))

    def figures(self) -> dict[str, Any]:
        """Return differences, fallbacks and times of a step in plain values, in s and the inputs' units."""
        trace = self.trace
        inputs = {
            part.input.name: {"unit": part.input.unit}
            | {
                key: None if np.isnan(value) else value
                for key, value in part._asdict().items()
                if key != "input"
            }
            for part in (self.differences() if trace.decided else ())
        }
        times = trace.solve_time[: trace.decided]
        quantiles = np.quantile(times, [0.5, 0.95, 1.0]).tolist() if len(times) else []
        return {
            "log": self.log,
            "study": self.study,
            "controller": self.controller,
            "rows": self.rows,
            "answers": trace.decided,
            "outcome": trace.outcome.value,
            "reason": trace.reason,
            "inputs": inputs,
            "fallbacks": self.failures,
            "step_time": dict(zip(("median", "95 %", "largest"), quantiles, strict=False)),
            "notes": list(self.notes),
            "shows": SHOWS,
        }

    def columns(self) -> dict[str, FloatArray]:
        """Return the columns of :meth:`Trace.columns`, and the inputs of the log, each of shape (K,)."""
        logged = {
            f"{LOGGED} {variable.header}": self.applied[:, i] for i, variable in enumerate(self.trace.inputs)
        }
        return {**self.trace.columns(), **logged}

    def write_csv(self, path: str | Path) -> None:
        """Write the columns and the controller's status, one row per answered sample."""
        write_table(Path(path), self.columns(), {"status": self.trace.status})

    def frame(self) -> "pd.DataFrame":
        """Return the columns and the controller's status as a DataFrame."""
        import pandas as pd

        return pd.DataFrame({**self.columns(), "status": np.asarray(self.trace.status, dtype=object)})

    def plot(self) -> Picture:
        """Draw the outputs of the log, and the inputs of both over each other."""
        logged = replace(self.trace, u=self.applied, info={})
        return logged.plot(self.trace, labels=[LOGGED, self.controller])


def replay(
    log: str | Path,
    study: "Study | str | Path",
    controller: str,
    *,
    problem: str | None = None,
    scenario: str | None = None,
    seed: int | None = None,
    columns: Mapping[str, str] = NO_COLUMNS,
    start: float | None = None,
    sandbox: bool = False,
) -> Replay:
    """Return what a controller of a study would have done at each sample of a log, beside what was done.

    The outputs are those of the log. At every sample the controller begins anew with the log up to there as
    :attr:`Loop.past`, so that each answer is what it would do if it took over there. References, bands,
    limits and prices are those of the log where it has them, in columns named as in ``signals.csv``
    (``reference angle``, ``lower T``, ``min heating``, ``price electricity``), else the study's.

    Parameters
    ----------
    log : str or Path
        A CSV or Parquet file with a column for each input, measurement and known disturbance; row k has what
        was measured before its inputs were applied. Signals of results have this form.
    study : Study, str or Path
        The study, its file, or the name of a built-in one.
    controller : str
        The controller's name there.
    problem, scenario : str, optional
        Which of the study's; default: the only problem, the first scenario.
    seed : int, optional
        Of the experiment that the controller learns from; default: the study's first.
    columns : mapping of str to str
        Headers of columns that are not called as their signals; those of the study's ``recording.columns``
        hold as well.
    start : float, optional
        Time of the log's first row in the study [s]; default: its own, or, where it has dates, that of the
        study's first sample.
    sandbox : bool
        Whether it runs in a sandbox.

    Returns
    -------
    replay : Replay
        Its ``summary()`` says how far both differ, and what that can show.

    Raises
    ------
    ConfigError, DataError
        The study, or what is wrong with the log: missing columns, other times between rows, too few rows.
    CosimError
        There is not a single answer, and why.
    """
    resolved = study.resolved() if isinstance(study, Study) else read_study(str(study))
    result = run(
        resolved,
        Path(log),
        controller,
        Silent(),
        problem=problem,
        scenario=scenario,
        seed=seed,
        columns=columns,
        start=start,
        sandboxed=sandbox,
    )
    if not result.trace.decided:
        raise CosimError(f"{controller}: {result.trace.outcome}: {result.trace.reason}")
    return result


def run(
    resolved: ResolvedProblems,
    log: Path,
    controller: str,
    progress: Progress,
    *,
    problem: str | None = None,
    scenario: str | None = None,
    seed: int | None = None,
    columns: Mapping[str, str] = NO_COLUMNS,
    start: float | None = None,
    sandboxed: bool = False,
) -> Replay:
    """Replay a log in a worker; what ends it early is in the trace. Parameters as of :func:`replay`."""
    how = {"problem": problem, "scenario": scenario}
    case, single = single_case(resolved, controller, progress, **how, seed=seed, sandboxed=sandboxed)
    case, notes = prepare(log, case, recording=single.study.recording, columns=columns, start=start)
    trace = _run(case, progress.update)
    assert case.replayed is not None
    signals, first, _ = case.replayed
    u = signals.recording.u
    return Replay(
        log.name,
        resolved.head.name,
        controller,
        trace,
        u[first : first + len(trace)],
        u[first - 1],
        len(u),
        (*notes, *trace.warnings),
    )


def _run(case: Case, watch: Callable[[Update], None]) -> Trace:
    with ScratchFolder() as folder:
        for _ in run_cases([case], folder, 1, watch, sandboxed=bool(case.sandbox)):
            pass
        return load_case(folder / case.id).trace()
