"""Stand-ins for libraries of old Fortran compilers, which current systems do not have any more.

FMUs of 2010 to 2020, those of JModelica.org above all, link the runtime library of GNU Fortran 4.3 to 7 for
what LAPACK needs of it: a few operations on texts and integers, and the printing of errors. A stand-in has
these functions and no others. What it computes is what the language defines; what would be written to the
screen goes to stderr, unformatted; what would end the process ends it. A function that would have to do more
is not there, and nor is, for an FMU that takes it, the stand-in.

Interfaces: GNU Fortran manual, "Mixed-Language Programming"; ``gfortran.map`` of GCC 4.3 to 7 for the version
of each. In all of these lengths of texts are 32-bit integers.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fmu_plants.export.binaries import WantedSymbol

MARK = "ddpc_cosim_stand_in"
"""A variable that every stand-in has, by which a loaded one is told from the library that it stands for."""
_PREFIX = "_gfortran_"

_HEAD = """\
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

extern const int ddpc_cosim_stand_in;
const int ddpc_cosim_stand_in = 1;
"""

_PRELUDE = """
/* The beginning of what describes a statement of input or output, with pointers of 64 bit. */
typedef struct {
    int32_t flags, unit;
    const char *file;
    int32_t line, message_length;
    char *message;
    int32_t *status;
    int64_t record;
    void *size, *length, *array;
    const char *format;
    int32_t format_length;
} Statement;

enum { FAILURE = 3, HAS_STATUS = 1 << 5, HAS_FORMAT = 1 << 12, IS_INTERNAL = 1 << 14 };
enum { STANDARD_ERROR = 0, STANDARD_OUTPUT = 6 };

static int32_t smaller(int32_t a, int32_t b) { return a < b ? a : b; }

static void copy(char *to, const char *from, int32_t length)
{
    if (length > 0)
        memmove(to, from, (size_t)length);
}

static void fill(char *to, int32_t length)
{
    if (length > 0)
        memset(to, ' ', (size_t)length);
}

static int is_in(char letter, const char *set, int32_t length)
{
    return length > 0 && memchr(set, letter, (size_t)length) != NULL;
}

static int32_t trimmed(int32_t length, const char *text)
{
    while (length > 0 && text[length - 1] == ' ')
        length--;
    return length > 0 ? length : 0;
}

static int order(const char *text, int32_t length, int32_t from)
{
    for (int32_t i = from; i < length; i++)
        if (text[i] != ' ')
            return (unsigned char)text[i] > ' ' ? 1 : -1;
    return 0;
}

static void show_integer(const void *value, int kind)
{
    switch (kind) {
    case 1: fprintf(stderr, " %d", *(const int8_t *)value); break;
    case 2: fprintf(stderr, " %d", *(const int16_t *)value); break;
    case 4: fprintf(stderr, " %ld", (long)*(const int32_t *)value); break;
    case 8: fprintf(stderr, " %lld", (long long)*(const int64_t *)value); break;
    default: fprintf(stderr, " (an integer of %d bytes)", kind);
    }
}

