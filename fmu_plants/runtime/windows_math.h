/* The mathematical functions that a small library for Windows takes from the system's C library (Universal C Runtime).
 *
 * Included before all other sources. By default, a DLL gets functions of its own. */
#ifndef WINDOWS_MATH_H
#define WINDOWS_MATH_H

#include <math.h>

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

/* Where these are not inlined, MinGW's call functions of its own. */
#undef isfinite
#undef isnan
#define isfinite(value) __builtin_isfinite(value)
#define isnan(value) __builtin_isnan(value)

#endif
