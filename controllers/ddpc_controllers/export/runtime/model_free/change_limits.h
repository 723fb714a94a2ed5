/* Limits of the inputs and of their changes over a control horizon: ChangeLimits in optimisation/limits.py. */
#ifndef CHANGE_LIMITS_H
#define CHANGE_LIMITS_H

#include "sample.h"

#include <stdbool.h>

typedef struct {
    size_t m, steps;       /* inputs; Nu */
    bool optimise, rated;  /* keep all limits by a QP, or clip the first change; whether changes have limits */
    const double *rates, *spans; /* of each input */
} ChangeLimits;

/* What a QP needs, with n = Nu m changes, and as many limited values: 2 n where changes have limits, else n. */
typedef struct {
    double *bounds; /* 2 m: the limits of the inputs now, the lower ones first */
    double *factor; /* n x n */
    double *rows;   /* limited x n */
    double *value, *lower, *upper, *tolerance; /* limited each */
    double *t;      /* n */
    double *qp;     /* QP_MEMORY(n) */
} ChangeLimitsMemory;

/* Cholesky's lower factor of a symmetric matrix; false: it is not positive definite. */
bool factorise(const double matrix[], double factor[], size_t n);

/* The next inputs, given the last ones, the changes that minimise a cost without limits, which become those that
 * keep the limits, and its second derivatives. */
void limit_changes(const ChangeLimits *limits, const ChangeLimitsMemory *held, const double last[], double plan[],
                   const double hessian[], double u[], Told *told);

#endif
