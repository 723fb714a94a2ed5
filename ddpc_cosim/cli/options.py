"""How a command declares its options, as a class does its settings, and those that several have."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from inspect import signature
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import click
from click.shell_completion import CompletionItem

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.durations import EXPECTED, moment_of, seconds_of

T = TypeVar("T")


class Command(click.Command):
    """A command whose options are given once, but for those that may be repeated."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments, and say which option with one value has several."""
        if not ctx.resilient_parsing:
            _, _, given = self.make_parser(ctx).parse_args(list(args))
            counts = Counter(param for param in given if isinstance(param, click.Option))
            for single, count in counts.items():
                if count > 1 and not (single.multiple or single.is_flag):
                    name = next(name for name in single.opts if name.startswith("--"))
                    ctx.fail(f"{name} is given {count} times; allowed: once, as it has one value.")
        return super().parse_args(ctx, args)


def command(function: Callable[..., int]) -> Command:
    """Return a function as the command of its name, whose help is its docstring.

    Its parameters have what declares them, an :func:`argument` or an :func:`option`, in place of a default.
    What it returns is the exit code.
    """
    hints = get_type_hints(function)
    declared = signature(function).parameters.items()
    params = [parameter.default(name, hints[name]) for name, parameter in declared]
    name = function.__name__.rstrip("_").replace("_", "-")
    return Command(name, callback=function, params=params, help=function.__doc__)


def argument(**more: Any) -> Any:
    """Declare an argument, which is required, by further keywords of :class:`click.Argument`."""

    def declare(name: str, kind: Any) -> click.Argument:
        how = {"type": _type_of(kind), "required": True}
        if get_origin(kind) is tuple:
            how["nargs"] = -1 if ... in get_args(kind) else len(get_args(kind))
        return click.Argument([name], **how | more)

    return declare


def option(default: Any, help: str = "", *, name: str = "", **more: Any) -> Any:
    """Declare an option: a bool is a flag, a tuple may be repeated.

    Parameters
    ----------
    default : object
        Its value where it is not given; ``...``: it is required.
    help : str
        One line for people.
    name : str
        What it is called, if not as the parameter.
    more : Any
        Further keywords of :class:`click.Option`.
    """

    def declare(parameter: str, kind: Any) -> click.Option:
        how = {"is_flag": True} if kind is bool else {"type": _type_of(kind)}
        if get_origin(kind) is tuple:
            how["multiple"] = True
        if default is ...:
            how["required"] = True
        elif default not in (None, ()):
            how["default"] = default
        called = name or "--" + parameter.replace("_", "-")
        return click.Option([called, parameter], help=help, **how | more)

    return declare


def _type_of(kind: Any) -> Any:
    """Return the type by which click converts a value: of ``X | None`` and ``tuple[X, ...]`` that of X."""
    if get_origin(kind) is Literal:
        return Choice(get_args(kind))
    inner = next((part for part in get_args(kind) if part not in (NoneType, ...)), None)
    return _type_of(inner) if inner else FILE if kind is Path else kind


class Choice(click.Choice[str]):
    """One of a few words; for another one the nearest is told."""

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        """Say what was probably meant."""
        from fmu_plants.spelling import did_you_mean

        return f'"{value}" is not possible; {did_you_mean(str(value), self.choices)}'


