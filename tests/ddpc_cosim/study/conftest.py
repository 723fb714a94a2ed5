"""Tests on named pipes are matters of POSIX."""

import sys

collect_ignore = ["test_cluster.py"] if sys.platform == "win32" else []
