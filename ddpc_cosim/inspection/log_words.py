"""What is found in a log in words: whether it is good enough, for what, and which experiment to make next."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ddpc_cosim.files.durations import about, shown
from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.inspection.columns import ColumnFacts, SamplingFacts
from ddpc_cosim.inspection.predictions import Predictions
from ddpc_cosim.inspection.relations import Pair, Relations
from ddpc_cosim.plugins import installed
from ddpc_cosim.settings import declared_settings
from ddpc_cosim.windows import FAIR

_SURE = 0.2
"""Half of a gain's interval, in parts of the gain: a gain is known well enough up to here."""
_MORE_SAMPLES = 3.0  # than order of excitation alone asks for
_ANSWERS = 10  # of the plant, that an experiment is long
_SAMPLES_OF_ANSWER = (4, 100)
_DITHER = 0.5  # of an input's deviation
_MOST_LISTED = 3
_ROUNDED = 7200.0  # s: longer times are told roughly
_CODES = {-999.0, -9999.0, -99999.0, 9999.0, 99999.0}  # that loggers write for a value that is not there
_SHOWN_STEPS = (1, 2, 3, 5, 10, 15, 20, 30, 40)


@dataclass(frozen=True, slots=True)
class Evidence:
    """All that is found in a log.

    Parameters
    ----------
    columns : tuple of ColumnFacts
        The columns, those without a role too.
    sampling : SamplingFacts
        How rows follow each other.
    order, order_needed : int
        Order of persistency of excitation of inputs and known disturbances, and that for the horizon tested.
    order_limit : int
        The highest order that was looked for.
    relations : Relations
        How signals act on each other.
    predictions : Predictions
        How far ahead methods predict.
    horizon : int
        How many samples ahead was tested.
    knows_excitation : bool
        Whether the data have what moved the inputs from outside, beside a controller.
    """

    columns: tuple[ColumnFacts, ...]
    sampling: SamplingFacts
    order: int
    order_needed: int
    order_limit: int
    relations: Relations
    predictions: Predictions
    horizon: int
    knows_excitation: bool = False

    def of_role(self, role: str) -> list[ColumnFacts]:
        """Return the columns of a role."""
        return [column for column in self.columns if column.role == role]

    def time_of(self, samples: float) -> str:
        """Return how long so many samples take; empty where the log has no times."""
        seconds = samples * self.sampling.sampling_time
        if not math.isfinite(seconds):
            return ""
        return shown(seconds) if seconds < _ROUNDED else about(seconds)

    def in_time(self, samples: int) -> str:
        """Return a number of samples, and how long they take."""
        time = self.time_of(samples)
        return f"{samples} sample{'s' * (samples != 1)}" + (f" ({time})" if time else "")

    @property
    def good_up_to(self) -> int:
        """Up to how many samples ahead the best method is good; 0 if none is."""
        best = self.predictions.best
        return self.predictions.good_up_to(best) if best else 0

    @property
    def closed_inputs(self) -> list[str]:
        """The inputs that were driven by what the outputs did before."""
        return [feedback.input for feedback in self.relations.feedback if feedback.is_closed]


def verdict(evidence: Evidence) -> tuple[bool, str, tuple[str, ...]]:
    """Return whether a log is good enough, that in a sentence, and what speaks against it."""
    against = [*_hindrances(evidence)]
    reservations = tuple(_reservations(evidence))
    if against:
        return False, f"Not good enough for predictive control: {'; '.join(against)}.", reservations
    n, best = evidence.good_up_to, evidence.predictions.best
    beyond = "; no further was tested" if n == evidence.horizon else ""
    with_method = f" (best: {best.name})" if best else ""
    text = f"Good enough for predictive control with a horizon of up to {evidence.in_time(n)}"
    return True, text + with_method + beyond + (", with reservations." if reservations else "."), reservations


