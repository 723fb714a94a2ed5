"""Results of conformance checks, and how a check says what it found."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from ddpc_cosim.errors import CosimError


class CheckStatus(StrEnum):
    """How a check ended."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result of one check.

    Parameters
    ----------
    name : str
        What was checked, as a sentence about the subject.
    status : CheckStatus
        How it ended.
    reason : str
        Why it failed or does not apply; empty if it passed.
    """

    name: str
    status: CheckStatus
    reason: str = ""


class CheckFailedError(Exception):
    """What the subject does differently, in one sentence."""


class NotApplicableError(Exception):
    """Why a check says nothing about the subject."""


def run_check(name: str, check: Callable[[], None]) -> CheckResult:
    """Run one check; whatever the subject raises is a failure."""
    try:
        check()
    except NotApplicableError as reason:
        return CheckResult(name, CheckStatus.NOT_APPLICABLE, str(reason))
    except (CheckFailedError, CosimError) as error:
        return CheckResult(name, CheckStatus.FAILED, " ".join(str(error).split()))
    except Exception as error:  # a third party's plant can raise anything
        return CheckResult(name, CheckStatus.FAILED, f"raised {type(error).__name__}: {error}")
    return CheckResult(name, CheckStatus.PASSED)
