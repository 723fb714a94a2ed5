"""What can go wrong between a plant's equations and its FMU."""

from collections.abc import Sequence


class ModelError(ValueError):
    """A plant model contradicts itself; the message lists every fault that was found."""

    @classmethod
    def from_faults(cls, model: str, faults: Sequence[str]) -> "ModelError":
        """Put all faults of one model into one error."""
        return cls("\n  - ".join([f"model {model!r} has {len(faults)} fault(s):", *faults]))


class UnknownNameError(ModelError, AttributeError):
    """The equations use a name that the model does not declare."""


class ExportError(RuntimeError):
    """The FMU could not be built; the message says what to do about it."""
