"""The program from its first moment on: a request to end is heard before the commands are imported."""

from ddpc_cosim.cli.ending import reporting_requests_to_end
from ddpc_cosim.processes.requests import orderly_end


def main() -> None:
    """Run the command that the arguments of this process say."""
    with reporting_requests_to_end(), orderly_end(process_ends=True):
        from ddpc_cosim.cli.main import main as commands

        commands()
