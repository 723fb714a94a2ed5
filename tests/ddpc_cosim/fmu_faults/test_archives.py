"""Archives from unknown sources: refused with the reason, and nothing is written outside the folder."""

import os
import stat
import struct
import tracemalloc
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from fmus.builder import IDENTIFIER, integrator_description, write_archive

from ddpc_cosim import FMUImportError, FMUPlant
from ddpc_cosim.fmu.archive import UnpackLimits, XMLTree, is_file_name, read_xml, unpack
from ddpc_cosim.inspection import inspect_fmu

Files = Mapping[str, bytes]
DESCRIPTION = {"modelDescription.xml": b"<fmiModelDescription/>"}


def archive_with(path: Path, *entries: tuple[zipfile.ZipInfo | str, bytes]) -> Path:
    """Write an archive with a description, and entries whose names are written as they are."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in (*DESCRIPTION.items(), *entries):
            archive.writestr(name, content)
    return path


def renamed(path: Path, before: bytes, after: bytes) -> Path:
    """Replace a name everywhere in an archive, also by one that zipfile would not write."""
    path.write_bytes(path.read_bytes().replace(before, after))
    return path


def linked(name: str, kind: int) -> zipfile.ZipInfo:
    """Return an entry that is not a plain file (Unix)."""
    entry = zipfile.ZipInfo(name)
    entry.create_system = 3
    entry.external_attr = (kind | 0o777) << 16
    return entry


def encrypted(path: Path) -> Path:
    """Set the flag for encryption of the last entry, in both headers."""
    archive_with(path, ("secret", b"x"))
    content = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        content[content.rindex(signature) + offset] |= 1
    path.write_bytes(bytes(content))
    return path


def cut(path: Path, at: float) -> Path:
    archive_with(path, ("data", os.urandom(5000)))
    content = path.read_bytes()
    path.write_bytes(content[: int(at * len(content))])
    return path


def corrupted(path: Path) -> Path:
    archive_with(path, ("data", b"0123456789" * 100))
    return renamed(path, b"0123456789" * 3, b"x" * 30)


def unknown_method(path: Path) -> Path:
    """Claim a compression method that does not exist."""
    archive_with(path, ("data", b"x"))
    content = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\3\4", 8), (b"PK\1\2", 10)):
        struct.pack_into("<H", content, content.rindex(signature) + offset, 77)
    path.write_bytes(bytes(content))
    return path


def compressed(path: Path, method: int) -> Path:
    """Thirty million zeros, in less than 30 kB."""
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION["modelDescription.xml"], zipfile.ZIP_STORED)
        archive.writestr("zeros", bytes(30_000_000))
    return path


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


LFS_POINTER = b"""version https://git-lfs.github.com/spec/v1
oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393
size 12345
"""

HOSTILE: dict[str, tuple[Callable[[Path], Path], str]] = {
    "traversal": (lambda p: archive_with(p, ("../../evil", b"x")), r'illegal entry "\.\./\.\./evil": a path'),
    "inner traversal": (lambda p: archive_with(p, ("a/../../evil", b"x")), "a path that leaves the archive"),
    "absolute": (lambda p: archive_with(p, ("/tmp/evil", b"x")), 'entry "/tmp/evil": an absolute path'),
    "drive": (lambda p: archive_with(p, ("C:/evil", b"x")), 'entry "C:/evil": a drive letter'),
    "stream": (lambda p: archive_with(p, ("a:b", b"x")), "a drive letter or a stream name"),
    "backslash": (
        lambda p: renamed(archive_with(p, ("aa!!evil", b"x")), b"aa!!evil", b"..\\.evil"),
        "a backslash; separators must be forward slashes",
    ),
    "NUL": (
        lambda p: renamed(archive_with(p, ("aa!evil", b"x")), b"aa!evil", b"aa\0evil"),
        "a control character",
    ),
    "symbolic link": (
        lambda p: archive_with(p, (linked("resources", stat.S_IFLNK), b"/etc")),
        'illegal entry "resources": a symbolic link',
    ),
    "device": (
        lambda p: archive_with(p, (linked("pipe", stat.S_IFIFO), b"")),
        "neither a file nor a folder",
    ),
    "two of a name": (
        lambda p: renamed(archive_with(p, ("a.txt", b"1"), ("b.txt", b"2")), b"b.txt", b"a.txt"),
        r'illegal entry "a\.txt": there are two of this name',
    ),
    "the same but for case": (
        lambda p: archive_with(p, ("a/B.txt", b"1"), ("A/b.txt", b"2")),
        "there are two of this name",
    ),
    "a file that is a folder": (
        lambda p: archive_with(p, ("resources", b"1"), ("resources/x", b"2")),
        "cannot be unpacked",
    ),
    "encrypted": (encrypted, 'illegal entry "secret": it is encrypted'),
    "cut at the end": (lambda p: cut(p, 0.99), "not an FMU: File is not a zip file"),
    "cut in the middle": (lambda p: cut(p, 0.5), "not an FMU: File is not a zip file"),
    "empty": (lambda p: cut(p, 0.0), "not an FMU: File is not a zip file"),
    "corrupted": (corrupted, "damaged archive: Bad CRC-32"),
    "unknown compression": (unknown_method, "damaged archive: That compression method is not supported"),
    **{
        f"compressed with {method}": (
            lambda p, number=number: compressed(p, number),  # type: ignore[misc]
            rf'illegal entry "zeros": it is compressed with {method}; allowed: deflate, or none',
        )
        for method, number in (("bzip2", zipfile.ZIP_BZIP2), ("lzma", zipfile.ZIP_LZMA))
    },
    "zeros in the place of an FMU": (
        lambda p: compressed(p, zipfile.ZIP_DEFLATED),
        r"unpacks to more than 10000000 bytes \(max_ratio: 100 times its size\)",
    ),
    "a Git LFS pointer": (
        lambda p: written(p, LFS_POINTER),
        "not an FMU: a Git LFS pointer, which .* git lfs pull",
    ),
    "a web page": (
        lambda p: written(p, b"<!DOCTYPE html>\n<html lang='en'>"),
        r"not an FMU: a web page \(HTML\)",
    ),
    "a web page after a comment": (
        lambda p: written(p, b"\xef\xbb\xbf\n<?xml version='1.0'?><!-- < --><HTML>" + bytes(5000)),
        r"not an FMU: a web page \(HTML\), .*; download the file itself",
    ),
    "a page that never begins": (lambda p: written(p, b"<!--" * 5000), "not an FMU: File is not a zip file"),
    "no description": (
        lambda p: write_archive(p, {"readme.txt": b"hello"}),
        r"not an FMU: the archive has no modelDescription\.xml$",
    ),
    "a folder too much": (
        lambda p: write_archive(p, {"plant/modelDescription.xml": b""}),
        r"there is plant/modelDescription\.xml: archive the content of that folder",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
@pytest.mark.usefixtures("nothing_left")
def test_a_hostile_archive(case: str, tmp_path: Path) -> None:
    make, words = HOSTILE[case]
    path = make(tmp_path / "hostile.fmu")
    with pytest.raises(FMUImportError, match=r"^hostile\.fmu: .*" + words):
        FMUPlant(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["hostile.fmu", "scratch"]


def test_nothing_is_written_outside_the_folder(tmp_path: Path) -> None:
    """Also not by the part of the archive that was fine."""
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    path = archive_with(tmp_path / "x.fmu", ("fine", b"x"), ("../evil", b"x"))
    with pytest.raises(FMUImportError, match="leaves the archive"):
        unpack(path, folder)
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b"]


class TestLimits:
    @pytest.fixture
    def bomb(self, tmp_path: Path) -> Path:
        """A hundred million zeros in a hundred thousand bytes."""
        return write_archive(tmp_path / "bomb.fmu", {**DESCRIPTION, "zeros": bytes(10**8)})

    def test_a_bomb_is_refused(self, bomb: Path, scratch: Path, nothing_left: None) -> None:
        with pytest.raises(FMUImportError, match=r"bomb\.fmu: unpacks to more than 1000000 bytes"):
            unpack(bomb, scratch, UnpackLimits(max_unpacked_size=10**6))
        assert not (scratch / "zeros").exists()

    def test_a_bomb_that_denies_it(self, bomb: Path, tmp_path: Path) -> None:
        """Sizes are measured while unpacking: what the header claims is not trusted, and never exceeded."""
        size = struct.pack("<I", 10**8)
        assert bomb.read_bytes().count(size) == 2
        renamed(bomb, size, struct.pack("<I", 10**5))
        folder = tmp_path / "folder"
        folder.mkdir()
        with pytest.raises(FMUImportError, match=r"bomb\.fmu: damaged archive: Bad CRC-32"):
            unpack(bomb, folder, UnpackLimits(max_unpacked_size=10**6))
        assert sum(path.stat().st_size for path in folder.iterdir()) < 10**6

    @pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, zipfile.ZIP_DEFLATED])
    def test_memory_is_not_what_a_bomb_costs(self, method: int, tmp_path: Path) -> None:
        path, folder = compressed(tmp_path / "bomb.fmu", method), tmp_path / "folder"
        folder.mkdir()
        tracemalloc.start()
        try:
            with pytest.raises(FMUImportError):
                unpack(path, folder)
            _, most = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert most < 5_000_000
        assert not any(folder.iterdir())

    def test_a_ratio_that_is_denied(self, tmp_path: Path) -> None:
        """It is measured while unpacking too."""
        path = compressed(tmp_path / "bomb.fmu", zipfile.ZIP_DEFLATED)
        size = struct.pack("<I", 30_000_000)
        assert path.read_bytes().count(size) == 2
        renamed(path, size, struct.pack("<I", 10**5))
        folder = tmp_path / "folder"
        folder.mkdir()
        with pytest.raises(FMUImportError, match="damaged archive: Bad CRC-32"):
            unpack(path, folder)
        assert (folder / "zeros").stat().st_size <= 10**5

    def test_the_ratio_can_be_raised(self, tmp_path: Path) -> None:
        path, folder = compressed(tmp_path / "zeros.fmu", zipfile.ZIP_DEFLATED), tmp_path / "folder"
        folder.mkdir()
        unpack(path, folder, UnpackLimits(max_ratio=2000.0))
        assert (folder / "zeros").stat().st_size == 30_000_000

    def test_what_is_large_by_itself_has_no_ratio(self, tmp_path: Path) -> None:
        """Thirty million bytes that say nothing, in an archive that is not smaller."""
        path, folder = compressed(tmp_path / "zeros.fmu", zipfile.ZIP_STORED), tmp_path / "folder"
        folder.mkdir()
        unpack(path, folder)
        assert (folder / "zeros").stat().st_size == 30_000_000

    def test_too_many_files(self, tmp_path: Path) -> None:
        path = write_archive(tmp_path / "many.fmu", {**DESCRIPTION, **{f"f{i}": b"" for i in range(100)}})
        with pytest.raises(FMUImportError, match=r"many\.fmu: 101 files; allowed: 100 \(max_files\)"):
            unpack(path, tmp_path, UnpackLimits(max_files=100))

    def test_a_list_of_files_that_is_too_long_is_not_read(self, tmp_path: Path) -> None:
        path = write_archive(tmp_path / "long.fmu", {**DESCRIPTION, **{f"{i:04000}": b"" for i in range(2)}})
        with pytest.raises(
            FMUImportError, match=r"long\.fmu: its list of files has 8\d+ bytes; allowed: 3000"
        ):
            unpack(path, tmp_path, UnpackLimits(max_files=3))

    @pytest.mark.parametrize(
        ("limit", "words"),
        [("_MOST_MARKUP", r"has \d+ tags and attributes"), ("_LARGEST_XML", r"has \d+ bytes")],
    )
    def test_a_description_beyond_measure(
        self, limit: str, words: str, pendulum_fmu: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(f"ddpc_cosim.fmu.archive.{limit}", 50)
        with pytest.raises(FMUImportError, match=rf"modelDescription\.xml {words}; allowed: 50"):
            FMUPlant(pendulum_fmu)

    def test_too_many_variables(self, pendulum_fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("ddpc_cosim.fmu.description.reader._MOST_ENTRIES", 20)
        with pytest.raises(
            FMUImportError, match=r"modelDescription\.xml: has more than 20 variables, entries"
        ):
            FMUPlant(pendulum_fmu)

    def test_a_text_beyond_measure(self, tmp_path: Path) -> None:
        path = tmp_path / "modelDescription.xml"
        path.write_text(f'<fmiModelDescription modelName="{"x" * 10_100_000}"/>', encoding="utf-8")
        with pytest.raises(FMUImportError, match="; allowed: 10 MB for one text or attribute, 256 elements"):
            read_xml(path, "x", XMLTree)

    @pytest.mark.usefixtures("nothing_left")
    def test_limits_of_a_plant(self, faulty_fmus: dict[int, Path]) -> None:
        """They can be set, and what is within them is unpacked."""
        with pytest.raises(FMUImportError, match="max_unpacked_size"):
            FMUPlant(faulty_fmus[2], max_unpacked_size=1000)
        with pytest.raises(FMUImportError, match="max_files"):
            FMUPlant(faulty_fmus[2], max_files=1)
        FMUPlant(faulty_fmus[2], max_files=2, max_unpacked_size=10**6, max_ratio=1.0).close()


BOMB = b"".join(
    b'<!ENTITY %c "%s">' % (letter, b"&%c;" % (letter - 1) * 10 if letter > ord("a") else b"ha")
    for letter in range(ord("a"), ord("j"))
)
DOCUMENT_TYPES = {
    "entity bomb": b"<!DOCTYPE fmiModelDescription [" + BOMB + b"]>",
    "external entity": b'<!DOCTYPE fmiModelDescription [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
    "external subset": b'<!DOCTYPE fmiModelDescription SYSTEM "http://localhost/x.dtd">',
    "parameter entity": b'<!DOCTYPE fmiModelDescription [<!ENTITY % x SYSTEM "file:///x">%x;]>',
}


def test_what_xml_writes_as_an_entity(tmp_path: Path) -> None:
    path = tmp_path / "x.xml"
    path.write_text(
        '<x a="R&amp;D &lt;1&gt; &quot;&apos; &#228;&#x20ac;"><y z="&amp;lt;"/></x>', encoding="utf-8"
    )
    root = read_xml(path, "x", XMLTree).root
    assert root.get("a") == "R&D <1> \"' \u00e4\u20ac"
    assert root[0].get("z") == "&lt;"


class TestDocumentTypes:
    @pytest.mark.parametrize("kind", DOCUMENT_TYPES)
    @pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "shift_jis"])
    @pytest.mark.usefixtures("nothing_left")
    def test_entities_are_refused(self, kind: str, encoding: str, files: Files, tmp_path: Path) -> None:
        head, _, body = files["modelDescription.xml"].partition(b"?>")
        text = head.replace(b"UTF-8", encoding.encode()) + b"?>" + DOCUMENT_TYPES[kind] + body
        text = text.replace(b'modelName="integrator"', b'modelName="&i;"').decode().encode(encoding)
        path = write_archive(tmp_path / "xml.fmu", {**files, "modelDescription.xml": text})
        with pytest.raises(
            FMUImportError, match=r"xml\.fmu: modelDescription\.xml: declares a document type"
        ):
            FMUPlant(path)

    def test_a_bare_document_type_does_no_harm(self, files: Files, tmp_path: Path) -> None:
        text = files["modelDescription.xml"].replace(b"?>", b"?><!DOCTYPE fmiModelDescription>")
        FMUPlant(write_archive(tmp_path / "x.fmu", {**files, "modelDescription.xml": text})).close()

    def test_the_build_description_as_well(self, files: Files, tmp_path: Path) -> None:
        """It is read where there is no library for this platform."""
        text = b"<!DOCTYPE x [" + BOMB + b"]><fmiBuildDescription/>"
        content = {name: data for name, data in files.items() if not name.startswith("binaries/")}
        content["modelDescription.xml"] = integrator_description("3.0").encode()
        content |= {"sources/buildDescription.xml": text, "sources/all.c": b""}
        path = write_archive(tmp_path / "x.fmu", content)
        with pytest.raises(FMUImportError, match=r"sources/buildDescription\.xml: declares a document type"):
            FMUPlant(path)
        assert not inspect_fmu(path).can_run

    @pytest.mark.parametrize("encoding", ["utf-7", "cp037"])
    def test_encodings_in_which_it_cannot_be_seen_beforehand(
        self, encoding: str, files: Files, tmp_path: Path
    ) -> None:
        """The parser expands nothing then; whether it knows the encoding is another matter."""
        declaration = f'<?xml version="1.0" encoding="{encoding}"?>'
        text = declaration + DOCUMENT_TYPES["entity bomb"].decode() + '<fmiModelDescription modelName="&i;"/>'
        content = text.encode(encoding)
        if encoding == "utf-7":
            content = declaration.encode() + text.removeprefix(declaration).encode(encoding)
        with pytest.raises(FMUImportError, match=r"xml\.fmu: modelDescription\.xml"):
            FMUPlant(write_archive(tmp_path / "xml.fmu", {**files, "modelDescription.xml": content}))

    def test_a_document_type_in_a_comment_is_none(self, files: Files, tmp_path: Path) -> None:
        text = files["modelDescription.xml"].replace(b"?>", b'?><!-- <!DOCTYPE x SYSTEM "y"> -->')
        FMUPlant(write_archive(tmp_path / "x.fmu", {**files, "modelDescription.xml": text})).close()

    def test_depth_is_limited(self, files: Files, tmp_path: Path) -> None:
        text = files["modelDescription.xml"].replace(
            b"<ModelVariables>", b"<x>" * 10_000 + b"</x>" * 10_000 + b"<ModelVariables>"
        )
        with pytest.raises(FMUImportError, match=r"xml\.fmu: modelDescription\.xml cannot be read: .*depth"):
            FMUPlant(write_archive(tmp_path / "xml.fmu", {**files, "modelDescription.xml": text}))


class TestModelIdentifier:
    @pytest.mark.parametrize(
        "name", ["../../../../x", "/x", "a/b", "a\\b", "..", ".", "", "C:x", "a\0b", "x" * 300]
    )
    def test_what_is_no_file_name(self, name: str) -> None:
        assert not is_file_name(name)

    @pytest.mark.parametrize("name", ["plant", "Modelica.Blocks.PID", "2 mass drive", "Größe", "a-b_c..d"])
    def test_what_is_a_file_name(self, name: str) -> None:
        assert is_file_name(name)

    @pytest.mark.parametrize("name", ["../../../../x", "/tmp/x", "a\\b", "sub/x", "x" * 5000])
    @pytest.mark.usefixtures("nothing_left")
    def test_a_path_is_refused(self, name: str, files: Files, tmp_path: Path) -> None:
        text = files["modelDescription.xml"].replace(
            f'modelIdentifier="{IDENTIFIER}"'.encode(), f'modelIdentifier="{name}"'.encode()
        )
        path = write_archive(tmp_path / "path.fmu", {**files, "modelDescription.xml": text})
        with pytest.raises(FMUImportError, match=r"path\.fmu: .*modelIdentifier.* is not a"):
            FMUPlant(path)


class TestWhatIsUnpacked:
    def test_every_file_with_its_content(
        self, files: Files, faulty_fmus: dict[int, Path], tmp_path: Path
    ) -> None:
        unpack(faulty_fmus[2], tmp_path)
        extracted = {
            p.relative_to(tmp_path).as_posix(): p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()
        }
        assert extracted == dict(files)

    def test_odd_but_harmless(self, tmp_path: Path) -> None:
        """Some archivers write ``./x`` and ``a//x``, and some the same file twice."""
        path = archive_with(
            tmp_path / "x.fmu", ("./a.txt", b"1"), ("b//c.txt", b"2"), ("d/", b""), ("e.txt", b"1")
        )
        renamed(path, b"e.txt", b"a.txt")
        folder = tmp_path / "folder"
        folder.mkdir()
        unpack(path, folder)
        extracted = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
        assert extracted == {"modelDescription.xml", "a.txt", "b/c.txt"}
