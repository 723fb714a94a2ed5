"""Libraries of FMUs that take functions of an old library of GNU Fortran, which is made up for the linker."""

from collections.abc import Sequence
from pathlib import Path

from fmu_plants.export.compiler import find_compiler

from .builder import HERE

OLD = "libgfortran.so.3"
USUAL = {
    "GFORTRAN_1.0": (
        "concat_string",
        "st_write",
        "st_write_done",
        "compare_string",
        "pow_i4_i4",
        "stop_string",
    ),
    "GFORTRAN_1.4": ("transfer_character_write", "transfer_integer_write"),
}
"""What FMUs of JModelica.org take."""
OF_GCC_7 = {"GFORTRAN_7": tuple(name for names in USUAL.values() for name in names)}
# It is computed while the library is loaded, so that an FMU that runs has got the right result.
USE = """
#include <stdlib.h>
#include <string.h>
void _gfortran_concat_string(int, char *, int, const char *, int, const char *);
__attribute__((constructor)) static void use(void)
{
    char text[6];
    _gfortran_concat_string(6, text, 2, "ab", 3, "cde");
    if (memcmp(text, "abcde ", 6) != 0)
        abort();
}
"""


def link(folder: Path, versions: dict[str, Sequence[str]], name: str = OLD, *others: str) -> bytes:
    """Return an FMU's library that takes functions of a library of Fortran, which is written beside it."""
    functions = [f"_gfortran_{function}" for group in versions.values() for function in group]
    script = "".join(
        f"{version} {{ global: {' '.join(f'_gfortran_{f};' for f in group)} }};\n"
        for version, group in versions.items()
    )
    (folder / "script.map").write_text(script, encoding="utf-8")
    stubs = "".join(f"void {function}(void) {{}}\n" for function in functions)
    (folder / "stub.c").write_text(stubs, encoding="utf-8")
    calls = "".join(
        f"extern void {f}();\nvoid *const use_{i} = (void *){f};\n" for i, f in enumerate(functions)
    )
    (folder / "calls.c").write_text(calls, encoding="utf-8")
    (folder / "use.c").write_text(USE if "_gfortran_concat_string" in functions else "", encoding="utf-8")
    compiler, flags = find_compiler(), ["-shared", "-fPIC", "-w"]
    compiler.run(
        [*flags, f"-Wl,-soname,{name}", "-Wl,--version-script=script.map", "-o", name, "stub.c"], folder
    )
    models = [str(HERE / source) for source in ("models.c", "front2.c")]
    linked = ["-Wl,-Bsymbolic", "-Wl,--no-as-needed", "calls.c", "use.c", *models, name, *others, "-lm"]
    compiler.run([*flags, "-o", "main.so", *linked], folder)
    return (folder / "main.so").read_bytes()
