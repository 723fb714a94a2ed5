"""Plain data as bytes: everything comes back as it was, nothing else is made of what is read."""

import pickle
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import ConfigError
from ddpc_cosim.files.plain_data import from_bytes, to_bytes

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: (
        st.lists(inner)
        | st.lists(inner).map(tuple)
        | st.dictionaries(st.text() | st.sampled_from(["dict", "tuple", "bytes", "array"]), inner)
    ),
    max_leaves=20,
)


@given(PLAIN)
def test_data_come_back_with_their_types(value: object) -> None:
    back = from_bytes(to_bytes(value))
    assert repr(back) == repr(value)  # 0.0 and -0.0, 1 and True are equal


@pytest.mark.parametrize("kind", ["<f8", ">f8", "<f4", "<i8", "|b1", "<c16", "|u1"])
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3)])
def test_arrays_come_back_to_the_last_bit(kind: str, shape: tuple[int, ...]) -> None:
    array = np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(kind)
    back = from_bytes(to_bytes({"x": array}))["x"]
    assert (back.dtype, back.shape, back.tobytes()) == (array.dtype, array.shape, array.tobytes())
    assert back.flags.writeable


def test_numbers_that_are_not_finite_come_back() -> None:
    back = from_bytes(to_bytes((np.float64(np.inf), float("nan"), np.array([np.nan, -0.0]))))
    assert back[0] == np.inf
    assert np.isnan(back[1])
    assert np.signbit(back[2][1])


@pytest.mark.parametrize(
    "value", [object(), {1: 2}, {1, 2}, np.array(["text"]), np.array([object()]), Path(), 1j, len, [print]]
)
def test_what_is_not_plain_is_refused_when_it_is_written(value: Any) -> None:
    with pytest.raises(ConfigError, match="is not plain data; allowed: numbers, texts"):
        to_bytes(value)


def test_mappings_come_back_as_dicts() -> None:
    assert from_bytes(to_bytes(OrderedDict(a=1))) == {"a": 1}


class Evil:
    """Writes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def test_a_pickle_is_not_opened(tmp_path: Path) -> None:
    for content in (pickle.dumps(Evil(tmp_path / "done")), to_bytes(pickle.dumps(Evil(tmp_path / "done")))):
        with suppress(ValueError):
            assert isinstance(from_bytes(content), bytes)
    assert not (tmp_path / "done").exists()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"bytes": 3}',
        b'{"bytes": "?"}',
        b'{"tuple": 3}',
        b'{"array": "AAAA", "type": "O", "shape": [1]}',
        b'{"array": "", "type": "V0", "shape": [1]}',
        b'{"array": "", "type": "<f8", "shape": [1000000000000]}',
        b'{"array": "AAAA", "type": "<f8", "shape": [1]}',
        b'{"array": "AAAA"}',
        b"9" * 10_000,
    ],
)
def test_what_is_no_such_data_is_a_value_error(content: bytes) -> None:
    with pytest.raises(ValueError, match="not plain data"):
        from_bytes(content)


@given(st.binary())
def test_anything_is_data_or_a_value_error(content: bytes) -> None:
    with suppress(ValueError):
        from_bytes(content)