static void show_real(const void *value, int kind)
{
    switch (kind) {
    case 4: fprintf(stderr, " %.9g", *(const float *)value); break;
    case 8: fprintf(stderr, " %.17g", *(const double *)value); break;
    default: fprintf(stderr, " (a number of %d bytes)", kind);
    }
}
"""

_POWER_OF_INTEGERS = """
int{a}_t _gfortran_pow_i{x}_i{n}(int{a}_t base, int{b}_t exponent)
{{
    if (exponent < 0) {{
        if (base == 0) {{
            fputs("Fortran: 0 to a negative power\\n", stderr);
            abort();
        }}
        return base == 1 ? 1 : base == -1 ? (exponent & 1 ? -1 : 1) : 0;
    }}
    uint{a}_t result = 1, factor = (uint{a}_t)base;
    for (uint{b}_t rest = (uint{b}_t)exponent; rest; rest >>= 1, factor *= factor)
        if (rest & 1)
            result *= factor;
    return (int{a}_t)result;
}}
"""
_POWER_OF_REALS = """
{type} _gfortran_pow_r{x}_i8({type} base, int64_t exponent)
{{
    uint64_t rest = exponent < 0 ? 0 - (uint64_t)exponent : (uint64_t)exponent;
    {type} result = 1, factor = exponent < 0 ? 1 / base : base;
    while (rest) {{
        if (rest & 1)
            result *= factor;
        rest >>= 1;
        if (rest)
            factor *= factor;
    }}
    return result;
}}
"""
_SEARCH = """
int32_t _gfortran_string_{name}(int32_t length, const char *text, int32_t count, const char *set,
                               int32_t back)
{{
    for (int32_t i = 0; i < length; i++) {{
        const int32_t place = back ? length - 1 - i : i;
        if ({sign}is_in(text[place], set, count))
            return place + 1;
    }}
    return 0;
}}
"""
_TRANSFER = """
void _gfortran_transfer_{name}(Statement *statement, const void *value, int32_t kind)
{{
    (void)statement;
    {show}
}}
"""
_SHOWN = {
    "character": 'fprintf(stderr, " %.*s", kind > 0 ? (int)kind : 0, (const char *)value);',
    "complex": "show_real(value, kind); show_real((const char *)value + kind, kind);",
    "integer": "show_integer(value, kind);",
    "logical": 'fputs(*(const char *)value ? " T" : " F", stderr);\n    (void)kind;',
    "real": "show_real(value, kind);",
}
_STOP_WITH_TEXT = """
void _gfortran_{name}(const char *text, int32_t length)
{{
    if (text != NULL)
        fprintf(stderr, "{words} %.*s\\n", (int)length, text);
    exit({code});
}}
"""
_STOP_WITH_NUMBER = """
void _gfortran_{name}(int32_t code)
{{
    fprintf(stderr, "{words} %ld\\n", (long)code);
    exit(code);
}}
"""
_ERROR = """
void _gfortran_{name}({first}const char *format, ...)
{{
    va_list values;
    {where}fputs("Fortran runtime {kind}: ", stderr);
    va_start(values, format);
    vfprintf(stderr, format, values);
    va_end(values);
    fputc('\\n', stderr);
    {end}
}}
"""
_AT = {"first": "const char *where, ", "where": 'fprintf(stderr, "%s\\n", where);\n    '}
_HERE = {"first": "", "where": ""}

_FUNCTIONS: Mapping[str, Mapping[str, str]] = {
    "GFORTRAN_1.0": {
        "concat_string": """
void _gfortran_concat_string(int32_t length, char *result, int32_t length_1, const char *text_1,
                             int32_t length_2, const char *text_2)
{
    const int32_t first = smaller(length, length_1), second = smaller(length - first, length_2);
    copy(result, text_1, first);
    copy(result + first, text_2, second);
    fill(result + first + second, length - first - second);
}
""",
        "compare_string": """
int _gfortran_compare_string(int32_t length_1, const char *text_1, int32_t length_2, const char *text_2)
{
    const int32_t common = smaller(length_1, length_2);
    const int difference = common > 0 ? memcmp(text_1, text_2, (size_t)common) : 0;
    if (difference)
        return difference;
    return length_1 > length_2 ? order(text_1, length_1, common) : -order(text_2, length_2, common);
}
""",
        "string_len_trim": """
int32_t _gfortran_string_len_trim(int32_t length, const char *text) { return trimmed(length, text); }
""",
        "string_trim": """
void _gfortran_string_trim(int32_t *length, char **result, int32_t given, const char *text)
{
    static char nothing;
    *length = trimmed(given, text);
    *result = &nothing;
    if (*length == 0)
        return;
    *result = malloc((size_t)*length);
    if (*result == NULL) {
        fputs("Fortran: out of memory\\n", stderr);
        exit(1);
    }
    copy(*result, text, *length);
}
""",
        "string_index": """
