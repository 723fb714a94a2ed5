"""How a command declares its options: its parameters are all there is to write."""

import inspect
from pathlib import Path
from typing import Any, Literal

import click
import pytest
from click.testing import CliRunner

from ddpc_cosim.cli.main import main
from ddpc_cosim.cli.options import argument, command, option
from ddpc_cosim.plant import FMIType


@command
def make_it_(
    names: tuple[str, ...] = argument(),
    kind: Literal["round", "square"] = option("round", "Shape.", show_default=True),
    size: float | None = option(None, "Of it [any]."),
    rows: int = option(..., "How many.", name="--count"),
    cover: tuple[Path, ...] = option((), "May be repeated."),
    dry_run: bool = option(False, "Only say so."),
) -> int:
    """Make something."""
    click.echo(repr((names, kind, size, rows, [path.name for path in cover], dry_run)))
    return 3


def made(*arguments: str) -> Any:
    return CliRunner().invoke(make_it_, arguments, standalone_mode=False)


def test_a_command_has_the_name_of_its_function_and_its_docstring_as_help() -> None:
    assert make_it_.name == "make-it"
    assert make_it_.help == "Make something."
    assert make_it_.callback is not None
    assert make_it_.callback.__name__ == "make_it_"


def test_a_parameter_says_name_type_default_and_how_often() -> None:
    done = made("a", "b", "--count", "2", "--cover", "x/y", "--cover", "z", "--dry-run", "--size", "1.5")
    assert done.output == "(('a', 'b'), 'round', 1.5, 2, ['y', 'z'], True)\n"
    assert done.return_value == 3
    assert made("a", "--count", "2", "--kind", "square").output == "(('a',), 'square', None, 2, [], False)\n"


def test_the_help_says_the_defaults_that_are_to_be_shown() -> None:
    text = made("--help").output
    assert "Usage: make-it [OPTIONS] NAMES..." in text
    assert "--kind [round|square]  Shape.  [default: round]" in text
    assert "--size FLOAT           Of it [any].\n" in text
    assert "--count INTEGER        How many.  [required]" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--count", "1"], "Missing argument 'NAMES...'"),
        (["a"], "Missing option '--count'"),
        (["a", "--count", "x"], "'x' is not a valid integer"),
        (["a", "--count", "1", "--kind", "squar"], '"squar" is not possible; did you mean "square"'),
        (["a", "--count", "1", "--count", "2"], "--count is given 2 times; allowed: once"),
        (["a", "--count", "1", "--cover", ""], "it is empty; needed: a path."),
    ],
)
def test_what_does_not_fit_is_a_usage_error(arguments: list[str], message: str) -> None:
    error = made(*arguments).exception
    assert isinstance(error, click.UsageError)
    assert message in error.format_message()


@pytest.mark.parametrize("name", main.commands)
def test_every_command_stands_in_a_file_of_its_name_and_declares_all_that_it_takes(name: str) -> None:
    command = main.commands[name]
    assert command.name == name
    parts = command.commands if isinstance(command, click.Group) else {"": command}
    for part in parts.values():
        function = part.callback
        assert function is not None
        module = inspect.getmodule(function)
        assert module is not None
        file = name if isinstance(command, click.Group) else function.__name__
        assert module.__name__ == f"ddpc_cosim.cli.commands.{file}"
        assert [param.name for param in part.params] == list(inspect.signature(function).parameters)


def test_an_fmi_type_is_one_that_plants_know() -> None:
    (fmi_type,) = (param for param in main.commands["simulate"].params if param.name == "fmi_type")
    assert fmi_type.type.choices == FMIType.__args__
