"""What logged data are good for: what is in them, how signals act on each other, how far ahead they predict.

Columns are looked at in all rows; models are fitted to a part of long logs, spread over all of it.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.files.tables import Table
from ddpc_cosim.inspection.columns import ColumnFacts, SamplingFacts, column_facts
from ddpc_cosim.inspection.log_words import Evidence, advice, tables, verdict
from ddpc_cosim.inspection.predictions import Predictions, predictions
from ddpc_cosim.inspection.relations import Relations, relations
from ddpc_cosim.variables import FloatArray, Variable
from ddpc_cosim.windows import persistency_of_excitation

_HORIZONS = (10, 40)
_USUAL_MEMORY = 3
_LONGEST_MEMORY = 12
_LARGEST_HANKEL = 200
# Of a part: the most samples, and the most work, as samples times regressors squared.
_MOST_SAMPLES, _MOST_WORK = 20_000, {"relations": 4e9, "predictions": 3e8}
_FEWEST_PER_REGRESSOR = 4
_STRETCHES = 8
_LAGS = 49


@dataclass(frozen=True, slots=True, eq=False)
class LogSummary:
    """What logged data are good for.

    Parameters
    ----------
    title : str
        What the data are.
    good : bool
        Whether they are good enough for predictive control.
    verdict : str
        That in a sentence, and for what, or why not.
    reservations : tuple of str
        What is not as it should be, and what it biases.
    advice : tuple of str
        Which experiment to make next, and what to do with the data there are.
    notes : tuple of str
        What the summary rests on: roles that were guessed, what was done to the rows, which part was used.
    evidence : Evidence
        All figures.
    """

    title: str
    good: bool
    verdict: str
    reservations: tuple[str, ...]
    advice: tuple[str, ...]
    notes: tuple[str, ...]
    evidence: Evidence

    @property
    def tables(self) -> tuple[Table, ...]:
        """All figures as tables."""
        return tables(self.evidence)

    @property
    def facts(self) -> dict[str, str]:
        """Rows, sampling and order of excitation, in a few words each."""
        sampling, evidence = self.evidence.sampling, self.evidence
        facts = {"rows": f"{sampling.rows}"}
        if math.isfinite(sampling.sampling_time):
            jitter = "even" if sampling.is_even else f"jitter {sampling.jitter:.3g} s (root mean square)"
            facts["sampling"] = f"every {sampling.sampling_time:.9g} s in the median, {jitter}"
            facts["length"] = evidence.time_of(sampling.rows + sampling.missing_rows)
            facts["gaps"] = (
                f"{sampling.gaps}, {sampling.missing_rows} rows missing" if sampling.gaps else "none"
            )
            facts["duplicates"] = str(sampling.duplicates) if sampling.duplicates else "none"
        if evidence.relations.pairs:
            least = " at least" if evidence.order == evidence.order_limit else ""
            facts["excitation"] = f"persistent of order {evidence.order}{least}"
        if evidence.relations.answer:
            facts["settles"] = (
                f"within {evidence.in_time(evidence.relations.answer)} (95 % of the slowest response)"
            )
        return facts

    def as_data(self) -> dict[str, Any]:
        """Return everything in plain values, None for what is not known or not finite."""
        figures = asdict(self.evidence)
        good = {m.name: self.evidence.predictions.good_up_to(m) for m in self.evidence.predictions.methods}
        data = {
            "title": self.title,
            "good": self.good,
            "verdict": self.verdict,
            "good_up_to": self.evidence.good_up_to,
            "closed_loop": bool(self.evidence.closed_inputs),
            "reservations": self.reservations,
            "advice": self.advice,
            "notes": self.notes,
            **figures,
            "good_up_to_by_method": good,
        }
        return dict(_plain(data).items())

    def __repr__(self) -> str:
        lines = [self.title, self.verdict]
        lines += [f"- {text}" for text in self.reservations]
        lines += [f"next: {text}" for text in self.advice]
        lines += [f"{name}: {fact}" for name, fact in self.facts.items()]
        lines += [f"note: {text}" for text in self.notes]
        return "\n".join([*lines, *(f"\n{table.text}" for table in self.tables)])

    def _repr_html_(self) -> str:
        import html

        said = [self.verdict, *self.reservations, *self.advice]
        return "".join([*(f"<p>{html.escape(text)}</p>" for text in said), *(t.html for t in self.tables)])


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def summary_of(
    recording: Any,
    inputs: Sequence[Variable | str] = (),
    outputs: Sequence[Variable | str] = (),
    disturbances: Sequence[Variable | str] = (),
) -> LogSummary:
    """Return what a recording is good for.

    Parameters
    ----------
    recording : Recording
        The experiment.
    inputs, outputs, disturbances : sequence of Variable or str
        Names and units of its signals; default: u1, u2, ..., y1, ... and d1, ...
    """
    kinds = (
        ("input", "u", inputs, recording.u),
        ("output", "y", outputs, recording.y),
        ("disturbance", "d", disturbances, recording.d),
    )
    columns = list[ColumnFacts]()
    for role, letter, signals, values in kinds:
        named = [*signals] or [f"{letter}{i + 1}" for i in range(values.shape[1])]
        for signal, column in zip(named, values.T, strict=True):
            name, unit = (signal, "") if isinstance(signal, str) else (signal.name, signal.unit)
            columns.append(column_facts(name, unit, role, column))
    sampling = SamplingFacts(len(recording), recording.sampling_time)
    title = f"recording of {len(recording)} samples"
    if recording.seams:
        title += f" in {len(recording.seams) + 1} pieces"
    return summarise(title, recording, columns, sampling)


def summarise(
    title: str,
    recording: Any | None,
    columns: Sequence[ColumnFacts],
    sampling: SamplingFacts,
    notes: Sequence[str] = (),
) -> LogSummary:
    """Return what logged data are good for.

    Parameters
    ----------
    title : str
        What the data are.
    recording : Recording or None
        Their rows without missing cells; None: there are none, or no inputs or outputs are known.
    columns : sequence of ColumnFacts
        What the columns hold; those with a role are the recording's signals, in its order.
    sampling : SamplingFacts
        How rows follow each other.
    notes : sequence of str
        What to know of how the data were read.
    """
    notes = [*notes]
    order, limit, needed, horizon = 0, 0, 0, _HORIZONS[0]
    interactions, ahead = Relations(), Predictions()
    if recording is not None:
        names = [[c.name for c in columns if c.role == role] for role in ("input", "output")]
        signals = recording.u.shape[1] + recording.y.shape[1] + recording.d.shape[1]
        part = part_of(recording, _LAGS * signals, "relations")
        interactions = relations(part.u, part.y, part.d, (names[0], names[1]), part.seams)
        low, high = _HORIZONS
        horizon = min(max(interactions.answer or high // 2, low), high)
        horizon = max(min(horizon, len(recording) // 20), 1)
        dead_time = max((pair.dead_time for pair in interactions.pairs if pair.acts), default=1)
        memory = min(max(_USUAL_MEMORY, dead_time + interactions.order - 1), _LONGEST_MEMORY)
        moved = np.hstack([part.u, part.d[:, np.ptp(part.d, axis=0) > 0.0]])
        needed = memory + horizon + memory * recording.y.shape[1]
        limit = max(_LARGEST_HANKEL // moved.shape[1], needed)
        order = persistency_of_excitation(moved, limit, part.seams)
        part = part_of(recording, (memory + horizon) * signals, "predictions")
        still = any(bool((np.ptp(values, axis=0) == 0.0).any()) for values in (part.u, part.y))
        if interactions.pairs and not still:
            ahead = predictions(part, horizon, memory)
        if len(part) < len(recording):
            notes.append(
                f"gains and feedback rest on {interactions.samples}, predictions on {ahead.samples} of "
                f"{len(recording)} samples, in {_STRETCHES} stretches spread over all of them; columns on "
                "all rows"
            )
    knows = recording is not None and recording.excitation.shape[1] >= recording.u.shape[1]
    evidence = Evidence(tuple(columns), sampling, order, needed, limit, interactions, ahead, horizon, knows)
    good, text, reservations = verdict(evidence)
    return LogSummary(title, good, text, reservations, advice(evidence), tuple(notes), evidence)


def part_of(recording: Any, regressors: int, purpose: str) -> Any:
    """Return a recording, or of a long one stretches that are spread over all of it.

    Parameters
    ----------
    recording : Recording
        The experiment.
    regressors : int
        How many columns of samples a model has.
    purpose : {"relations", "predictions"}
        What it is for.
    """
    most = int(min(_MOST_SAMPLES, _MOST_WORK[purpose] / regressors**2))
    most = max(most, _FEWEST_PER_REGRESSOR * regressors)
    if len(recording) <= most:
        return recording
    length = most // _STRETCHES
    starts = np.linspace(0, len(recording) - length, _STRETCHES).astype(np.intp)
    rows: NDArray[np.intp] = (starts[:, np.newaxis] + np.arange(length)).ravel()
    inner = np.searchsorted(rows, recording.seams) if recording.seams else np.empty(0, dtype=np.intp)
    seams = {*(length * np.arange(1, _STRETCHES)).tolist(), *inner.tolist()}
    values: dict[str, FloatArray] = {
        name: getattr(recording, name)[rows] for name in ("u", "y", "measured", "d", "excitation")
    }
    return replace(recording, **values, seams=tuple(sorted(seam for seam in seams if 0 < seam < len(rows))))
