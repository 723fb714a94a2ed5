"""What a process has is told on Linux."""

import sys

collect_ignore = [] if sys.platform == "linux" else ["test_chaos.py"]
