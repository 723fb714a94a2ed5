"""What replaces what where a file extends another: laws that hold whatever the files say."""

from typing import Any

from hypothesis import given, settings, strategies as st

from ddpc_cosim.study.file_format.replacing import (
    Table,
    changed_controller,
    extended,
    not_said,
    replaced,
    without_controllers,
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
    merged: Table = {}
    for section in sections:
        merged = changed_controller(merged, section, merged.get("type"))
    return {"settings": {}} | merged


@given(TABLES)
def test_a_file_that_says_nothing_is_what_it_extends(base: Table) -> None:
    merged, faults = extended(base, {}, "base")
    said = {key: value for key, value in base.items() if key not in ("name", "title", "summary")}
    assert (merged, faults) == (said, [])
    assert set(not_said(merged, {})) == {(key,) for key in said}


@settings(max_examples=80)
@given(TABLES, TABLES)
def test_whatever_files_say_the_own_counts(base: Table, extending: Table) -> None:
    """Wrong types are told later, where the study is checked."""
    merged, faults = extended(base, extending, "base")
    wrong = {place for place, _ in faults}
    for key in extending.keys() - {"extends", "problems", "controllers"}:
        if extending[key] is False and isinstance(base.get(key), dict) and key != "sweep":
            assert key not in merged
        elif not (isinstance(extending[key], dict) and isinstance(base.get(key), dict)) or key == "sweep":
            assert merged[key] == extending[key]
    for key in ("problems", "controllers"):
        for name, table in extending[key].items() if isinstance(extending.get(key), dict) else ():
            if (key,) not in wrong and (key, name) not in wrong and table is not False:
                assert name in merged[key]
    for place in not_said(merged, extending):
        assert place[0] in base


@settings(max_examples=200)
@given(TYPED, in_problems(UNTYPED), st.one_of(TYPED, UNTYPED), in_problems(st.one_of(TYPED, UNTYPED)))
def test_what_a_file_says_of_a_controller_counts_in_every_problem(
    base: Table, of_base: Table, extending: Table, of_own: Table
) -> None:
    """In each: what the base says, of all and of it, then what the file says, of all and of it."""
    merged, _ = extended(
        {"controllers": {"c": base | {"problems": of_base, "tuned": {"trials": 9}}}},
        {"controllers": {"c": extending | {"problems": of_own}}},
        "base",
    )
    section = merged["controllers"]["c"]
    of_some = section.pop("problems", {})
    for problem in "PQR":
        before, last = of_base.get(problem, {}), of_own.get(problem, {})
        is_out = last is False or (before is False and problem not in of_own)
        assert (of_some.get(problem) is False) == is_out
        if not is_out:
            actual = one_after_another(section, of_some.get(problem, {}))
            tuned = actual.pop("tuned")
            was = one_after_another(base, before or {})
            assert actual == one_after_another(base, before or {}, extending, last)
            assert tuned is False or all(actual[key] == was[key] for key in ("type", "settings"))


def test_false_leaves_a_table_out_where_it_may() -> None:
    base = {"recording": {"samples": 9}, "scenarios": {"a": {}, "b": {}}, "plant": {"isolated": True}}
    changes: Table = {"recording": False, "scenarios": {"a": False}, "plant": {"isolated": False}}
    assert replaced(base, changes, leave_out=True) == {"scenarios": {"b": {}}, "plant": {"isolated": False}}
    assert replaced(base, changes)["recording"] is False


def test_panels_lose_the_controllers_that_are_left_out_whatever_else_they_name() -> None:
    report = {"panels": [{"controllers": ["a", "b", []]}, {"controllers": ["a"]}, 3, {"controllers": 3}]}
    kept = [{"controllers": ["b", []]}, 3, {"controllers": 3}]
    assert without_controllers({"a"}, report) == {"panels": kept}
