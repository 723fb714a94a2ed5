"""What a reader must know to judge the figures fairly: what the study says, and what its results show."""

from ddpc_reports.comparison import Condition


def limitations(conditions: tuple[Condition, ...], drawn: int) -> list[str]:
    """Return the study's own limitations, then those that its results show.

    Parameters
    ----------
    conditions : tuple of Condition
        All conditions of the study.
    drawn : int
        How many of them have figures.
    """
    found = [*conditions[0].results.study.report.limitations] if conditions else []
    found += _of_cases(conditions) + _of_seeds(conditions) + _of_drawing(conditions, drawn)
    if conditions:
        found.append(
            "Step times are wall-clock times of one machine under the load it had; they rank "
            "implementations, not methods."
        )
    return found


def _of_cases(conditions: tuple[Condition, ...]) -> list[str]:
    lost = {one.label: 0 for condition in conditions for one in condition.competitors}
    for condition in conditions:
        for one in condition.competitors:
            lost[one.label] += len(one.cases) - len(one.completed)
    return [
        f"{label}: {count} {'case' if count == 1 else 'cases'} did not complete; its medians and ranges are "
        "those of the others, which may be the easier ones."
        for label, count in lost.items()
        if count
    ]


def _of_seeds(conditions: tuple[Condition, ...]) -> list[str]:
    if any(len(condition.seeds) > 1 for condition in conditions):
        return ["The figures over time show the first seed only; the spread over seeds is shown on its own."]
    return ["One seed only: how much the figures depend on it is not known."] if conditions else []


def _of_drawing(conditions: tuple[Condition, ...], drawn: int) -> list[str]:
    left_out = [condition.label for condition in conditions[drawn:]]
    if not left_out:
        return []
    return [f"To keep the page small, these scenarios have no figures over time: {', '.join(left_out)}."]
