"""Unpacking FMUs of unknown origin: within limits, inside one folder, or not at all."""

import lzma
import os
import re
import stat
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar
from xml.etree.ElementTree import Element

from lxml import etree  # type: ignore[import-untyped]

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.files.path_lengths import ALLOW_MORE, are_limited, longest_excess
from ddpc_cosim.files.texts import printable

MODEL_DESCRIPTION = "modelDescription.xml"
_RESOURCES = "resources"

# Whatever zipfile and its decompressors raise for archives that are not what they claim to be.
DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    RuntimeError,  # a compression that zipfile does not know is one too
    ValueError,
    OverflowError,
    MemoryError,
)
_CHUNK = 1 << 20
# The end of an archive: a mark, numbers of disks and files, size and place of the list of files, a comment.
_END, _END_MARK, _LONGEST_END = struct.Struct("<4s4H2LH"), b"PK\5\6", 22 + 0xFFFF
_LONGEST_ENTRY = 1000  # bytes of a file in that list, on average
# So that reading takes about 1 GB at most: a variable has about a dozen tags and attributes.
_LARGEST_XML = 400_000_000  # bytes
_MOST_MARKUP = 14_000_000  # tags and attributes
_BEYOND_LIMITS = re.compile("PARSE_HUGE|too big|too long")  # what libxml2 says of its own limits
_ENCRYPTED = 0x1
# What zipfile decompresses besides what FMI allows, and some of it in one go, however large that gets.
_COMPRESSIONS = {12: "bzip2", 14: "lzma", 93: "zstandard"}
_ALWAYS_ALLOWED = 10_000_000  # bytes
# What arrives in place of a file, by how it begins; and what to do about it.
_STAND_INS = {
    re.compile(rb"version https://git-lfs\.github\.com/spec/"): (
        "a Git LFS pointer, which stands for the file; get the file itself with: git lfs pull"
    ),
    re.compile(
        rb"(?:\xef\xbb\xbf)?(?:\s++|<\?.*?\?>|<!--.*?-->)*+<(?:!doctype\s+)?html\b", re.I | re.DOTALL
    ): (
        "a web page (HTML), as downloads from where one must log in or accept something give it; "
        "download the file itself"
    ),
}
_HEAD = 4096  # bytes
_UNIX, _DARWIN = 3, 19
_READABLE, _EXECUTABLE = 0o666, 0o111
_DEVICE_NAME = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
# An identifier names a library file; this is stricter than what a file system takes, laxer than C.
_LONGEST_SHOWN = 200
_LONGEST_NAME = 240  # bytes; file systems take 255, extension included
_FORBIDDEN_IN_NAMES = re.compile(r'[/\\:<>"|?*\x00-\x1f]')
_DOCUMENT_TYPE = (
    "declares a document type (DOCTYPE), which may hide entity bombs or external entities and "
    "has no place in an FMU; remove the declaration"
)
# What stands before the root element, up to the letter after the name of a document type.
_DOCTYPE = re.compile(rb"(?:\s++|<\?.*?\?>|<!--.*?-->)*+<!DOCTYPE\s+[^\s>\[]+\s*(?P<after>.)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class UnpackLimits:
    """How much an archive may unpack to.

    Parameters
    ----------
    max_unpacked_size : int
        Bytes of all files together, measured while unpacking.
    max_files : int
        Entries of the archive.
    max_ratio : float
        How many times its own size an archive may unpack to; 10 MB are always allowed.
    """

    max_unpacked_size: int = 2 * 1024**3
    max_files: int = 20_000
    max_ratio: float = 100.0

    def room_of(self, size: int, label: str) -> tuple[int, FMUImportError]:
        """Return how many bytes an archive of a size may unpack to, and the error beyond that."""
        room, limit = self.max_unpacked_size, "max_unpacked_size"
        by_ratio = max(int(self.max_ratio * size), _ALWAYS_ALLOWED)
        if by_ratio < room:
            room, limit = by_ratio, f"max_ratio: {self.max_ratio:g} times its size"
        words = f"{label}: unpacks to more than {room} bytes ({limit}); raise it if you trust the FMU"
        return room, FMUImportError(words)


def unpack(
    path: Path,
    folder: Path,
    limits: UnpackLimits | None = None,
    *,
    needed: str = MODEL_DESCRIPTION,
    kind: str = "FMU",
) -> None:
    """Unpack an FMU, or another archive.

    Parameters
    ----------
    path : Path
        The archive.
    folder : Path
        An empty folder; nothing is written outside of it. What was unpacked before a fault is left in it.
    limits : UnpackLimits, optional
        Limits on size and number of files.
    needed : str
        The file that it has to have.
    kind : str
        What it is called in errors.

    Raises
    ------
    FMUImportError
        The file is not an FMU, is damaged, exceeds the limits, or could do harm; and why.
    """
    limits = limits or UnpackLimits()
    if not path.is_file():
        raise FMUImportError(f"{path}: no such file")
    try:
        _check_directory(path, limits)
        archive = zipfile.ZipFile(path)
    except (*DAMAGED, OSError) as error:
        reason = _stand_in(path) or _reason(error)
        raise FMUImportError(f"{path.name}: not an {kind}: {reason}") from error
    try:
        with archive:
            _unpack_entries(archive, folder, limits, path, needed, kind)
    except DAMAGED as error:
        raise FMUImportError(f"{path.name}: damaged archive: {_reason(error)}") from error
    except OSError as error:
        raise FMUImportError(f"{path.name}: cannot be unpacked: {_reason(error)}") from error


class XMLTree:
    """The elements of an XML file, built while it is parsed; comments are left out.

    Whoever has no use for an element, or wants it in a smaller form, takes it when it ends (see ``end``).
    """

    def __init__(self) -> None:
        self.open: list[Element] = []
        self.root = Element("")
        self.overlooked: list[str] = []
        self.has_namespaces = self.may_have_doctype = False

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        """Open an element; where the root has a namespace, they are left out: FMI knows none."""
        if not self.open:
            self.has_namespaces = tag.startswith("{")
        if self.has_namespaces:
            tag = tag.rpartition("}")[2]
        self.open.append(Element(tag, attributes if isinstance(attributes, dict) else {}))

    def end(self, _: str) -> None:
        """Close the innermost element, which becomes part of the one around it."""
        element = self.open.pop()
        if self.open:
            self.open[-1].append(element)
        else:
            self.root = element

    def doctype(self, *_: str | None) -> None:
        """Refuse a document type, unless it is known to be a mere name; what it declares comes later."""
        if not self.may_have_doctype:
            raise RefusedError(_DOCUMENT_TYPE)

    def close(self) -> None:
        """Finish, as lxml wants it."""


class RefusedError(Exception):
    """Why an XML file is not read further; raised while a tree is built."""


_Tree = TypeVar("_Tree", bound=XMLTree)


def read_xml(path: Path, label: str, make: Callable[[], _Tree]) -> _Tree:
    """Parse an XML file of an FMU of unknown origin, in one go and without a copy of it in memory.

    Nothing is loaded from elsewhere, no entity is expanded, and libxml2's limits of depth and size hold. FMI
    knows no document types; entities can make a small file huge, or read other files: they are refused.

    Parameters
    ----------
    path : Path
        The file.
    label : str
        What it is called in errors.
    make : callable
        Makes an empty tree; one more if the file is not in the encoding that it claims to be in.

    Returns
    -------
    XMLTree
        What was made, filled; ``overlooked`` says what is wrong with the file as XML but was understood.

    Raises
    ------
    FMUImportError
        It is not XML, is too large, or declares entities or a document type that is elsewhere.
    """
    _check_size(path, label)
    with path.open("rb") as file:
        head = file.read(_CHUNK)
        blanks = len(head) - len(head.lstrip())
        # In two-byte encodings too; what cannot be seen here is refused where the parser meets it.
        doctype = _DOCTYPE.match(head.replace(b"\0", b"").lstrip().lstrip(b"\xef\xbb\xbf\xff\xfe"))
        if doctype is not None and doctype["after"] != b">":
            raise FMUImportError(f"{label}: {_DOCUMENT_TYPE}")

        def parse(**settings: Any) -> _Tree:
            tree = make()
            tree.may_have_doctype = doctype is not None
            # Entities are those of XML itself, as any others would have to be declared.
            parser = etree.XMLParser(
                target=tree, resolve_entities="internal", no_network=True, load_dtd=False, **settings
            )
            file.seek(blanks)
            etree.parse(SimpleNamespace(read=file.read), parser)  # nameless: else some errors are an OSError
            return tree

        try:
            tree = parse()
        except etree.XMLSyntaxError as error:
            if _BEYOND_LIMITS.search(error.msg):
                limits = "allowed: 10 MB for one text or attribute, 256 elements within each other"
                raise FMUImportError(f"{label} cannot be read: {error.msg.strip()}; {limits}") from error
            # Some tools write the letters of their locale into a file that claims to be UTF-8.
            try:
                tree = parse(encoding="cp1252")
            except etree.XMLSyntaxError:
                raise FMUImportError(f"{label} cannot be read: {error.msg}") from error
            tree.overlooked.append(
                "it is not in the encoding that it claims to be in; Windows-1252 was assumed"
            )
        except RefusedError as error:
            raise FMUImportError(f"{label}: {error}") from None
    if blanks:
        tree.overlooked.insert(0, "blanks before the XML declaration")
    return tree


def _check_size(path: Path, label: str) -> None:
    """Refuse what would take too much memory, before any is taken."""
    size = path.stat().st_size
    if size > _LARGEST_XML:
        raise FMUImportError(f"{label} has {size} bytes; allowed: {_LARGEST_XML}")
    with path.open("rb") as file:
        markup = sum(chunk.count(b"<") + chunk.count(b"=") for chunk in iter(lambda: file.read(_CHUNK), b""))
    if markup > _MOST_MARKUP:
        raise FMUImportError(f"{label} has {markup} tags and attributes; allowed: {_MOST_MARKUP}")


def is_file_name(name: str) -> bool:
    """Whether a name from a model description names a file within a given folder."""
    fits = 0 < len(name.encode()) <= _LONGEST_NAME
    return fits and name not in (".", "..") and not _FORBIDDEN_IN_NAMES.search(name)


def _check_directory(path: Path, limits: UnpackLimits) -> None:
    """Check how long the archive's list of files is before it is read, which takes memory for each."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - _LONGEST_END, 0))
        end = file.read()
    start = end.rfind(_END_MARK)
    if start >= 0 and len(end) >= start + _END.size:
        *_, count, size, _, _ = _END.unpack_from(end, start)
        _check_count(count, limits, path.name)
        longest = limits.max_files * _LONGEST_ENTRY
        if size > longest:
            raise FMUImportError(f"{path.name}: its list of files has {size} bytes; allowed: {longest}")


def require_short_paths(path: Path, folder: Path, names: Iterable[str] | None = None) -> None:
    """Check that files of an archive can have their places in a folder, or in one whose path is as long.

    Parameters
    ----------
    path : Path
        The archive.
    folder : Path
        The folder, which need not be there.
    names : iterable of str, optional
        The files' paths in the archive; default: of all of them, of an archive that has been unpacked before.

    Raises
    ------
    FMUImportError
        Windows has no such long paths.
    """
    if not are_limited():
        return
    if names is None:
        with zipfile.ZipFile(path) as archive:
            names = _checked(archive.infolist(), path.name)
    if excess := longest_excess(folder / name for name in names):
        name = printable(excess.path.relative_to(folder).as_posix(), _LONGEST_SHOWN)
        raise FMUImportError(
            f'{path.name}: cannot be unpacked: the path of "{name}" among temporary files is '
            f"{excess.characters} characters longer than Windows allows; set TEMP to a folder whose path is "
            f"that much shorter, such as C:\\T, or {ALLOW_MORE}"
        )


def _check_count(count: int, limits: UnpackLimits, label: str) -> None:
    if count > limits.max_files:
        raise FMUImportError(
            f"{label}: {count} files; allowed: {limits.max_files} (max_files); raise it if you trust the FMU"
        )


def _unpack_entries(
    archive: zipfile.ZipFile, folder: Path, limits: UnpackLimits, path: Path, needed: str, kind: str
) -> None:
    label, entries = path.name, archive.infolist()
    _check_count(len(entries), limits, label)
    files = _checked(entries, label)
    if needed not in files:
        raise FMUImportError(f"{label}: not an {kind}: the archive has no {needed}{_hint(files, needed)}")
    require_short_paths(path, folder, files)
    remaining, too_large = limits.room_of(path.stat().st_size, label)
    if sum(entry.file_size for entry in files.values()) > remaining:  # what the archive itself admits
        raise too_large
    # FMUs look into folders, empty or not; and all of them get the path of one for resources.
    for name in (*_folders(entries), _RESOURCES):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, entry in files.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        # In a sandbox permissions of files cannot be changed later, so they are set when a file is made.
        made = partial(os.open, mode=_READABLE | _execution(entry, name))
        with archive.open(entry) as source, open(target, "xb", opener=made) as file:
            while chunk := source.read(_CHUNK):
                remaining -= len(chunk)
                if remaining < 0:
                    raise too_large
                file.write(chunk)


def _checked(entries: list[zipfile.ZipInfo], label: str) -> dict[str, zipfile.ZipInfo]:
    """Return the files by their path below the folder; an impossible path is a fault."""
    files: dict[str, zipfile.ZipInfo] = {}
    seen: dict[str, zipfile.ZipInfo] = {}
    for entry in entries:
        # zipfile cuts names at a NUL and replaces separators; what was written counts.
        raw = entry.orig_filename
        fault = _name_fault(raw) or _kind_fault(entry)
        if fault:
            raise FMUImportError(f'{label}: illegal entry "{printable(raw, _LONGEST_SHOWN)}": {fault}')
        name = "/".join(_parts(raw))
        if raw.endswith("/") or not name:
            continue
        twin = seen.setdefault(name.casefold(), entry)
        if twin is entry:
            files[name] = entry
        elif (twin.CRC, twin.file_size) != (entry.CRC, entry.file_size):
            raise FMUImportError(
                f'{label}: illegal entry "{printable(raw, _LONGEST_SHOWN)}": there are two of this name'
            )
    return files


def _folders(entries: list[zipfile.ZipInfo]) -> Iterator[str]:
    """Yield the paths of folders that have entries of their own."""
    return ("/".join(_parts(e.orig_filename)) for e in entries if e.orig_filename.endswith("/"))


def _parts(name: str) -> Iterator[str]:
    return (part for part in name.split("/") if part not in ("", "."))


def _name_fault(name: str) -> str:
    """Return why a name is not that of a file below the folder; empty if it is."""
    if "\\" in name:
        return "a backslash; separators must be forward slashes"
    if name.startswith("/"):
        return "an absolute path"
    if ":" in name:
        return "a drive letter or a stream name"
    if ".." in name.split("/"):
        return "a path that leaves the archive"
    if any(ord(letter) < 32 for letter in name):
        return "a control character"
    if sys.platform == "win32" and any(_DEVICE_NAME.match(part) for part in name.split("/")):
        return "a device of Windows"
    return ""


def _kind_fault(entry: zipfile.ZipInfo) -> str:
    """Return why an entry must not be unpacked; empty if it may be."""
    if entry.flag_bits & _ENCRYPTED:
        return "it is encrypted"
    if method := _COMPRESSIONS.get(entry.compress_type):
        return (
            f"it is compressed with {method}; allowed: deflate, or none; archive it again with one of these"
        )
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if kind == stat.S_IFLNK:
        return "a symbolic link; archive the file that it points to"
    if entry.create_system in (_UNIX, _DARWIN) and kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "neither a file nor a folder"
    return ""


def _execution(entry: zipfile.ZipInfo, name: str) -> int:
    """Return the permission bits that let the file be run: archives made on Windows do not have them."""
    if name.startswith("binaries/"):
        return _EXECUTABLE
    return (entry.external_attr >> 16) & _EXECUTABLE if entry.create_system in (_UNIX, _DARWIN) else 0


def _stand_in(path: Path) -> str:
    """Return what a file is that came in place of another one, and what to do; empty: nothing known."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return ""
    return next((words for begins, words in _STAND_INS.items() if begins.match(head)), "")


def _reason(error: Exception) -> str:
    return str(error) or type(error).__name__


def _hint(files: dict[str, zipfile.ZipInfo], needed: str) -> str:
    inner = [name for name in files if name.endswith("/" + needed)]
    return f"; there is {inner[0]}: archive the content of that folder, not the folder" if inner else ""
