"""Without a sandbox, what others say of it is in test_sandbox.py; requests to end are signals of POSIX."""

import sys

from ddpc_cosim.processes.sandbox import missing

collect_ignore = [
    *(["test_within_the_sandbox.py", "test_compiling_in_the_sandbox.py"] if missing() else []),
    *(["test_requests.py"] if sys.platform == "win32" else []),
]
