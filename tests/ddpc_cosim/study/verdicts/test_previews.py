"""Who is worse where it sees more of the reference is told, where nothing else differs."""

from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.previews import WorsePreview, worse_previews
from ddpc_cosim.study.verdicts.standings import standings

KEY = "mean_abs_error.y [K]"


def study(**scenarios: dict[str, Any]) -> Study:
    return read(
        Study,
        {
            "plant": {"name": "p"},
            "loop": {"sampling_time": 0.1, "duration": 1.0},
            "reference": {"y": {"kind": "constant", "value": 1.0}},
            "controllers": {"a": {"type": "a"}, "b": {"type": "b"}},
            "scenarios": scenarios,
        },
    )


def cases(levels: dict[tuple[str, str], float], seeds: int = 8, failed: int = 0) -> list[CaseResult]:
    rng = np.random.default_rng(3)
    return [
        CaseResult(
            f"{controller}{scenario}{seed}",
            controller,
            controller,
            scenario,
            seed,
            Outcome.COMPLETED,
            "",
            (),
            {KEY: level + 0.001 * float(rng.standard_normal())},
            {},
            {},
            (),
            Path(),
            failed=seed < failed,
        )
        for (controller, scenario), level in levels.items()
        for seed in range(seeds)
    ]


def worse(of: Study, runs: list[CaseResult]) -> list[WorsePreview]:
    return worse_previews(of, standings(of, runs))


SEEN = study(seen={}, unseen={"preview": 1, "label": "one sample"})
WORSE = {("a", "seen"): 0.074, ("a", "unseen"): 0.021, ("b", "seen"): 0.02, ("b", "unseen"): 0.03}


def test_a_controller_that_is_worse_with_more_preview_is_told() -> None:
    (comparison,) = worse(SEEN, cases(WORSE))
    assert (comparison.controller, comparison.key, comparison.more, comparison.less) == (
        "a",
        KEY,
        "seen",
        "unseen",
    )
    assert 0.07 < comparison.with_more.median < 0.08
    assert 0.02 < comparison.with_less.median < 0.03
    assert comparison.difference.median > 0.05


def test_nothing_is_told_of_chance_of_too_few_seeds_or_of_what_does_not_matter() -> None:
    assert not worse(SEEN, cases(dict.fromkeys(WORSE, 0.02)))
    assert not worse(SEEN, cases(WORSE, seeds=5))
    assert not worse(SEEN, cases({("a", "seen"): 100.5, ("a", "unseen"): 100.0}))
    assert not worse(SEEN, cases(WORSE, failed=4))


def test_scenarios_that_differ_in_more_are_not_set_side_by_side() -> None:
    other = study(seen={"noise": {"y": 0.1}}, unseen={"preview": 1})
    assert not worse(other, cases(WORSE))
