"""``ddpc-cosim``: the group of its commands, each in a file of ``commands/``, and what they exit with.

Exit codes: 0 done; 1 some case failed or a check failed; 2 usage or configuration error; 130 interrupted;
143 terminated.
"""

import errno
import os
import sys
from collections import UserDict
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, NoReturn

import click

from ddpc_cosim.cli import commands
from ddpc_cosim.cli.ending import reporting_requests_to_end
from ddpc_cosim.cli.output import open_streams, say
from ddpc_cosim.errors import CosimError, is_of_usage
from ddpc_cosim.processes.requests import orderly_end
from fmu_plants.spelling import nearest

_STDOUT, _NOT_WRITTEN = 1, (errno.ENOSPC, errno.EFBIG, errno.EIO)
_FAILED, _MISUSED = 1, 2


def _complain(error: str) -> None:
    """Print an error; its further lines, which may be anyone's, cannot be taken for this program's own."""
    say("error: " + error.replace("\n", "\n  "), err=True, keep="\n")


@contextmanager
def _usage_errors_in_our_words() -> Iterator[None]:
    """Report what click finds wrong as any other error, and exit."""
    try:
        yield
    except click.UsageError as error:
        if isinstance(error, click.NoSuchOption) and error.possibilities:
            name, given = error.option_name, error.possibilities
            error = click.NoSuchOption(name, possibilities=[nearest(name, given) or given[0]], ctx=error.ctx)
        _complain(error.format_message())
        if error.ctx is not None:
            say(f"  {error.ctx.get_usage()}; {error.ctx.command_path} --help says more", err=True)
        sys.exit(_MISUSED)


class _Commands(UserDict[str, Any]):
    """The commands by name, each the function of its module's name; that is imported when it is asked for."""

    def __getitem__(self, name: str) -> click.Command:
        module: str = super().__getitem__(name)
        command: click.Command = getattr(import_module(f"{commands.__name__}.{module}"), module)
        return command


class _Group(click.Group):
    """A group whose commands report errors of this project in their own words."""

    def main(self, *arguments: Any, **more: Any) -> Any:
        """Run a command, and say if what it prints cannot be written."""
        try:
            try:
                with orderly_end():
                    return super().main(*arguments, **more)
            finally:
                if sys.stdout is not None:
                    sys.stdout.flush()  # at the end of the process it would be a traceback
        except OSError as error:
            if error.filename is not None or error.errno not in _NOT_WRITTEN:
                raise
            _complain(f"stdout cannot be written: {error.strerror}")
            os.dup2(os.open(os.devnull, os.O_WRONLY), _STDOUT)  # for what is left of it
            sys.exit(_FAILED)

    def make_context(self, *arguments: Any, **more: Any) -> click.Context:
        """Parse what stands before the command."""
        with reporting_requests_to_end(), _usage_errors_in_our_words():
            return super().make_context(*arguments, **more)

    def invoke(self, context: click.Context) -> NoReturn:
        """Run the command, and exit with the code that it returns; none is 0."""
        with reporting_requests_to_end():
            open_streams()
            try:
                with reporting_requests_to_end(), _usage_errors_in_our_words():
                    sys.exit(super().invoke(context))
            except CosimError as error:
                for fault in getattr(error, "faults", (str(error),)):
                    _complain(fault)
                sys.exit(_MISUSED if is_of_usage(error) else _FAILED)


_MODULES = [module.name for module in iter_modules(commands.__path__)]


@click.group(
    cls=_Group,
    commands=_Commands({name.rstrip("_").replace("_", "-"): name for name in _MODULES}),
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="ddpc-cosim", message="%(version)s")
def main() -> None:
    """Co-simulate FMU plants with plug-in controllers and compare them in one HTML report."""
