#include "vectors.h"

#include <math.h>
#include <string.h>

/* Four sums at a time: one alone waits for itself. */
double dot(const double a[], const double b[], size_t n)
{
    double sums[4] = {0.0, 0.0, 0.0, 0.0};
    size_t i = 0;
    for (; i + 4 <= n; i += 4) {
        sums[0] += a[i] * b[i];
        sums[1] += a[i + 1] * b[i + 1];
        sums[2] += a[i + 2] * b[i + 2];
        sums[3] += a[i + 3] * b[i + 3];
    }
    for (; i < n; ++i) sums[0] += a[i] * b[i];
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

void multiply(const double a[], const double x[], size_t rows, size_t columns, double y[])
{
    for (size_t i = 0; i < rows; ++i) y[i] = dot(a + i * columns, x, columns);
}

void add_product(const double a[], const double x[], size_t rows, size_t columns, double y[])
{
    for (size_t i = 0; i < rows; ++i) y[i] += dot(a + i * columns, x, columns);
}

double clip(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

bool all_finite(const double values[], size_t n)
{
    for (size_t i = 0; i < n; ++i) {
        if (!isfinite(values[i])) return false;
    }
    return true;
}

void fill_window(double window[], size_t length, size_t width, const double sample[])
{
    for (size_t k = 0; k < length; ++k) memcpy(window + k * width, sample, width * sizeof(double));
}

void append_sample(double window[], size_t length, size_t width, const double sample[])
{
    memmove(window, window + width, (length - 1) * width * sizeof(double));
    memcpy(window + (length - 1) * width, sample, width * sizeof(double));
}

void prepend_sample(double window[], size_t length, size_t width, const double sample[])
{
    memmove(window + width, window, (length - 1) * width * sizeof(double));
    memcpy(window, sample, width * sizeof(double));
}

void forget_oldest(double window[], size_t length, size_t width)
{
    memmove(window, window + width, length * width * sizeof(double));
}
