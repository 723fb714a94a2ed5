/* The linear-quadratic regulator with integral action: what LQR does in Python. */
#ifndef REGULATOR_H
#define REGULATOR_H

#include "observer.h"

typedef struct {
    const Observer *observer;
    const double *u_0;             /* inputs at the operating point */
    const double *state_gain;      /* m x n, its last column zero */
    const double *sum_gain;        /* m x p */
    const double *sums_of_inputs;  /* p x m: the sums that bring inputs about */
    const double *low, *high;      /* limits of the inputs */
    size_t ahead;                  /* known disturbances, now and later, one after another */
    const double *feedforward;     /* m x ahead */
    bool moves;                    /* whether limits of the inputs move */
} Regulator;

/* `sums` are 1 + p numbers: whether there are sums of the errors yet, and they; `scratch` m + p numbers, and after
 * them disturbances now and later, and limits that move, the lower ones first. */
void regulate(const Regulator *regulator, const ObserverMemory *held, double sums[], double scratch[], const Sample *sample,
              double u[], Told *told);

#endif
