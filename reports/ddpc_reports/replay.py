"""What a controller would have done beside a log, as a page in the manner of the report."""

from dataclasses import replace
from functools import partial

import numpy as np
from markupsafe import Markup

from ddpc_cosim import Replay
from ddpc_cosim.files.texts import clipped
from ddpc_reports.embedding import brought_to_life, pack
from ddpc_reports.figures.charts import dashes
from ddpc_reports.figures.clock import clock_for
from ddpc_reports.figures.figure import Entry, Figure, View
from ddpc_reports.figures.samples import levels
from ddpc_reports.figures.signal import Signal
from ddpc_reports.figures.still import still
from ddpc_reports.figures.time_charts import NARROW, time_chart
from ddpc_reports.numbers import given_time
from ddpc_reports.page import set_page
from ddpc_reports.sections import Section, StudyPart

_LOG, _CONTROLLER = "c0", "c1"
_SIZE = NARROW, 200


def replay_page(replay: Replay) -> str:
    """Return the page: what is to be said, the figures of each input, and the signals over time."""
    trace, signals = replay.trace, _signals(replay)
    lines = (_LOG, "log"), (_CONTROLLER, clipped(replay.controller))
    figure = Figure(
        "replay",
        "Signals",
        "Inputs of the log and of the controller, and the outputs of the log, over time.",
        tuple(_view(replay, signal) for signal in signals),
        tuple(Entry(name, label, i, dashes(i), "") for i, (name, label) in enumerate(lines)),
    )
    sections = [
        Section("answer", "What it would have done", [("notes", list(replay.summary()))]),
        Section("inputs", "Inputs", [("table", replace(replay.table(), id="s1-inputs-table"))]),
        Section("figures", "Figures", [("figure", (figure, "replay"))] if signals else []),
        Section("notes", "Notes", [("notes", list(replay.notes))] if replay.notes else []),
    ]
    ended = [] if trace.completed else [f"{trace.outcome}: {trace.reason}"]
    facts = {
        "Study": replay.study,
        "Samples": f"{trace.decided} answered of {replay.rows} rows",
        "Sampling time": given_time(trace.sampling_time),
    }
    title = f"{replay.controller} beside {replay.log}"
    shown = [section for section in sections if section.blocks]
    part = StudyPart("s1-", 1, title, ended, facts, Markup(""), [], shown)
    data = {signal.id: {name: pack(column) for name, column in signal.columns.items()} for signal in signals}
    return set_page([part], data)


def _signals(replay: Replay) -> list[Signal]:
    """Return outputs and inputs; both runs have the same outputs."""
    trace = replay.trace
    if not len(trace):
        return []
    logged = replace(trace, u=replay.applied, info={})
    clock = clock_for(float(trace.time[0]), float(np.ptp(trace.time)))
    labels = {_LOG: "log", _CONTROLLER: clipped(replay.controller)}
    return levels({_LOG: logged, _CONTROLLER: trace}, labels, clock, "x")


def _view(replay: Replay, signal: Signal) -> View:
    names = (_LOG, _CONTROLLER)
    spec = time_chart(signal, names, replay.trace.sampling_time, (), _SIZE)
    description = f"{signal.title} over time"
    draw = partial(still, signal, names, (), _SIZE, description)
    picture = brought_to_life(draw, spec, description)
    place = f"replay-{signal.id}"
    return View(
        place, "", description, spec, picture, signal.id, names, signal.unit, names, time=signal.clock.unit
    )
