/* A steady Kalman filter of a linear model: what Observer and ModelBased do in Python. */
#ifndef OBSERVER_H
#define OBSERVER_H

#include "sample.h"

#include <stdbool.h>

typedef struct {
    size_t m, p, n;           /* inputs, outputs, and states with the 1 that ends them */
    const double *a, *b, *c;  /* the model, n x n, n x m and p x n */
    const double *gain;       /* n x p, its last row zero */
    size_t disturbances;      /* that are known */
    const double *e, *f;      /* what they do to the state and the outputs */
    const double *rest_d;     /* and to the state at rest */
    const double *rest_u;     /* n x m: what inputs do to that */
} Observer;

typedef struct {
    double *resting; /* 1 until there is a finite measurement, else 0 */
    double *u;       /* m inputs applied last */
    double *state;   /* n states */
    const double *rest; /* n x (p + 1): the state at rest, given the outputs and 1 */
    double *scratch; /* n + p numbers, and after them the disturbances now */
} ObserverMemory;

/* The outputs that the estimate shows. */
void expected_outputs(const Observer *observer, const ObserverMemory *held, double y[]);

/* Correct the estimate by the outputs measured now, as far as they are finite.
 *
 * Returns false while none was; u are the inputs at rest then. */
bool observe(const Observer *observer, const ObserverMemory *held, const Sample *sample, double u[], Told *told);

/* Go on by one sample with inputs u. */
void predict(const Observer *observer, const ObserverMemory *held, const double u[]);

#endif
