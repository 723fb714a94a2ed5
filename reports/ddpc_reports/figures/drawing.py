"""Charts compiled from Vega-Lite to Vega and drawn, in a process of its own.

What does so, V8, ends its process where it does not get the memory that it reserves (``ulimit -v``): that
must not cost the report. The process is started for the first picture and serves all of them. What was drawn
is kept in the cache: a report that is written again takes half the time.
"""

import atexit
import json
import signal
import subprocess
import sys
import threading
import zlib
from collections.abc import Callable, Mapping
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from time import monotonic
from typing import Any

from ddpc_cosim.plugins import cached

_MOST_CACHED = 4000  # files of the cache, two of each picture, which takes some 10 kB
Spec = Mapping[str, Any]

_LONGEST_SECONDS = 60.0  # for a picture that takes milliseconds, the first one a second
_CODE = """
import json, os, sys
answers = os.fdopen(os.dup(1), "wb")
os.dup2(2, 1)
import vl_convert
for line in sys.stdin.buffer:
    try:
        spec, samples = json.loads(line)
        vega = vl_convert.vegalite_to_vega(spec)
        sets, known = vega["data"], samples or {}
        rows = [{"values": known[entry["name"]]} if entry["name"] in known else {} for entry in sets]
        data = [entry | more for entry, more in zip(sets, rows)]
        svg = "" if samples is None else vl_convert.vega_to_svg(vega | {"data": data})
        answer = {"vega": vega, "svg": svg}
    except Exception as error:
        answer = {"error": str(error)}
    answers.write(json.dumps(answer).encode() + b"\\n")
    answers.flush()
"""


class DrawingError(Exception):
    """A picture cannot be drawn, and why."""


class _Painter:
    """The process that draws; one that has not drawn anything when it ends is not started again."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._has_drawn, self._broken = False, ""

    def draw(self, question: bytes) -> bytes:
        """Return the answer to a line of JSON, which is JSON too."""
        if self._broken:
            raise DrawingError(self._broken)
        began = monotonic()
        try:
            line = self._answer(question)
        except OSError:
            line = b""
        if not line:
            words = self._lost(late=monotonic() - began >= _LONGEST_SECONDS)
            self._broken = "" if self._has_drawn else words
            raise DrawingError(words)
        if error := json.loads(line).get("error"):
            raise DrawingError(error)
        self._has_drawn = True
        return line

    def _answer(self, question: bytes) -> bytes:
        """Return what the process answers; nothing if it ends, or is ended for taking too long."""
        if self._process is None:
            self._process = self._started()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        limit = threading.Timer(_LONGEST_SECONDS, self._process.kill)
        limit.start()
        try:
            self._process.stdin.write(question)
            self._process.stdin.flush()
            return self._process.stdout.readline()
        finally:
            limit.cancel()

    def _started(self) -> "subprocess.Popen[bytes]":
        atexit.register(self.end)
        pipe = subprocess.PIPE
        command = [sys.executable, "-P", "-c", _CODE]
        return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)

    def _lost(self, *, late: bool) -> str:
        """End the process, if it was started, and say how it ended."""
        code = self.end()
        if late:
            return f"the process that draws took longer than {_LONGEST_SECONDS:g} s and was ended"
        if code is None:
            return "the process that draws cannot be started"
        try:
            how = signal.Signals(-code).name
        except ValueError:
            how = f"exit code {code}"
        return f"the process that draws ended with {how}; it needs memory, which may be limited (ulimit -v)"

    def end(self) -> int | None:
        """End the process and return its exit code; None if there is none."""
        process, self._process = self._process, None
        if process is None:
            return None
        atexit.unregister(self.end)
        try:
            process.communicate(timeout=_LONGEST_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        return process.returncode


_painter = _Painter()


def rendered(spec: Spec, samples: Mapping[str, list[dict[str, Any]]] | None) -> tuple[dict[str, Any], str]:
    """Return a Vega-Lite specification as one of Vega, without the samples, and its picture as SVG.

    Parameters
    ----------
    spec : dict
        Vega-Lite specification.
    samples : mapping of str to list of dict
        The rows of the data sets that it names; None: there is no picture.

    Raises
    ------
    DrawingError
        It cannot be drawn, and why.
    ValueError
        It holds numbers that are not finite.
    """
    line = _painter.draw(json.dumps([spec, samples], allow_nan=False).encode() + b"\n")
    answer = json.loads(line)
    return answer["vega"], answer.get("svg", "")


def cached_picture(key: bytes, make: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
    """Return what is made, as JSON has it, from the cache if the same was made before.

    Parameters
    ----------
    key : bytes
        All that decides what is made, but for what draws.
    make : callable
        Makes it; what it raises is raised.
    """
    place = sha256(version("vl-convert-python").encode() + _CODE.encode() + key).hexdigest()[:32]
    new: list[bytes] = []

    def compressed() -> bytes:
        new.append(json.dumps(make()).encode())
        return zlib.compress(new[0])

    try:
        file = cached(f"pictures/{place}", compressed)
        content = zlib.decompress(file.read_bytes())
        if new:
            _leave_newest(file.parent)
    except OSError:  # the report can do without a cache
        content = new[0] if new else json.dumps(make()).encode()
    return dict(json.loads(content))


def _leave_newest(folder: Path) -> None:
    """Remove the older half of the pictures where there are too many."""
    files = [*folder.iterdir()]
    if len(files) > _MOST_CACHED:
        for file in sorted(files, key=lambda file: file.stat().st_mtime_ns)[: len(files) // 2]:
            file.unlink(missing_ok=True)
