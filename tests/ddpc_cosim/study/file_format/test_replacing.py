"""What replaces what where a file extends another: laws that hold whatever the files say."""

from typing import Any

from hypothesis import given, settings, strategies as st

from ddpc_cosim.study.file_format.replacing import (
    Table,
    changed_controller,
    extended,
    not_said,
    replaced,
    without_panels_of,
)

WORDS = "plant loop name title report panels controllers problems sweep seeds type settings tuned search a é"
KEYS = st.one_of(st.sampled_from(WORDS.split(" ")), st.just("controllers.a.settings.b"))
VALUES = st.recursive(
    st.one_of(st.booleans(), st.integers(0, 2), st.sampled_from(["a", "pid"])),
    lambda inner: st.one_of(st.lists(inner, max_size=2), st.dictionaries(KEYS, inner, max_size=4)),
    max_leaves=12,
)
TABLES = st.dictionaries(KEYS, VALUES, max_size=5)
SETTINGS = st.dictionaries(st.sampled_from("ab"), st.integers(0, 9), max_size=2)
UNTYPED = st.fixed_dictionaries({}, optional={"settings": SETTINGS, "label": st.sampled_from("pq")})
TYPED = st.fixed_dictionaries({"type": st.sampled_from("xy")}, optional={"settings": SETTINGS})


def in_problems(sections: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.dictionaries(st.sampled_from("PQ"), st.one_of(st.just(False), sections))


def one_after_another(*sections: Table) -> Table:
    """What holds where all of these are said: another type has settings of its own."""
    found: Table = {}
    for section in sections:
        found = changed_controller(found, section, found.get("type"))
    return {"settings": {}} | found


@given(TABLES)
def test_a_file_that_says_nothing_is_what_it_extends(base: Table) -> None:
    found, faults = extended(base, {}, "base")
    said = {key: value for key, value in base.items() if key not in ("name", "title", "summary")}
    assert (found, faults) == (said, [])
    assert set(not_said(found, {})) == {(key,) for key in said}


@settings(max_examples=200)
@given(TABLES, TABLES)
def test_whatever_files_say_the_own_counts(base: Table, own: Table) -> None:
    """Wrong types are told later, where the study is checked."""
    found, faults = extended(base, own, "base")
    wrong = {place for place, _ in faults}
    for key in own.keys() - {"extends", "problems", "controllers"}:
        if own[key] is False and isinstance(base.get(key), dict) and key != "sweep":
            assert key not in found
        elif not (isinstance(own[key], dict) and isinstance(base.get(key), dict)) or key == "sweep":
            assert found[key] == own[key]
    for key in ("problems", "controllers"):
        for name, one in own[key].items() if isinstance(own.get(key), dict) else ():
            if (key,) not in wrong and (key, name) not in wrong and one is not False:
                assert name in found[key]
    for place in not_said(found, own):
        assert place[0] in base


@settings(max_examples=200)
@given(TYPED, in_problems(UNTYPED), st.one_of(TYPED, UNTYPED), in_problems(st.one_of(TYPED, UNTYPED)))
def test_what_a_file_says_of_a_controller_counts_in_every_problem(
    base: Table, of_base: Table, own: Table, of_own: Table
) -> None:
    """In each: what the base says, of all and of it, then what the file says, of all and of it."""
    found, _ = extended(
        {"controllers": {"c": base | {"problems": of_base, "tuned": {"trials": 9}}}},
        {"controllers": {"c": own | {"problems": of_own}}},
        "base",
    )
    section = found["controllers"]["c"]
    of_some = section.pop("problems", {})
    for problem in "PQR":
        before, last = of_base.get(problem, {}), of_own.get(problem, {})
        is_out = last is False or (before is False and problem not in of_own)
        assert (of_some.get(problem) is False) == is_out
        if not is_out:
            actual = one_after_another(section, of_some.get(problem, {}))
            tuned = actual.pop("tuned")
            was = one_after_another(base, before or {})
            assert actual == one_after_another(base, before or {}, own, last)
            assert tuned is False or all(actual[key] == was[key] for key in ("type", "settings"))


def test_false_leaves_a_table_out_where_it_may() -> None:
    base = {"recording": {"samples": 9}, "scenarios": {"a": {}, "b": {}}, "plant": {"isolated": True}}
    changes: Table = {"recording": False, "scenarios": {"a": False}, "plant": {"isolated": False}}
    assert replaced(base, changes, leave_out=True) == {"scenarios": {"b": {}}, "plant": {"isolated": False}}
    assert replaced(base, changes)["recording"] is False


def test_panels_lose_the_controllers_that_are_left_out_whatever_else_they_name() -> None:
    report = {"panels": [{"controllers": ["a", "b", []]}, {"controllers": ["a"]}, 3, {"controllers": 3}]}
    kept = [{"controllers": ["b", []]}, 3, {"controllers": 3}]
    assert without_panels_of({"a"}, report) == {"panels": kept}
