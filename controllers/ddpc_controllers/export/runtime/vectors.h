/* Vectors, matrices row after row, and windows of samples. */
#ifndef VECTORS_H
#define VECTORS_H

#include <stdbool.h>
#include <stddef.h>

double dot(const double a[], const double b[], size_t n);

/* y = A x */
void multiply(const double a[], const double x[], size_t rows, size_t columns, double y[]);

/* y = y + A x */
void add_product(const double a[], const double x[], size_t rows, size_t columns, double y[]);

/* A value within limits; NaN stays what it is. */
double clip(double value, double low, double high);

bool all_finite(const double values[], size_t n);

/* Fill a window of `length` samples of `width` values with one sample. */
void fill_window(double window[], size_t length, size_t width, const double sample[]);

/* Forget the first sample of a window and append one. */
void append_sample(double window[], size_t length, size_t width, const double sample[]);

/* Forget the last sample of a window and put one in front. */
void prepend_sample(double window[], size_t length, size_t width, const double sample[]);

/* Forget the first of `length` + 1 samples. */
void forget_oldest(double window[], size_t length, size_t width);

#endif