int32_t _gfortran_string_index(int32_t length, const char *text, int32_t count, const char *part,
                               int32_t back)
{
    if (count == 0)
        return back ? length + 1 : 1;
    for (int32_t i = 0; i <= length - count; i++) {
        const int32_t place = back ? length - count - i : i;
        if (memcmp(text + place, part, (size_t)count) == 0)
            return place + 1;
    }
    return 0;
}
""",
        "string_scan": _SEARCH.format(name="scan", sign=""),
        "string_verify": _SEARCH.format(name="verify", sign="!"),
        "adjustl": """
void _gfortran_adjustl(char *result, int32_t length, const char *text)
{
    int32_t blanks = 0;
    while (blanks < length && text[blanks] == ' ')
        blanks++;
    copy(result, text + blanks, length - blanks);
    fill(result + length - blanks, blanks);
}
""",
        "adjustr": """
void _gfortran_adjustr(char *result, int32_t length, const char *text)
{
    const int32_t letters = trimmed(length, text);
    copy(result + length - letters, text, letters);
    fill(result, length - letters);
}
""",
        **{
            f"pow_i{x}_i{n}": _POWER_OF_INTEGERS.format(x=x, n=n, a=8 * x, b=8 * n)
            for x in (4, 8)
            for n in (4, 8)
        },
        "pow_r4_i8": _POWER_OF_REALS.format(x=4, type="float"),
        "pow_r8_i8": _POWER_OF_REALS.format(x=8, type="double"),
        "st_write": """
void _gfortran_st_write(Statement *statement)
{
    const int is_internal = statement->flags & IS_INTERNAL;
    if (is_internal || (statement->unit != STANDARD_OUTPUT && statement->unit != STANDARD_ERROR)) {
        fprintf(stderr, "The FMU writes %s by Fortran, which the stand-in for libgfortran cannot do\\n",
                is_internal ? "into a text" : "to a file");
        abort();
    }
    statement->flags &= ~FAILURE;
    if (statement->flags & HAS_STATUS)
        *statement->status = 0;
    fputs("Fortran:", stderr);
    if (statement->flags & HAS_FORMAT)
        fprintf(stderr, " %.*s:", (int)statement->format_length, statement->format);
}
""",
        "st_write_done": """
void _gfortran_st_write_done(Statement *statement)
{
    (void)statement;
    fputc('\\n', stderr);
}
""",
        # In old interfaces they serve reading too, which begins with a function that is not there.
        **{f"transfer_{name}": _TRANSFER.format(name=name, show=show) for name, show in _SHOWN.items()},
        "stop_string": _STOP_WITH_TEXT.format(name="stop_string", words="STOP", code=0),
        "stop_numeric": """
void _gfortran_stop_numeric(int32_t code)
{
    if (code == -1)
        exit(0);
    fprintf(stderr, "STOP %ld\\n", (long)code);
    exit(code);
}
""",
        "runtime_error": _ERROR.format(name="runtime_error", kind="error", end="exit(2);", **_HERE),
        "runtime_error_at": _ERROR.format(name="runtime_error_at", kind="error", end="exit(2);", **_AT),
        "os_error": """
void _gfortran_os_error(const char *message)
{
    fprintf(stderr, "Fortran, operating system error: %s\\n", message);
    exit(1);
}
""",
        "abort": """
void _gfortran_abort(void) { abort(); }
""",
    },
    "GFORTRAN_1.1": {
        "runtime_warning_at": _ERROR.format(name="runtime_warning_at", kind="warning", end="", **_AT),
    },
    "GFORTRAN_1.3": {
        "error_stop_string": _STOP_WITH_TEXT.format(name="error_stop_string", words="ERROR STOP", code=1),
    },
    "GFORTRAN_1.4": {
        **{
            f"transfer_{name}_write": _TRANSFER.format(name=f"{name}_write", show=show)
            for name, show in _SHOWN.items()
        },
        "stop_numeric_f08": _STOP_WITH_NUMBER.format(name="stop_numeric_f08", words="STOP"),
        "error_stop_numeric": _STOP_WITH_NUMBER.format(name="error_stop_numeric", words="ERROR STOP"),
    },
}
"""C code of each function, by the version of libgfortran.so.3's interface that it came with."""
_EVERY_FUNCTION = {name: code for functions in _FUNCTIONS.values() for name, code in functions.items()}