def _hindrances(evidence: Evidence) -> Iterator[str]:
    """Yield why no predictive controller can be made of a log."""
    inputs, outputs = evidence.of_role("input"), evidence.of_role("output")
    for kind, columns in (("input", inputs), ("output", outputs)):
        if not columns:
            yield f"no {kind} is known; name it by --{kind}"
        for still in (column for column in columns if column.constant):
            yield (
                f'the {kind} "{still.name}" stands still'
                if not still.empty
                else f'the {kind} "{still.name}" is empty'
            )
    if not inputs or not outputs or all(c.constant for c in inputs) or all(c.constant for c in outputs):
        return
    relations = evidence.relations
    if not relations.pairs:
        sampling = evidence.sampling
        if sampling.backwards:
            what = f"{sampling.backwards} of its {sampling.rows} rows are earlier than the row before"
            yield f"{what}, and no stretch between them is long enough"
        else:
            yield f"it is too short: {sampling.rows} rows"
        return
    acting = [pair for pair in relations.pairs if pair.acts]
    for column in inputs:
        if not column.constant and not any(pair.input == column.name for pair in acting):
            yield f'no output answers the input "{column.name}" beyond chance'
    for column in outputs:
        if not column.constant and not any(pair.output == column.name for pair in acting):
            yield f'the output "{column.name}" answers no input beyond chance'
    if not evidence.predictions.methods or not any(m.errors for m in evidence.predictions.methods):
        yield "no method can be fitted to it"
    elif (n := evidence.good_up_to) < (needed := _horizon_needed(acting)):
        what = f"good up to {evidence.in_time(n)} only" if n else "not good one sample ahead"
        why = f", and the dead time is {evidence.in_time(needed - 1)}" if needed > 2 else ""
        yield f"predictions are {what}{why}"


def _horizon_needed(acting: Sequence[Pair]) -> int:
    """Return the shortest horizon within which an input shows."""
    return 1 + max((pair.dead_time for pair in acting), default=1)


def _reservations(evidence: Evidence) -> Iterator[str]:
    """Yield what is not as it should be, and what it biases."""
    if closed := evidence.closed_inputs:
        worst = min((f for f in evidence.relations.feedback if f.is_closed), key=lambda f: f.chance)
        from_ = f" from {_listed(worst.outputs)}" if worst.outputs else ""
        yield (
            f"recorded in closed loop: past outputs say what {_listed(closed)} did next{from_} (they explain "
            f"{100 * worst.share:.0f} % of what its own past leaves open; by chance with probability "
            f"{_chance(worst.chance)}), or both follow something that is not in the log. What this biases: a "
            "method that predicts from windows of samples (DeePC, SPC and their kin) takes the noise that "
            "the controller answered for an effect of the input, the more so the more noise there is, and "
            "its errors here do not show it, as the samples held out are of the same loop; gains and dead "
            "times here, and models fitted one step ahead, are free of that as far as the model fits"
        )
    for column in evidence.columns:
        if not column.role:
            continue
        signal = f'the {column.role} "{column.name}"'
        for value in {column.minimum, column.maximum} & _CODES:
            yield (
                f"{signal} goes to {value:g}, which loggers write where they have no value; if it is that, "
                f"say missing_values = [{value:g}]"
            )
        if column.stuck:
            longest = max(column.stuck, key=lambda stretch: stretch.samples)
            times = f"{len(column.stuck)} times, the longest" if len(column.stuck) > 1 else "once,"
            yield (
                f"{signal} is stuck {times} at {_value(longest.value, column)} for "
                f"{evidence.in_time(longest.samples)} from row {longest.first + 1} on"
            )
        for share, value in ((column.low, column.minimum), (column.high, column.maximum)):
            if share:
                yield (
                    f"{signal} is at its limit of {_value(value, column)} for {100 * share:.1f} % of the "
                    "samples"
                )
        if column.is_coarse:
            part = 100 * column.step / column.deviation
            yield (
                f"{signal} is coarse: it has steps of {_value(column.step, column)}, {part:.0f} % of its "
                "standard deviation"
            )
        if column.missing and not column.empty:
            values = f"{column.missing} value{'s' * (column.missing > 1)}"
            yield f"{signal} misses {values}, the first in row {column.first_missing + 1}"
    sampling = evidence.sampling
    if sampling.gaps:
        yield (
            f"{sampling.missing_rows} rows are missing in {sampling.gaps} "
            f"gap{'s' * (sampling.gaps > 1)}, the longest of {about(sampling.longest_gap)}; nothing "
            "is learned across them"
        )
    if sampling.duplicates:
        first = sampling.first_duplicate + 1
        yield f"{sampling.duplicates} rows have the time of the row before, the first is row {first}"
    if sampling.backwards:
        yield f"{sampling.backwards} rows are earlier than the row before"
    if math.isfinite(sampling.jitter / sampling.sampling_time) and not sampling.is_even:
        part = 100 * sampling.jitter / sampling.sampling_time
        yield f"rows are unevenly apart: the time between them varies by {part:.2g} % (root mean square)"
    if evidence.order < min(evidence.order_needed, evidence.order_limit) and evidence.relations.pairs:
        yield (
            f"inputs are persistently exciting of order {evidence.order}; DeePC with a horizon of "
            f"{evidence.horizon} needs {evidence.order_needed}"
        )