class PathType(click.Path):
    """A path that is not empty, as that of an unset variable of a shell is."""

    def __init__(self, **more: Any) -> None:
        super().__init__(path_type=Path, **more)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, or say what is wrong with it."""
        if not str(value):
            self.fail("it is empty; needed: a path.", param, ctx)
        return super().convert(value, param, ctx)


class FiniteRange(click.FloatRange):
    """A range of numbers that are finite, which NaN is in none of."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number, or say why it is not possible."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class Time(click.ParamType[float]):
    """Seconds: a number, or what a reader of texts makes of a text.

    Parameters
    ----------
    read : callable
        Returns the seconds that a text says; ValueError: it says none, and why.
    """

    name = "time"

    def __init__(self, read: Callable[[str], float]) -> None:
        self._read = read

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the seconds, or say what is wrong."""
        try:
            return float(value)
        except ValueError:
            pass
        try:
            return float(self._read(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


def _duration(text: str) -> float:
    try:
        return seconds_of(text)
    except ValueError as error:
        raise ValueError(f"must be {EXPECTED}, got {text[:100]!r}: {error}") from error


MOMENT, DURATION = Time(moment_of), Time(_duration)
FILE, FOLDER = PathType(dir_okay=False), PathType(file_okay=False)
POSITIVE, AT_LEAST_1 = FiniteRange(min=0, min_open=True), click.IntRange(min=1)


def names_of(*kinds: str) -> Callable[..., list[CompletionItem]]:
    """Return what a shell completes: names of plug-ins of some kinds, and files."""

    def complete(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
        from ddpc_cosim.plugins import plugin_names

        names = [name for kind in kinds for name in plugin_names(kind) if name.startswith(begun)]
        return [*map(CompletionItem, names), CompletionItem(begun, type="file")]

    return complete


STUDY = argument(shell_complete=names_of("studies"))
FMU = argument(type=PathType(exists=True, dir_okay=False), metavar="FILE.fmu|FILE.ssp")
FMUS = argument(
    type=PathType(exists=True, dir_okay=False), metavar="FILE.fmu|FILE.ssp|FILE.fmu FILE.fmu...|LOG.csv..."
)
JOBS = option(None, "Worker processes [one per processor].", type=AT_LEAST_1)
ONLY = option((), "Only cases of this name or label; may be repeated.", metavar="GLOB")
Executor = Literal["local", "dask"]
EXECUTOR = option("local", "Where cases run [local].")
SCHEDULER = option("", "The dask scheduler's: tcp://host:8786.", metavar="ADDRESS")
SANDBOX = option(False, "Let the FMU write nothing elsewhere, read no files of yours, no network.")
LIBRARY_PATH = option(
    (),
    "A library that is loaded before the FMU's, or a folder with those that it needs; may be repeated.",
    name="--library-path",
    type=PathType(exists=True),
    metavar="PATH",
)
Engine = Literal["python", "compiled"] | None
ENGINE = option(None, "What computes the samples [as the study says]; compiled: C code where there is some.")
NO_REPORT = option(False, "Write no report.")
OPEN = option(False, "Open the report in a browser.", name="--open")
JSON = option(False, "Machine-readable output (JSON).", name="--json")
STEP_TIMEOUT = option(60.0, "Seconds that one call of the plant may take.", type=POSITIVE, show_default=True)
FMIVersion = Literal["2.0", "3.0"]
FMI_VERSION = option("2.0", "FMI version.", show_default=True)
PLATFORMS = option(None, "Platforms to compile for [this one].", metavar="all|NAME,...")


def assignments(called: str, texts: Sequence[str], value_of: Callable[[str], T]) -> dict[str, T]:
    """Return what an option that is repeated as ``NAME=VALUE`` says, by name.

    Raises
    ------
    ConfigError
        A text is not of this form, or a name is given twice; all of them at once.
    """
    values: dict[str, T] = {}
    faults = []
    for text in texts:
        name, equals, value = text.rpartition("=")
        name = name.strip()
        if not (equals and name and value):
            faults.append(f'{called} "{text}" is not possible; needed: NAME=VALUE')
        elif name in values:
            faults.append(f"{called}: {name} is given more than once")
        else:
            values[name] = value_of(value)
    if faults:
        raise ConfigError(faults)
    return values


def parse_seeds(text: str | None) -> list[int]:
    """Return the seeds that ``--seeds`` gives."""
    from ddpc_cosim.study.file_format.sections import expand_seeds

    if text is None:
        return []
    try:
        return expand_seeds([part.strip() for part in text.split(",")])
    except ValueError as error:
        raise ConfigError(f"--seeds: {error}") from error
