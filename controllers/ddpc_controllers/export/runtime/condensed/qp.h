/* Minimise |t|^2 subject to lower <= value + rows t <= upper, by a dual active-set method. */
#ifndef QP_H
#define QP_H

#include <stddef.h>

/* Number of doubles that the method needs for k unknowns. They start at zero, and carry the active set, its
 * multipliers and its factor from one problem to the next. */
#define QP_MEMORY(k) (2 + 6 * (k) + (k) * (k) + (k) * ((k) + 1) / 2)

/* The largest number of changes of the active set with n rows and k unknowns. */
#define QP_LIMIT(n, k) (4 * ((n) + (k)) + 20)

typedef struct {
    size_t count, size;      /* number of rows n, and of unknowns k */
    const double *rows;      /* n rows of k, of norm 1 each; zero where no t changes the value */
    const double *value;     /* n: values at t = 0 */
    const double *lower, *upper; /* n: infinite where there is no limit */
    const double *tolerance; /* n: by how much a limit may be exceeded */
} QP;

typedef enum {
    QP_SOLVED,
    QP_INFEASIBLE, /* limits contradict each other */
    QP_EXCEEDED    /* too many changes of the active set: not seen but where rounding decides */
} QPResult;

/* Solve; `iterations` grows by the number of changes of the active set. */
QPResult qp_solve(const QP *qp, double memory[], double t[], unsigned *iterations);

/* Number of active limits of the last solution. */
unsigned qp_active(const double memory[]);

/* Take other rows than in the last problem; the active set stays the first guess. */
void qp_refactor(const QP *qp, double memory[]);

#endif
