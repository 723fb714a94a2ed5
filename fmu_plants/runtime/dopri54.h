/* Adaptive Dormand-Prince 5(4) integration of x' = f(t, x). */
#ifndef DOPRI54_H
#define DOPRI54_H

#include <stddef.h>

#define DOPRI54_STAGES 7

typedef void (*RightHandSide)(double time, const double x[], void *context, double dx[]);

typedef struct {
    size_t n;                  /* number of states */
    double relative_tolerance;
    const double *absolute_tolerance; /* per state */
    double *stages;            /* DOPRI54_STAGES rows of n: the slopes k_1 .. k_7 */
    double *trial;             /* n: the state that a stage or a step arrives at */
} Dopri54;

typedef enum {
    DOPRI54_DONE,
    DOPRI54_NOT_FINITE,     /* the slope became infinite or NaN, however small the step */
    DOPRI54_STEP_VANISHED,  /* the accuracy asked for needs steps below the resolution of time */
    DOPRI54_TOO_MANY_STEPS
} Dopri54Result;

/* Advance x from `start` by exactly `span` > 0, in as many internal steps as the tolerances ask for.
 *
 * `step` is the internal step size to begin with, 0 if none is known; on return, the one to go on with.
 * `elapsed` receives the part of the span that was covered; x is the state there. */
Dopri54Result dopri54_integrate(const Dopri54 *method, RightHandSide f, void *context, double start, double span,
                                double x[], double *step, double *elapsed);

#endif
