"""On what terms the controllers are compared: what each sees, uses, may do, knows and was tuned on."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from markupsafe import Markup

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.study.file_format.sections import TunedSection
from ddpc_reports.comparison import Condition, ControllerResults
from ddpc_reports.numbers import as_given, computed, with_unit
from ddpc_reports.tables.settings import compact_seeds, limits_texts, mapping_text
from ddpc_reports.verdict import Statement, counted, join_words, names


class _Fact(NamedTuple):
    """What is said of one controller, and of several; empty: it is not known."""

    of_one: str
    of_several: str


_Telling = Callable[[ControllerResults, Trace | None], _Fact]
"""What is said of a controller, given its run at the first seed, if that has any samples."""
_NOT_KNOWN = _Fact("", "")
_LOST = (Outcome.CRASHED, Outcome.TIMED_OUT)
"""Of runs that ended so there are the samples alone: that nothing was noted says nothing."""
_PLANT_FMU = "{plant}"
"""What a setting says in a study that is the path of a file, for the FMU that the study controls."""


def fairness_statements(results: StudyResults, conditions: Sequence[Condition]) -> list[Statement]:
    """Return the terms of the comparison, as the study sets them and as its first seed was run.

    Of controllers that do not tell a fact, it is said that it is not known.
    """
    if not conditions or not conditions[0].controllers:
        return []
    first = conditions[0]
    return [
        *_by_scenario("Preview", conditions, _preview),
        Statement("Measurements", _measurements(first)),
        Statement("Limits", _limits(first)),
        *_by_scenario("Recording", conditions, _recording),
        Statement("Prior knowledge", _prior_knowledge(results, first)),
        Statement("Tuning", _tuning(results, first)),
    ]


def _by_scenario(
    topic: str, conditions: Sequence[Condition], text_of: Callable[[Condition], Markup]
) -> list[Statement]:
    """State what may differ from scenario to scenario, once for those that are alike."""
    said: dict[Markup, list[Markup]] = {}
    for condition in conditions:
        said.setdefault(text_of(condition), []).append(Markup("<i>{}</i>").format(condition.label))
    if len(said) == 1:
        return [Statement(topic, next(iter(said)))]
    return [
        Statement(topic, Markup("In {}: {}").format(join_words(labels), text))
        for text, labels in said.items()
    ]


def _preview(condition: Condition) -> Markup:
    return _sentence(condition, _seen, "how far ahead the reference was seen")


def _seen(one: ControllerResults, trace: Trace | None) -> _Fact:
    if trace is None:
        return _NOT_KNOWN
    if not trace.preview:
        if trace.outcome in _LOST:
            return _NOT_KNOWN
        return _Fact("sees no future reference", "see no future reference")
    ahead = as_given(computed(trace.preview * trace.sampling_time))
    what = f"{counted(trace.preview, 'sample')} of the future reference ({with_unit(ahead, 's')})"
    return _Fact(f"sees {what}", f"see {what}")


def _measurements(first: Condition) -> Markup:
    handed = Markup("")
    for trace in first.first_traces.values():
        signals = join_words([variable.name for variable in trace.measurements])
        handed = Markup("Measured for every controller: {}. ").format(signals)
    return handed + _sentence(first, _used, "which of them are used")


def _used(one: ControllerResults, trace: Trace | None) -> _Fact:
    told = trace.knowledge.get("measures", "") if trace else ""
    return _Fact(f"uses {told}", f"use {told}") if told else _NOT_KNOWN


def _limits(first: Condition) -> Markup:
    traces = list(first.first_traces.values())
    if not traces:
        return Markup("No run tells the limits.")

    def limits(signal: int, one: ControllerResults, trace: Trace | None) -> _Fact:
        told = limits_texts(trace)[signal] if trace else ""
        return _Fact(f"has {told}", f"have {told}") if told else _NOT_KNOWN

    signals = [variable.name for variable in (*traces[0].inputs, *traces[0].outputs)]
    differing = [
        Markup("Limits of {} differ: {}").format(
            name, _sentence(first, partial(limits, i), f"what limits of {name} held")
        )
        for i, name in enumerate(signals)
        if len({limits_texts(trace)[i] for trace in traces}) > 1
    ]
    return Markup(" ").join(differing) or Markup("The limits of inputs and outputs are the same for all.")


def _recording(condition: Condition) -> Markup:
    study = condition.results.study
    text = _sentence(condition, _learned, "whether a recording was learned from")
    if study.recording is None:
        return text
    if stabiliser := study.recording.controller:
        settings = f" with {mapping_text(stabiliser.settings)}" if stabiliser.settings else ""
        text += Markup(
            " While it was recorded, the plant was kept by a stabilising controller that the study gives, "
            "{}{}: whoever learns from the recording rests on that too."
        ).format(stabiliser.type, settings)
    if study.loop.start == "recording-end":
        text += " Every loop starts where its recording ended."
    return text


def _learned(one: ControllerResults, trace: Trace | None) -> _Fact:
    if trace is None:
        return _NOT_KNOWN
    if not trace.recorded_samples:
        if trace.outcome in _LOST:
            return _NOT_KNOWN
        return _Fact("asks for no recording", "ask for no recording")
    what = f"from a recording of {counted(trace.recorded_samples, 'sample')}"
    return _Fact(f"learns {what}", f"learn {what}")


def _prior_knowledge(results: StudyResults, first: Condition) -> Markup:
    return _sentence(first, partial(_told, results), "what was told beforehand of the plant")


def _told(results: StudyResults, one: ControllerResults, trace: Trace | None) -> _Fact:
    told = trace.knowledge.get("plant", "") if trace else ""
    section = results.study.controllers.get(one.key)
    if section is not None and _PLANT_FMU in _values(section.settings):
        told = f"{told or 'something not known'}; its settings name the FMU of the plant itself"
    if not told:
        return _NOT_KNOWN
    if told == "nothing":
        return _Fact("was told nothing of the plant beforehand", "were told nothing of the plant beforehand")
    return _Fact(f"was told beforehand of the plant: {told}", f"were told beforehand of the plant: {told}")


def _tuning(results: StudyResults, first: Condition) -> Markup:
    """State which settings were found how, those together that were found alike."""
    sections = results.study.controllers
    tuned = {one.key: sections[one.key].tuned if one.key in sections else None for one in first.contenders}
    alike: dict[tuple[str, str], list[Markup]] = {}
    for one in first.contenders:
        if table := tuned[one.key]:
            how = counted(table.trials, "trial"), _tuned_words(table, [case.seed for case in one.cases])
            named = Markup("<i>{}</i> ({})").format(one.label, ", ".join(table.settings))
            alike.setdefault(how, []).append(named)
    parts = [
        Markup("settings found in {}{} {}: {}").format(
            trials, " each" if len(who) > 1 else "", how, join_words(who)
        )
        for (trials, how), who in alike.items()
    ]
    if unknown := [one for one in first.contenders if not tuned[one.key]]:
        parts.append(Markup("of {} it is not known how settings were found").format(_who(unknown, first)))
    text = _capitalised(Markup("; ").join(parts))
    if len({table.trials if table else 0 for table in tuned.values()}) > 1:
        text += " So the effort spent on tuning is not known to be equal."
    return text


def _tuned_words(tuned: TunedSection, reported: Sequence[int]) -> str:
    seeds = f"{'seed' if len(tuned.seeds) == 1 else 'seeds'} {compact_seeds(tuned.seeds)}"
    source = f" ({tuned.source})" if tuned.source else ""
    shared = [seed for seed in dict.fromkeys(reported) if seed in tuned.seeds]
    # With `run --seeds` a study can be reported on seeds that are not its own.
    again = f", seeds of the tuning reported here: {compact_seeds(shared)}" if shared else ""
    return f"on {seeds}, by {tuned.by}{source}{again}"


def _sentence(condition: Condition, telling: _Telling, what: str) -> Markup:
    """Say a fact of every controller, those of whom the same is said together."""
    groups: dict[_Fact, list[ControllerResults]] = {}
    for one in condition.controllers:
        groups.setdefault(telling(one, condition.first_traces.get(one.key)), []).append(one)
    unknown = groups.pop(_NOT_KNOWN, [])
    parts = [
        Markup("{} {}").format(who, fact.of_several if len(members) > 1 else fact.of_one)
        for fact, members in groups.items()
        for who in [_who(members, condition)]
    ]
    if unknown:
        parts.append(Markup("of {} it is not known {}").format(_who(unknown, condition), what))
    return _capitalised(Markup("; ").join(parts))


def _capitalised(text: Markup) -> Markup:
    return text[:1].upper() + text[1:] + "."


def _who(members: Sequence[ControllerResults], condition: Condition) -> Markup:
    return (
        Markup("all controllers")
        if 1 < len(members) == len(condition.controllers)
        else join_words(names(members))
    )


def _values(settings: object) -> Iterator[object]:
    """Yield the values of settings, those within tables and lists among them."""
    if isinstance(settings, Mapping):
        for value in settings.values():
            yield from _values(value)
    elif isinstance(settings, list | tuple):
        for value in settings:
            yield from _values(value)
    else:
        yield settings
