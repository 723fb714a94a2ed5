/* What the step function of a controller sees and tells: the counterparts of Sample and Action in Python.
 *
 * A step function has the form
 *
 *     void step(double memory[], const Sample *sample, double u[], Told *told);
 *
 * `memory` is all that it remembers, with the start values of its part set by controller_start. */
#ifndef SAMPLE_H
#define SAMPLE_H

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    const double *y;         /* p controlled outputs, measured now */
    const double *measured;  /* q measurements, taken now */
    const double *reference; /* r_k+1 ... r_k+horizon, p values each */
    const double *setpoint;  /* p values, r_k */
    const double *applied;   /* NULL; or m inputs that somebody else applies: the controller only follows, all is finite */
} Sample;

/* Why inputs are a fallback; several can be true of a step. */
enum {
    STATUS_HELD = 1,        /* a value is not finite: inputs held, or at rest */
    STATUS_EXPECTED = 2,    /* a missing measurement: the model's expectation stands in for it */
    STATUS_RELAXED = 4,     /* bounds that cannot be met gave way */
    STATUS_CLIPPED = 8,     /* the unconstrained optimum, clipped at the input limits */
    STATUS_NEAREST = 16,    /* no combination of the recorded windows has this past: the nearest is used */
    STATUS_ITERATIONS = 32, /* the optimisation reached the bound on its iterations */
    STATUS_MODEL = 64,      /* what was learned online was not plausible and is not used */
    STATUS_LAST = 128       /* a missing measurement while it follows: the last one stands in for it */
};

typedef struct {
    unsigned status;
    unsigned iterations;
    unsigned active_bounds;
} Told;

/* chosen[i] = values[places[i]] */
void choose(const double values[], const size_t places[], size_t n, double chosen[]);

/* The references after the setpoint that r begins with; the last one that is known stands for those beyond. */
void repeat_last(const double r[], size_t preview, size_t horizon, size_t p, double reference[]);

/* Take what is measured, and the inputs that somebody else applies; what is not finite is as it was last. False: a
 * measurement never was finite. */
bool take_applied(const double y[], double seen[], size_t n, const double u[], double applied[], size_t m, Told *told);

/* Keep inputs within their bounds; in place of one that is not finite stands the last one. */
void hold_bounds(double u[], const double low[], const double high[], size_t m, double last[], Told *told);

#endif
