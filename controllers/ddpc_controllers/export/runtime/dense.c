#include "dense.h"

#include <math.h>
#include <string.h>

void multiply(const double a[], const double x[], size_t rows, size_t columns, double y[])
{
    for (size_t i = 0; i < rows; ++i) y[i] = 0.0;
    add_product(a, x, rows, columns, y);
}

void add_product(const double a[], const double x[], size_t rows, size_t columns, double y[])
{
    for (size_t i = 0; i < rows; ++i) {
        double sum = 0.0;
        for (size_t j = 0; j < columns; ++j) sum += a[i * columns + j] * x[j];
        y[i] += sum;
    }
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
