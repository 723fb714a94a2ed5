"""Tests on named pipes, on paths of any length, and on locks of folders are matters of POSIX."""

import sys

collect_ignore = (
    ["running/test_cluster.py", "test_cases_at_once_posix.py", "test_working_directory_posix.py"]
    if sys.platform == "win32"
    else []
)
collect_ignore += [] if sys.platform == "linux" else ["test_preloading_linux.py"]
