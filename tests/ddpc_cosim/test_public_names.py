"""What users name in their code comes from ``ddpc_cosim`` itself."""

import inspect

import pytest

import ddpc_cosim
from ddpc_cosim import errors
from ddpc_cosim.signals import signals


@pytest.mark.parametrize("name", ddpc_cosim.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(ddpc_cosim, name) is not None


@pytest.mark.parametrize("module", [errors, signals])
def test_errors_and_signals_are_public(module: object) -> None:
    """An error can be handled by its name, and a reference of one's own can be written."""
    names = [
        name
        for name, value in inspect.getmembers(module, inspect.isclass)
        if value.__module__ == module.__name__ and not name.startswith("_")  # type: ignore[attr-defined]
    ]
    assert set(names) <= set(ddpc_cosim.__all__)


def test_what_the_contracts_exchange_is_public() -> None:
    assert {"Bounds", "ParameterValue", "Outcome", "Sample", "Action", "Loop"} <= set(ddpc_cosim.__all__)
