"""``ddpc-cosim check``: the conformance kit from the command line.

Every check runs in a worker process, so that a subject that crashes or hangs fails one check and no more.
"""

import signal
import warnings
from collections.abc import Sequence
from concurrent.futures import TimeoutError as TimedOut
from functools import partial
from multiprocessing import get_context
from typing import Any

import click
from pebble import ProcessExpired, ProcessPool
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ddpc_cosim.cli.check_subject import FMUSubject, Subject, find_subject
from ddpc_cosim.conformance import CheckResult, CheckStatus, run_check
from ddpc_cosim.errors import CosimWarning

_STYLE = {CheckStatus.PASSED: "green", CheckStatus.FAILED: "red", CheckStatus.NOT_APPLICABLE: "dim"}


def check_command(
    subject: str, sampling_time: float | None, timeout: float, settings: Sequence[str] = ()
) -> int:
    """Check a plant or a controller and print a table; return 1 if a check failed."""
    found = find_subject(subject, settings)
    step = sampling_time or _natural_step(found)
    results = []
    with ProcessPool(1, context=get_context("spawn")) as pool:
        for name in found.check_names():
            future = pool.schedule(_run, args=[found, name, step], timeout=timeout)
            results.append(_result(name, future, timeout))
    _print(f"{subject}, steps of {step:g} s", results)
    return 1 if any(result.status is CheckStatus.FAILED for result in results) else 0


def _natural_step(subject: Subject) -> float:
    """Return the step size that an FMU suggests; 0.1 s where nothing does."""
    if not isinstance(subject, FMUSubject):
        return 0.1
    from ddpc_cosim.inspection import inspect_fmu

    description = inspect_fmu(subject.path).description
    if description is None:
        return 0.1
    experiment, interface = description.default_experiment, next(iter(description.interfaces.values()), None)
    fixed = interface.fixed_step if interface is not None else None
    return fixed or experiment.step_size or (experiment.stop_time or 50.0) / 500


def _run(subject: Subject, name: str, sampling_time: float) -> CheckResult:
    warnings.simplefilter("ignore", CosimWarning)  # `inspect` shows them
    return run_check(name, partial(subject.check, name, sampling_time))


def _result(name: str, future: Any, timeout: float) -> CheckResult:
    try:
        result: CheckResult = future.result()
    except TimedOut:
        return CheckResult(name, CheckStatus.FAILED, f"did not end within {timeout:g} s")
    except ProcessExpired as error:
        return CheckResult(name, CheckStatus.FAILED, f"the process died: {_cause(error.exitcode)}")
    return result


def _cause(exit_code: int) -> str:
    if exit_code < 0 and -exit_code in set(signal.Signals):
        return signal.Signals(-exit_code).name
    return f"exit code {exit_code}"


def _print(title: str, results: list[CheckResult]) -> None:
    console = Console()
    if not console.is_terminal:
        for result in results:
            click.echo(f"{result.status}\t{result.name}\t{result.reason}".rstrip())
        return
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.add_column("check", no_wrap=True)
    table.add_column("result", no_wrap=True)
    table.add_column("why", overflow="fold")
    for result in results:
        status = Text(result.status.value, _STYLE[result.status])
        table.add_row(result.name, status, Text(result.reason))
    console.print(table)
