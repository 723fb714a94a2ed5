/* A condensed problem online: minimise |t|^2 subject to lower <= law p + gain t <= 0.
 *
 * Where the unconstrained optimum t = 0 keeps its bounds, it is the answer; otherwise qp.h finds t. Where no t keeps
 * them the next easier problem takes over; after the last one the unconstrained optimum is clipped at the limits of
 * the inputs. */
#ifndef LAW_H
#define LAW_H

#include <stdbool.h>

#include "qp.h"
#include "sample.h"

typedef struct Law {
    size_t parameters;           /* numbers in p, the last of which is 1 */
    size_t bounds, size;         /* rows of bounds, and numbers in t */
    size_t answers, inputs;      /* numbers in an answer, and how many of them are inputs: the first */
    size_t conflicts;            /* rows that must vanish, or no recorded past is like that in p */
    const double *law;           /* bounds + answers + conflicts rows of `parameters` */
    const double *scale;         /* what a row of bounds is multiplied by, to be measured as those of `gain` are */
    const double *gain;          /* bounds rows of `size` as qp.h has them, then answers rows */
    const double *lower, *upper; /* of the rows of bounds, in that measure; the upper ones are 0 */
    double tolerance;            /* by how much bounds may be exceeded, before they are multiplied */
    const double *low, *high;    /* limits of the inputs */
    const double *near_low, *near_high; /* beyond them an input is at its limit */
    const struct Law *easier;    /* NULL if there is none */
} Law;

/* Numbers that a law with n rows of bounds and k in t needs, zero at first; those of easier ones follow its own. */
#define LAW_MEMORY(n, k) (2 * (n) + (k) + QP_MEMORY(k))

/* Compute an answer; false if there is none, as a value is not finite: the last inputs are to be held. */
bool solve_law(const Law *law, const double p[], double memory[], double answer[], Told *told);

#endif
