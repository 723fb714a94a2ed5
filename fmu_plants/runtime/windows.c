/* What a small library for Windows takes from the system's C library (Universal C Runtime), and how it starts.
 *
 * Included before all other sources. By default, a DLL gets mathematical functions of its own, and startup code for
 * C++ and thread-local data: together nearly half of the library, and nothing that it needs. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>

/* What equations can call. Functions that are not here take few instructions. To the header of MinGW, they might be
 * parts of the DLL. */
#define IMPORTED_1(name) __declspec(dllimport) double name(double)
#define IMPORTED_2(name) __declspec(dllimport) double name(double, double)
#pragma clang diagnostic push
#pragma clang diagnostic ignored "-Wdll-attribute-on-redeclaration"
IMPORTED_1(acos);
IMPORTED_1(acosh);
IMPORTED_1(asin);
IMPORTED_1(asinh);
IMPORTED_1(atan);
IMPORTED_1(atanh);
IMPORTED_1(cbrt);
IMPORTED_1(cos);
IMPORTED_1(cosh);
IMPORTED_1(erf);
IMPORTED_1(erfc);
IMPORTED_1(exp);
IMPORTED_1(exp2);
IMPORTED_1(expm1);
IMPORTED_1(lgamma);
IMPORTED_1(log);
IMPORTED_1(log10);
IMPORTED_1(log1p);
IMPORTED_1(log2);
IMPORTED_1(sin);
IMPORTED_1(sinh);
IMPORTED_1(sqrt);
IMPORTED_1(tan);
IMPORTED_1(tanh);
IMPORTED_1(tgamma);
IMPORTED_2(atan2);
IMPORTED_2(hypot);
IMPORTED_2(pow);
#pragma clang diagnostic pop

/* The C library has it under another name only. */
int vsnprintf(char *restrict text, size_t size, const char *restrict format, va_list arguments)
{
    const unsigned long long options = _CRT_INTERNAL_PRINTF_STANDARD_SNPRINTF_BEHAVIOR;
    return __stdio_common_vsprintf(options, text, size, format, NULL, arguments);
}

/* Called by Windows with a library, a reason and a reserved argument; there is nothing to prepare. */
int __stdcall _DllMainCRTStartup(void *library, unsigned long reason, void *reserved);

int __stdcall _DllMainCRTStartup(void *library, unsigned long reason, void *reserved)
{
    (void)library;
    (void)reason;
    (void)reserved;
    return 1;
}