def advice(evidence: Evidence) -> tuple[str, ...]:
    """Return which experiment to make next, and what to do with the data there are."""
    return tuple(_advice(evidence))


def _advice(evidence: Evidence) -> Iterator[str]:
    inputs = [column for column in evidence.of_role("input") if not column.empty]
    relations = evidence.relations
    if not relations.pairs and not any(c.constant for c in inputs):
        return
    hold = max(1, round(relations.answer / 5)) if relations.answer else 1
    length = math.ceil(
        max(_MORE_SAMPLES * evidence.order_needed * (len(inputs) + 1), _ANSWERS * relations.answer)
    )
    pairs = {
        column.name: [pair for pair in relations.pairs if pair.input == column.name] for column in inputs
    }
    for column in inputs:
        if column.constant:
            yield (
                f'move "{column.name}", which stands still: switch it at random between two levels, held for '
                f"{evidence.in_time(hold)} at least"
            )
        elif not any(pair.acts for pair in pairs[column.name]):
            yield (
                f'move "{column.name}" further or more often: it moved {column.moves} times, by '
                f"{_value(column.deviation, column)} (root mean square about its mean), and no output "
                "answered"
            )
    if vague := [pair for pair in relations.pairs if pair.acts and _uncertainty(pair) > _SURE]:
        pair = max(vague, key=_uncertainty)
        size = _uncertainty(pair)
        what = f"the gain {pair.input} -> {pair.output}"
        if math.isfinite(size):
            times = (size / _SURE) ** 2
            yield (
                f"{what} is known within {100 * size:.0f} %: to know it within {100 * _SURE:.0f} %, record "
                f"{times:.1f} times as long, or move {pair.input} {math.sqrt(times):.1f} times as far"
            )
        else:
            yield (
                f"{what} has no end to its interval: {pair.output} does not settle within what was recorded; "
                f"hold {pair.input} longer, or control it as one that integrates"
            )
    if length and _hindrances_of_content(evidence):
        yield (
            f"record at least {evidence.in_time(length)}, every input switched at random between two levels, "
            f"each by itself, held for {evidence.in_time(hold)} at least"
        )
    if closed := evidence.closed_inputs:
        sizes = ", ".join(
            f"{_DITHER * column.deviation:.3g} {column.unit}".strip() + f" to {column.name}"
            for column in inputs
            if column.name in closed
        )
        yield (
            f"where the loop has to stay closed, add a random two-level signal to what the controller sets: "
            f"plus or minus {sizes} (half of what it moves by now), held for {evidence.in_time(hold)}"
        )
        yield _instruments(evidence.knows_excitation)
    low, high = _SAMPLES_OF_ANSWER
    answer = relations.answer
    if answer > high and (time := evidence.time_of(answer / 20)):
        yield (
            f"sample more slowly: the outputs take {evidence.in_time(answer)} to settle; --sampling-time of "
            f"about {time} gives 20 samples for it"
        )
    elif 0 < answer < low:
        yield f"sample faster: the outputs have settled after {evidence.in_time(answer)}"


def _hindrances_of_content(evidence: Evidence) -> bool:
    return (
        bool([*_hindrances(evidence)])
        and bool(evidence.of_role("input"))
        and bool(evidence.of_role("output"))
    )


