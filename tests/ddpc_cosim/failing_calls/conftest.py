"""A library that is loaded before others is a matter of Linux here."""

import sys

collect_ignore = ["test_failing_calls.py"] if sys.platform != "linux" else []
