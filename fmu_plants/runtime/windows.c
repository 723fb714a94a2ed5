/* What a small library for Windows takes from the system's C library besides mathematical functions, and how it starts.
 *
 * By default, a DLL gets startup code for C++ and thread-local data, and functions of its own: together nearly half of
 * the library, and nothing that it needs. */
#include "windows_math.h"

#include <stdarg.h>
#include <stdio.h>

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