def _instruments(knows_excitation: bool) -> str:
    """Return how controllers use data of a closed loop, as far as those that are installed can."""
    used = "excitation" if knows_excitation else "closed-loop"
    choices = {
        plugin.name: setting.choices
        for plugin in installed("controllers")
        if isinstance(plugin.value, type) and (setting := declared_settings(plugin.value).get("instruments"))
    }
    names = [f'"{name}"' for name, allowed in choices.items() if used in allowed]
    if not names:
        return "on these data compare with instrumental variables, or with a model fitted one step ahead"
    advice = (
        f"compare with instrumental variables on these data: type = {' or '.join(names)} with "
        f'settings.instruments = "{used}"'
    )
    if knows_excitation:
        return advice
    return (
        f"{advice}; where columns have what was added to the inputs, or the setpoints, name them in "
        'recording.excitation_columns and use "excitation"'
    )


def _uncertainty(pair: Pair) -> float:
    """Return half of a gain's interval in parts of the gain."""
    return (pair.high - pair.low) / 2 / abs(pair.gain) if pair.settles and pair.gain else math.inf


def tables(evidence: Evidence) -> tuple[Table, ...]:
    """Return all that is found as tables, those that are empty left out."""
    every = (
        _columns(evidence),
        _movement(evidence),
        _pairs(evidence),
        _feedback(evidence),
        _predictions(evidence),
    )
    return tuple(table for table in every if table.rows)


def _columns(evidence: Evidence) -> Table:
    headings = (
        Heading("signal", numeric=False),
        Heading("role", numeric=False),
        Heading("unit", numeric=False),
        *map(Heading, ("min", "mean", "max", "std. deviation", "missing")),
        Heading("step"),
        Heading("what stands out", numeric=False, wraps=True),
    )
    rows = []
    for column in evidence.columns:
        figures = (column.minimum, column.mean, column.maximum, column.deviation)
        numbers = tuple(Cell(f"{value:.4g}" if math.isfinite(value) else "", value) for value in figures)
        cells = (
            Cell(column.role or "-"),
            Cell(column.unit or "1"),
            *numbers,
            Cell(str(column.missing) if column.missing else "", column.missing),
            Cell(f"{column.step:.3g}" if column.step else "", column.step),
            Cell("; ".join(_marks(column))),
        )
        rows.append(Row(column.name, cells))
    return Table("columns", "Columns", headings, tuple(rows))


def _marks(column: ColumnFacts) -> Iterator[str]:
    if column.empty:
        yield "empty"
    elif column.constant:
        yield "constant"
    if column.stuck:
        rows = sum(stretch.samples for stretch in column.stuck)
        yield f"stuck for {rows} rows, first from row {min(s.first for s in column.stuck) + 1} on"
    if column.low or column.high:
        ends = " and ".join(n for n, share in (("low", column.low), ("high", column.high)) if share)
        yield (
            f"at its {ends} limit for {100 * (column.low + column.high):.1f} %, first in row "
            f"{column.first_at_limit + 1}"
        )
    if column.is_coarse:
        yield "coarse"


def _movement(evidence: Evidence) -> Table:
    headings = (
        Heading("input", numeric=False),
        Heading("moves"),
        Heading("every", "in the mean"),
        Heading("from"),
        Heading("to"),
        Heading("std. deviation"),
        Heading("unit", numeric=False),
    )
    rows = tuple(
        Row(
            column.name,
            (
                Cell(str(column.moves), column.moves),
                Cell(
                    evidence.in_time(round(evidence.sampling.rows / column.moves))
                    if column.moves
                    else "never"
                ),
                Cell(f"{column.minimum:.4g}", column.minimum),
                Cell(f"{column.maximum:.4g}", column.maximum),
                Cell(f"{column.deviation:.3g}", column.deviation),
                Cell(column.unit or "1"),
            ),
        )
        for column in (*evidence.of_role("input"), *evidence.of_role("disturbance"))
    )
    least = " at least" if evidence.order and evidence.order == evidence.order_limit else ""
    note = (
        f"A move is a change from one row to the next by more than 1 % of the range. Together they are "
        f"persistently exciting of order {evidence.order}{least}; DeePC with a horizon of "
        f"{evidence.horizon} needs {evidence.order_needed}."
    )
    return Table("movement", "How often and how far inputs moved", headings, rows, (note,))


