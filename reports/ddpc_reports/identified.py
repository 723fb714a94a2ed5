"""What a report says of a plant that is identified from data: how sure it makes one, what it cannot know."""

from collections.abc import Mapping, Sequence

from markupsafe import Markup

from ddpc_cosim import Identification, StudyResults
from ddpc_cosim.study.verdicts.findings import Findings, Lead
from ddpc_cosim.study.verdicts.sentences import beyond_log_clause, italic, join_words, sentence
from ddpc_reports.comparison import Condition, ControllerResults, metric_signal

_ALL = 1.0


def certainty_of_plant(
    results: StudyResults, findings: Findings, who: Mapping[str, ControllerResults]
) -> Markup:
    """Return what intervals over seeds say where each seed plays another model of the plant.

    Parameters
    ----------
    results : StudyResults
        The results of one problem.
    findings : Findings
        Who is ahead.
    who : mapping of str to ControllerResults
        The controllers, by key.
    """
    identified, ranking = results.study.plant.identified, findings.standings
    if identified is None:
        return Markup("")
    if identified.members == 1 or ranking.seeds < 2:
        return Markup(
            "The plant is an estimate, of which one model was run: how sure that makes one is open."
        )
    text = Markup(
        "The plant is an estimate, and each seed plays another model of it: intervals allow for that."
    )
    first, *level = findings.leaders or ("",)
    is_level = findings.lead is Lead.LEVEL and bool(level)
    other = level[0] if is_level else findings.following
    if not (first and other):
        return text
    ahead = {key: ranking.above(key, first, other).turned for key in ranking.keys}
    pair = italic(who[first].label), italic(who[other].label)
    parts = [
        f"{difference.won * difference.seeds:g} of {difference.seeds}"
        + (f" in {metric_signal(key)}" if len(ahead) > 1 else "")
        for key, difference in ahead.items()
        if difference.won < _ALL
    ]
    if not parts:
        return text if is_level else text + Markup(" {} is ahead of {} on all of them.").format(*pair)
    return text + Markup(" They disagree: {} is ahead of {} on {}.").format(*pair, join_words(parts))


def terms_of_plant(identified: Identification) -> str:
    """Return on what terms controllers are compared on a plant that is identified."""
    if identified.members == 1:
        which = "All seeds play one model that was identified from data"
    else:
        others = "those of data that might have been recorded as well"
        which = (
            f"Seed s plays model s of {identified.members}, number 0 that of all data, the others {others}"
        )
    noise = "with noise of the seed's own" if identified.noise else "without noise"
    return f"{which}, {noise}: the same for every controller."


def limitations_of_plant(conditions: Sequence[Condition]) -> list[str]:
    """Return what cannot be known of a plant that is known from data alone."""
    identified = conditions[0].results.study.plant.identified if conditions else None
    if identified is None:
        return []
    ranges = conditions[0].results.provenance.get("recorded ranges", "")
    seeds = {seed for condition in conditions for seed in condition.seeds}
    controllers = (controller for condition in conditions for controller in condition.controllers)
    beyond = beyond_log_clause(case for controller in controllers for case in controller.cases)
    repeated = len(seeds) - len({seed % identified.members for seed in seeds})
    return [
        "The plant is a model from data. It does not know what the plant does beyond what was recorded"
        + (f" ({ranges})" if ranges else "")
        + "; what acted on it and was not recorded, which is in the noise, or in the model as if inputs had "
        "done it; what changes later; nor, where a controller was at work while data were recorded, what of "
        "the relation of inputs and outputs is that controller's.",
        *([f"{sentence(beyond).striptags()}."] if beyond else []),
        *(
            [f"{repeated} of {len(seeds)} seeds play a model that another one plays too, and add less."]
            if repeated and identified.members > 1
            else []
        ),
    ]
