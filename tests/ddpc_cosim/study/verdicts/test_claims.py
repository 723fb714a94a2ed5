"""A claim of a study's source holds where it is so on every seed, judged only where no controller failed."""

from pathlib import Path
from typing import Any

import pytest

from ddpc_cosim import CaseResult, ConfigError, Outcome
from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.verdicts.claims import CheckedClaim, check_claims

TRAVEL = "total_variation.u"
STUDY: dict[str, Any] = {
    "plant": {"name": "p"},
    "loop": {"sampling_time": 0.1, "duration": 1.0},
    "reference": {"y": {"kind": "constant", "value": 1.0}},
    "controllers": {
        "a": {"type": "a"},
        "b": {"type": "b"},
        "b-1": {"type": "b", "variant_of": "b"},
        "nothing": {"type": "idle"},
        "all": {"type": "nmpc"},
    },
}


def checked(values: dict[str, list[float]], *failing: tuple[str, int], **claim: Any) -> CheckedClaim:
    points = {"zero": "nothing", "full": "all"}
    report = {"claims": [{"text": "so it is", "metric": TRAVEL, **claim}], "reference_points": points}
    cases = [
        CaseResult(
            f"{name}{seed}",
            name,
            name,
            "nominal",
            seed,
            Outcome.COMPLETED,
            "",
            (),
            {f"{TRAVEL} [N]": value},
            {},
            {},
            (),
            Path(),
            failed=(name, seed) in failing,
        )
        for name, level in values.items()
        for seed, value in enumerate(level)
    ]
    (result,) = check_claims(read(Study, STUDY | {"report": report}), cases)
    return result


A_BELOW_B = {"a": [1.0, 2.0, 3.0], "b": [2.0, 3.0, 4.0]}


@pytest.mark.parametrize(
    ("claim", "verdict"),
    [
        ({"order": ["a", "b"]}, "holds"),
        ({"order": ["b", "a"]}, "does not hold"),
        ({"lowest": "a"}, "holds"),
        ({"highest": "a"}, "does not hold"),
    ],
)
def test_a_claim_of_an_order_is_checked_on_every_seed(claim: dict[str, Any], verdict: str) -> None:
    result = checked(A_BELOW_B, **claim)
    assert result.verdict == verdict
    assert result.judged == 3


def test_neither_reference_points_nor_variants_are_among_those_of_whom_one_is_the_lowest() -> None:
    others = {"b-1": [0.1, 0.1, 0.1], "nothing": [0.0, 0.0, 0.0], "all": [0.0, 0.0, 0.0]}
    assert checked(A_BELOW_B | others, lowest="a").verdict == "holds"


def test_equal_values_are_in_no_order_and_some_seeds_make_it_a_part() -> None:
    claim = checked({"a": [1.0, 2.0], "b": [1.0, 3.0]}, lowest="a")
    assert (claim.true, claim.judged, claim.verdict) == (1, 2, "holds in part")


def test_a_claim_is_not_so_where_the_one_that_it_is_of_failed() -> None:
    failing = [("a", 0), ("a", 1)]
    assert (claim := checked(A_BELOW_B, *failing, lowest="a")).verdict == "holds in part"
    assert (claim.true, claim.judged) == (1, 3)
    assert checked(A_BELOW_B, ("a", 0), order=["a", "b"]).verdict == "holds in part"


def test_nobody_to_compare_with_is_no_proof() -> None:
    assert checked({"a": [1.0, 2.0]}, lowest="a").verdict == "cannot be judged"
    assert checked({"b": [1.0, 2.0]}, alike="b").verdict == "cannot be judged"


def test_where_another_failed_nothing_is_judged() -> None:
    assert checked(A_BELOW_B, ("b", 0), lowest="a").judged == 2
    assert checked(A_BELOW_B, *(("b", seed) for seed in range(3)), lowest="a").verdict == "cannot be judged"


@pytest.mark.parametrize(("spread", "verdict"), [(1.09, "holds"), (1.11, "does not hold")])
def test_a_sweep_changes_nothing_where_its_values_are_within_percents(spread: float, verdict: str) -> None:
    assert checked({"b": [1.0], "b-1": [spread]}, alike="b").verdict == verdict


def test_faults_of_a_claim_are_told_at_once(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(
        """
extends = "claims"
[report]
claims = [
    { text = "x", metric = "overshoot.angel", lowest = "wkpc" },
    { text = "x", metric = "overshoot.angle", lowest = "wkcp" },
    { text = "x", metric = "overshoot.angle" },
]
""",
        encoding="utf-8",
    )
    with pytest.raises(ConfigError) as caught:
        read_study(str(file))
    message = str(caught.value)
    assert "needed: one of lowest, highest, order, alike" in message
    file.write_text(
        file.read_text(encoding="utf-8").replace('angle" }', 'angle", order = ["wkpc", "deepc"] }')
    )
    with pytest.raises(ConfigError) as caught:
        read_study(str(file))
    message = str(caught.value)
    assert "did you mean overshoot.angle" in message or '"overshoot.angle"' in message
    assert "wkpc" in message.split("wkcp")[1]