def _pairs(evidence: Evidence) -> Table:
    units = {column.name: column.unit or "1" for column in evidence.columns}
    headings = (
        Heading("input", numeric=False),
        Heading("output", numeric=False),
        Heading("dead time", "samples"),
        Heading("95 % interval", "samples"),
        Heading("dead time", "as time"),
        Heading("gain"),
        Heading("95 % interval"),
        Heading("unit", numeric=False),
        Heading("by chance", "probability"),
    )
    rows = []
    for pair in evidence.relations.pairs:
        gain = (
            (f"{pair.gain:.4g}", f"{pair.low:.4g} to {pair.high:.4g}")
            if pair.settles
            else ("-", "does not settle" if pair.acts else "none to be seen")
        )
        delay = (str(pair.dead_time), f"{pair.earliest} to {pair.latest}", evidence.time_of(pair.dead_time))
        shown = delay if pair.acts else ("-", "", "")
        of_gain = gain if pair.acts or pair.settles else ("-", "none to be seen")
        unit = f"{units[pair.output]}/({units[pair.input]})"
        cells = (pair.output, *shown, *of_gain, unit, _chance(pair.chance))
        rows.append(Row(pair.input, tuple(map(Cell, cells))))
    note = (
        f"Least-squares ARX models of order {evidence.relations.order} at most, from "
        f"{evidence.relations.samples} samples."
    )
    return Table("pairs", "What answers what", headings, tuple(rows), (note,))


def _feedback(evidence: Evidence) -> Table:
    headings = (
        Heading("input", numeric=False),
        Heading("loop", numeric=False),
        Heading("outputs explain", "% of what its own past leaves open"),
        Heading("by chance", "probability"),
        Heading("from", numeric=False),
    )
    rows = tuple(
        Row(
            feedback.input,
            (
                Cell("closed" if feedback.is_closed else "no sign of feedback"),
                Cell(f"{100 * feedback.share:.1f}", feedback.share),
                Cell(_chance(feedback.chance), feedback.chance),
                Cell(", ".join(feedback.outputs)),
            ),
        )
        for feedback in evidence.relations.feedback
    )
    note = (
        "Whether outputs up to a sample explain its input beyond past inputs and known disturbances "
        "(F-test). Closed: less probable than 1 % by chance, and 2 % explained at least."
    )
    return Table("feedback", "Closed loop or open", headings, rows, (note,))


def _predictions(evidence: Evidence) -> Table:
    predictions = evidence.predictions
    steps = [k for k in _SHOWN_STEPS if k <= len(predictions.hold)]
    headings = (
        Heading("method", numeric=False),
        Heading("good up to", "samples"),
        *(Heading(f"{k}", evidence.time_of(k), group="samples ahead") for k in steps),
        Heading("why not", numeric=False, wraps=True),
    )

    def cells(errors: Sequence[float]) -> list[Cell]:
        return [
            Cell(
                f"{errors[k - 1]:.3f}" if k <= len(errors) else "", errors[k - 1] if k <= len(errors) else ""
            )
            for k in steps
        ]

    rows = []
    for method in predictions.methods:
        n = predictions.good_up_to(method)
        good = Cell(str(n), n, best=method == predictions.best) if method.errors else Cell("-")
        rows.append(Row(method.name, (good, *cells(method.errors), Cell(method.reason)), method.name))
    for name, errors in (("last value held", predictions.hold), ("mean", predictions.mean)):
        if errors:
            rows.append(Row(name, (Cell(""), *cells(errors), Cell(""))))
    notes = (
        "Root mean square errors on the last quarter of the samples used, held out, in parts of the standard "
        "deviation of the output that is predicted worst. Good: no more than "
        f"{FAIR:g}, and at the end of the horizon less than if the last value is held.",
        f"From {predictions.samples} samples; settings are the methods' defaults, but for the past, which is "
        f"{predictions.memory} samples at least.",
    )
    return Table("predictions", "How far ahead methods predict", headings, tuple(rows), notes)


def _value(value: float, column: ColumnFacts) -> str:
    return f"{value:.4g} {column.unit}".strip()


def _chance(chance: float) -> str:
    return "< 0.0001" if chance < 1e-4 else f"{chance:.2g}"


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_LISTED
    shown = ", ".join(f'"{name}"' for name in names[:_MOST_LISTED])
    return shown + (f" and {more} more" if more > 0 else "")
