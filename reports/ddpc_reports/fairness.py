"""On what terms the controllers are compared: what each sees, uses, may do, knows and was tuned on."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from markupsafe import Markup

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.files.texts import clipped, without_folders
from ddpc_cosim.study.file_format.sections import TunedSection
from ddpc_cosim.study.verdicts.sentences import italic, join_words, some_of
from ddpc_cosim.study.verdicts.shares import run_once
from ddpc_reports.comparison import Condition, ControllerResults
from ddpc_reports.identified import terms_of_plant
from ddpc_reports.numbers import as_given, computed, with_unit
from ddpc_reports.tables.settings import compact_seeds, limits_texts, mapping_text
from ddpc_reports.verdict import Statement, counted, names


class _Fact(NamedTuple):
    """What is said of one controller, and of several; empty: it is not known."""

    of_single: str
    of_several: str


_FactOf = Callable[[ControllerResults, Trace | None], _Fact]
"""What is said of a controller, given its run at the first seed, if that has any samples."""
_NOT_KNOWN = _Fact("", "")
_LOST = (Outcome.CRASHED, Outcome.TIMED_OUT)
"""Of runs that ended so there are the samples alone: that nothing was noted says nothing."""
_MANY = 3
"""From so many controllers on, those of whom most is said alike are called all others."""
_PLANT_FMU = "{plant}"
"""What a setting says in a study that is the path of a file, for the FMU that the study controls."""


class _Terms(NamedTuple):
    """Sentences on a topic, and whether they say the same of all controllers."""

    text: Markup
    alike: bool


def fairness_statements(results: StudyResults, conditions: Sequence[Condition]) -> list[Statement]:
    """Return the terms of the comparison, as the study sets them and as its first seed was run.

    What is known to be the same for all stands together; then, topic by topic, what is not. Of controllers
    that do not tell a fact, it is said that it is not known.
    """
    if not conditions or not conditions[0].controllers:
        return []
    first, identified = conditions[0], results.study.plant.identified
    drawn = list(dict.fromkeys(name for case in results.cases for name in case.drawn))
    topics = {
        "Preview": _by_scenario(conditions, _preview),
        "Measurements": [_measurements(first)],
        "Disturbances": _by_scenario(conditions, _disturbances) if results.study.disturbances else [],
        "Prices": [_prices(first)] if results.study.prices else [],
        "Plant": [_Terms(Markup.escape(terms_of_plant(identified)), alike=True)] if identified else [],
        "Plants": [_plants(drawn)] if drawn else [],
        "Seeds": _seeds(results, first),
        "Limits": [_limits(first)],
        "Recording": _by_scenario(conditions, _recording),
        "Prior knowledge": [
            _sentence(first, partial(_prior_knowledge, results), "what was told beforehand of the plant")
        ],
        "Tuning": [_tuning(results, first)],
    }
    stated = [(topic, terms) for topic, of_topic in topics.items() for terms in of_topic]
    common = Markup(" ").join(terms.text for _, terms in stated if terms.alike)
    differing = [Statement(topic, terms.text) for topic, terms in stated if not terms.alike]
    return [Statement("The same for all", common), *differing] if common else differing


def _by_scenario(conditions: Sequence[Condition], terms_in: Callable[[Condition], _Terms]) -> list[_Terms]:
    """Return what may differ from scenario to scenario, once for those that are alike."""
    labels_by_terms: dict[_Terms, list[Markup]] = {}
    for condition in conditions:
        labels_by_terms.setdefault(terms_in(condition), []).append(italic(condition.label))
    if len(labels_by_terms) == 1:
        return list(labels_by_terms)
    return [
        _Terms(Markup("In {}: {}").format(some_of(labels), terms.text), alike=False)
        for terms, labels in labels_by_terms.items()
    ]


def _preview(condition: Condition) -> _Terms:
    return _sentence(condition, _seen, "how far ahead the reference was seen")


def _seen(controller: ControllerResults, trace: Trace | None) -> _Fact:
    if trace is None:
        return _NOT_KNOWN
    if not trace.outputs:
        return _Fact("follows no reference", "follow no reference")
    if not trace.preview:
        if trace.outcome in _LOST:
            return _NOT_KNOWN
        return _Fact("sees no future reference", "see no future reference")
    ahead = as_given(computed(trace.preview * trace.sampling_time))
    what = f"{counted(trace.preview, 'sample')} of the future reference ({with_unit(ahead, 's')})"
    return _Fact(f"sees {what}", f"see {what}")


def _plants(drawn: Sequence[str]) -> _Terms:
    """Say what differs from seed to seed, given names of parameters with their units."""
    what = join_words([clipped(name.partition(" [")[0]) for name in drawn])
    text = Markup("Each seed has a plant of its own ({}), the same for all, and no controller is told which.")
    return _Terms(text.format(what), alike=True)


def _measurements(first: Condition) -> _Terms:
    handed = Markup("")
    for trace in first.first_traces.values():
        signals = join_words([clipped(variable.name) for variable in trace.measurements])
        handed = Markup("Measured for every controller: {}. ").format(signals)
    used = _sentence(first, _used, "which of them are used")
    return used._replace(text=handed + used.text)


def _used(controller: ControllerResults, trace: Trace | None) -> _Fact:
    measures = trace.knowledge.get("measures", "") if trace else ""
    return _Fact(f"uses {measures}", f"use {measures}") if measures else _NOT_KNOWN


_FORECASTS = {
    "unknown": "nothing",
    "measured": "what is measured",
    "low": "what is measured, and forecasts with low errors",
    "medium": "what is measured, and forecasts with medium errors",
    "high": "what is measured, and forecasts with high errors",
    "perfect": "what is measured, and what it will be",
}
"""What is known of a disturbance."""


def _disturbances(condition: Condition) -> _Terms:
    """Say what is known of each disturbance in a scenario, and who uses forecasts."""
    study = condition.results.study
    changes = study.scenarios[condition.scenario].known if condition.scenario in study.scenarios else {}
    by_words: dict[str, list[Markup]] = {}
    for name, disturbance in study.disturbances.items():
        words = _FORECASTS[changes.get(name, disturbance.known)]
        if disturbance.forecast is not None and name not in changes:
            words = "what is measured, and forecasts from a file"
        is_late = disturbance.lag and words != _FORECASTS["unknown"]
        late = f", {counted(disturbance.lag, 'sample')} late" if is_late else ""
        by_words.setdefault(words + late, []).append(italic(clipped(name)))
    parts = [Markup("of {}: {}").format(join_words(names_of), words) for words, names_of in by_words.items()]
    text = Markup("Known {}.").format(Markup("; ").join(parts))
    if {*by_words} == {_FORECASTS["unknown"]}:
        return _Terms(text, alike=True)
    used = _sentence(condition, partial(_told, "forecast", _forecast_used), "whether forecasts are used")
    return used._replace(text=text + " " + used.text)


def _prices(first: Condition) -> _Terms:
    """Say whether prices are known ahead, and who uses them."""
    prices = first.results.study.prices
    ahead = [italic(clipped(name)) for name, price in prices.items() if price.known]
    now = [italic(clipped(name)) for name, price in prices.items() if not price.known]
    parts = [
        *([Markup("Known ahead: {}").format(join_words(ahead))] if ahead else []),
        *([Markup("Known when they are paid: {}").format(join_words(now))] if now else []),
    ]
    used = _sentence(first, partial(_told, "prices", _prices_used), "whether prices are used")
    return used._replace(text=Markup(". ").join(parts) + ". " + used.text)


def _told(
    key: str, words: Callable[[str], _Fact], controller: ControllerResults, trace: Trace | None
) -> _Fact:
    """Return what a controller says of a kind of knowledge; who says what it goes by uses no more."""
    if trace is None or not trace.knowledge:
        return _NOT_KNOWN
    return words(without_folders(trace.knowledge.get(key, "")))


def _forecast_used(told: str) -> _Fact:
    if told == "measured only":
        what = "what is measured of disturbances, and no forecast"
        return _Fact(f"uses {what}", f"use {what}")
    if told in ("", "not used"):
        return _Fact("uses no forecast", "use no forecast")
    return _Fact(f"uses the forecast of {told}", f"use the forecast of {told}")


def _prices_used(told: str) -> _Fact:
    what = f"the price of {told}" if told else "no price"
    return _Fact(f"uses {what}", f"use {what}")


def _seeds(results: StudyResults, first: Condition) -> list[_Terms]:
    """Say who is run with the first seed alone, if anybody is."""
    alone = run_once(results.study)
    once = [controller for controller in first.controllers if controller.key in alone]
    if not once or len(first.seeds) < 2:
        return []
    words = "{} {} run with seed {} alone, beside which runs of all seeds are set; all others with {}."
    seeds = compact_seeds(first.seeds)
    is_or_are = "is" if len(once) == 1 else "are"
    who = join_words(names(once))
    return [_Terms(Markup(words).format(who, is_or_are, first.seeds[0], f"seeds {seeds}"), alike=False)]


def _limits(first: Condition) -> _Terms:
    traces = list(first.first_traces.values())
    if not traces:
        return _Terms(Markup("No run tells the limits."), alike=False)

    def limits(signal: int, controller: ControllerResults, trace: Trace | None) -> _Fact:
        words = limits_texts(trace)[signal] if trace else ""
        return _Fact(f"has {words}", f"have {words}") if words else _NOT_KNOWN

    signals = [variable.name for variable in (*traces[0].inputs, *traces[0].outputs)]
    differing = [
        Markup("Limits of {} differ: {}").format(
            name, _sentence(first, partial(limits, i), f"what limits of {name} held").text
        )
        for i, name in enumerate(signals)
        if len({limits_texts(trace)[i] for trace in traces}) > 1
    ]
    if differing:
        return _Terms(Markup(" ").join(differing), alike=False)
    return _Terms(Markup("The limits of inputs and outputs are the same."), alike=True)


def _recording(condition: Condition) -> _Terms:
    study = condition.results.study
    said = _sentence(condition, _learned, "whether a recording was learned from")
    if study.recording is None:
        return said
    text = said.text
    if stabiliser := study.recording.controller:
        settings = f" with {mapping_text(stabiliser.settings)}" if stabiliser.settings else ""
        text += Markup(
            " While it was recorded, the plant was kept by a stabilising controller that the study gives, "
            "{}{}: whoever learns from the recording rests on that too."
        ).format(stabiliser.type, settings)
    if study.loop.start == "recording-end":
        text += " Every loop starts where its recording ended."
    return said._replace(text=text)


def _learned(controller: ControllerResults, trace: Trace | None) -> _Fact:
    if trace is None:
        return _NOT_KNOWN
    if not trace.recorded_samples:
        if trace.outcome in _LOST:
            return _NOT_KNOWN
        return _Fact("asks for no recording", "ask for no recording")
    what = f"from a recording of {counted(trace.recorded_samples, 'sample')}"
    return _Fact(f"learns {what}", f"learn {what}")


def knowledge_of_plant(results: StudyResults, controller: ControllerResults, trace: Trace | None) -> str:
    """Return what a controller was told of the plant beforehand; empty where that is not known."""
    knowledge = without_folders(trace.knowledge.get("plant", "")) if trace else ""
    section = results.study.controllers.get(controller.key)
    if section is not None and _PLANT_FMU in _values(section.settings):
        knowledge = f"{knowledge or 'something not known'}; its settings name the FMU of the plant itself"
    return knowledge


def _prior_knowledge(results: StudyResults, controller: ControllerResults, trace: Trace | None) -> _Fact:
    knowledge = knowledge_of_plant(results, controller, trace)
    if not knowledge:
        return _NOT_KNOWN
    if knowledge == "nothing":
        return _Fact("was told nothing of the plant beforehand", "were told nothing of the plant beforehand")
    what = f"told beforehand of the plant: {knowledge}"
    return _Fact(f"was {what}", f"were {what}")


def _tuning(results: StudyResults, first: Condition) -> _Terms:
    """Say how the settings were found; which ones stands with the settings of the controllers."""
    sections = results.study.controllers
    tables = {
        controller.key: sections[controller.key].tuned if controller.key in sections else None
        for controller in first.contenders
    }

    def tuned_how(controller: ControllerResults, trace: Trace | None) -> _Fact:
        if not (table := tables.get(controller.key)):
            return _NOT_KNOWN
        how = _tuned_words(table, [case.seed for case in controller.cases])
        return _Fact(f"has settings {how}", f"have settings {how}")

    if not first.contenders:
        return _Terms(Markup(""), alike=True)
    some = first.contenders if len(first.contenders) < len(first.controllers) else ()
    said = _sentence(first, tuned_how, "how settings were found", some)
    if len({table.trials if table else 0 for table in tables.values()}) > 1:
        said = said._replace(text=said.text + " So the effort spent on tuning is not known to be equal.")
    return said


def _tuned_words(tuned: TunedSection, reported: Sequence[int]) -> str:
    if not tuned.trials or not tuned.seeds:
        return f"from {tuned.source}"
    seeds = f"{'seed' if len(tuned.seeds) == 1 else 'seeds'} {compact_seeds(tuned.seeds)}"
    source = f" ({tuned.source})" if tuned.source else ""
    shared = [seed for seed in dict.fromkeys(reported) if seed in tuned.seeds]
    # With `run --seeds` a study can be reported on seeds that are not its own.
    again = f", seeds of the tuning reported here: {compact_seeds(shared)}" if shared else ""
    return f"found in {counted(tuned.trials, 'trial')} on {seeds}, by {tuned.by}{source}{again}"


def _sentence(
    condition: Condition, fact_of: _FactOf, what: str, everyone: Sequence[ControllerResults] = ()
) -> _Terms:
    """Say a fact of every controller, or of some: the same of several together, of most as of all others."""
    whom, rest = (everyone, " that compete") if everyone else (condition.controllers, "")
    groups: dict[_Fact, list[ControllerResults]] = {}
    for controller in whom:
        fact = fact_of(controller, condition.first_traces.get(controller.key))
        groups.setdefault(fact, []).append(controller)
    if _NOT_KNOWN in groups:
        groups[_NOT_KNOWN] = groups.pop(_NOT_KNOWN)
    most = max(groups, key=lambda fact: len(groups[fact]))
    if many := len(groups) > 1 and len(groups[most]) >= _MANY:
        groups[most] = groups.pop(most)  # to the end
    parts = []
    for fact, members in groups.items():
        who = join_words(names(members))
        if len(members) > 1 and len(members) == len(condition.controllers):
            who = Markup("all controllers")
        elif many and fact is most:
            who = Markup(f"all others{rest}")
        said = fact.of_several if len(members) > 1 else fact.of_single
        unknown = Markup("of {} it is not known {}").format(who, what)
        parts.append(unknown if fact == _NOT_KNOWN else Markup("{} {}").format(who, said))
    text = Markup("; ").join(parts)
    # What is not known of anybody may differ all the same.
    return _Terms(text[:1].upper() + text[1:] + ".", alike=len(groups) == 1 and most != _NOT_KNOWN)


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