@dataclass(frozen=True)
class StandIn:
    """A library that can be compiled in place of one that is missing.

    Parameters
    ----------
    name : str
        The missing library, as others ask for it.
    functions : mapping of str to mapping of str to str
        C code by version of the interface and name, without the prefix ``_gfortran_``; each version contains
        those before it.
    """

    name: str
    functions: Mapping[str, Mapping[str, str]]

    @cached_property
    def source(self) -> str:
        """The C source."""
        codes = [code for functions in self.functions.values() for code in functions.values()]
        return "".join((_HEAD, *((_PRELUDE, *codes) if codes else ())))

    @cached_property
    def versions(self) -> str:
        """The linker's script with the versions of the interface."""
        script, before = "", ""
        for version, functions in self.functions.items():
            exported = [f"_gfortran_{name}" for name in functions]
            script += f"{version} {{ global: {'; '.join(exported)}; }}{before};\n"
            before = f" {version}"
        return f"DDPC_COSIM {{ global: {MARK}; local: *; }};\n{script}"

    @cached_property
    def digest(self) -> str:
        """What decides what it does: a hash of its source and of its versions."""
        return hashlib.sha256(f"{self.source}\n{self.versions}".encode()).hexdigest()[:16]

    def lacks(self, wanted: Iterable["WantedSymbol"]) -> list[str]:
        """Return what libraries take from the missing one and the stand-in does not have."""
        lacking = set[str]()
        for symbol in wanted:
            of_fortran = symbol.name.startswith(_PREFIX)
            name = symbol.name.removeprefix(_PREFIX)
            if symbol.library == self.name:
                is_there = of_fortran and name in self.functions.get(symbol.version, {})
            elif symbol.library or not of_fortran or not self.functions:  # of another library
                continue
            else:
                is_there = any(name in functions for functions in self.functions.values())
            if not is_there:
                lacking.add(f"{symbol.name} ({symbol.version})" if symbol.version else symbol.name)
        return sorted(lacking)

    def compiled(self, tell: Callable[[str], object]) -> Path:
        """Return the library, from the cache or compiled for it.

        Parameters
        ----------
        tell : callable
            Called with a line before it is compiled.

        Raises
        ------
        ExportError
            There is no C compiler, or it fails.
        OSError
            The cache cannot be used.
        """
        from fmu_plants.export.compiler import compile_library, find_compiler
        from fmu_plants.files import cached

        compiler = find_compiler()
        identity = hashlib.sha256(f"{self.digest} {compiler.identity}".encode()).hexdigest()[:16]
        script = "versions.map"
        flags = ["-fvisibility=default", f"-Wl,-soname,{self.name}", f"-Wl,--version-script={script}"]
        functions = [f"_gfortran_{name}" for functions in self.functions.values() for name in functions]

        def make() -> bytes:
            tell(f"compiling a stand-in for {self.name}")
            files = {"stand_in.c": self.source, script: self.versions}
            return compile_library(compiler, files, [MARK, *functions], flags)

        return cached(f"libraries/{identity}/{self.name}", make)


STAND_INS: Mapping[str, StandIn] = {
    stand_in.name: stand_in
    for stand_in in (
        StandIn("libgfortran.so.3", _FUNCTIONS),
        StandIn("libgfortran.so.4", {"GFORTRAN_7": _EVERY_FUNCTION}),
        # Of GNU Fortran's numbers of 128 bit, which libraries are linked with and commonly do not use.
        StandIn("libquadmath.so.0", {}),
    )
}
