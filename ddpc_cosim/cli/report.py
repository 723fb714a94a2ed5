"""``ddpc-cosim report``, and writing a report after a run."""

from collections.abc import Sequence
from pathlib import Path

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.results import StudyResults, load_results


def report_command(folders: Sequence[Path], out: Path | None) -> None:
    """Write one report on several folders of results and print its path."""
    results = [load_results(folder) for folder in folders]
    print(write_report(results, out or folders[0] / "report.html"))


def write_report(results: Sequence[StudyResults], path: Path) -> Path:
    """Write the report with the installed report generator and return its path."""
    generator = load_plugin("reports", "html")
    try:
        written: Path = generator(results, path)
    except OSError as error:
        raise ConfigError(f"{path}: the report cannot be written: {error.strerror}") from error
    return written
