"""The file of a suggested study: what a TOML reader finds in it is what was to be said, comments or not."""

import tomllib
from typing import Any

from hypothesis import given, strategies as st

from ddpc_cosim.suggestion.writing import commented_toml

TEXTS = st.text(max_size=8)
PLAIN = st.one_of(st.booleans(), st.integers(-(2**40), 2**40), st.floats(allow_nan=False), TEXTS)
VALUES = st.one_of(PLAIN, st.lists(st.lists(PLAIN, max_size=2), max_size=2))
TABLES = st.recursive(
    st.dictionaries(TEXTS, VALUES, max_size=3),
    lambda below: st.dictionaries(TEXTS, below | VALUES, max_size=3),
)


def places(value: Any, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the places of everything in tables, entries of lists included."""
    below = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place, *(at for key, item in below for at in places(item, (*place, key)))]


@given(tables=TABLES, text=TEXTS, data=st.data())
def test_comments_change_nothing(tables: dict[str, Any], text: str, data: st.DataObject) -> None:
    marked = st.lists(st.sampled_from(places(tables)), max_size=4)
    above = dict.fromkeys(data.draw(marked), ("why", text))
    beside = dict.fromkeys(filter(None, data.draw(marked)), text)
    assert tomllib.loads(commented_toml(tables, above, beside)) == tables


def test_what_is_said_of_a_table_stands_above_it_and_of_a_value_beside_it() -> None:
    tables = {
        "seeds": [0],
        "plant": {"inputs": ["u", "v"], "start": {"u": 1.0}},
        "controllers": {"a b": {"type": "pid"}},
        "bounds": {"u": {"min": -1.0}},
    }
    above = {(): ("head",), ("plant", "start"): ("where it starts",), ("controllers",): ("who competes",)}
    beside = {("plant", "inputs", 0): "[N]", ("plant", "inputs", 1): "", ("bounds", "u"): "declared"}
    assert (
        commented_toml(tables, above, beside)
        == """# head
seeds = [0]

[plant]
inputs = [
    "u",  # [N]
    "v",
]

# where it starts
[plant.start]
u = 1.0

# who competes
[controllers."a b"]
type = "pid"

[bounds]
u = { min = -1.0 }  # declared
"""
    )
