/* Inputs of another controller, changed only as far as the outputs' limits ask for: safety_filter.py. */
#ifndef SAFETY_FILTER_H
#define SAFETY_FILTER_H

#include "law.h"

typedef struct {
    size_t m, p, past;        /* numbers of inputs and outputs; past inputs, and one output more */
    const double *scale;      /* of the inputs; all else is in scaled signals */
    const double *low, *high; /* limits of the inputs */
    double same;              /* what differs by no more from what is wanted is that */
    const Law *law;           /* it answers with the inputs, and the outputs that they lead to */
    size_t disturbances;      /* that are known, the past of which has `past` samples */
    size_t ahead;             /* all parameters between the wanted inputs and the 1, which this past begins */
    const double *near;       /* where limits of the inputs move: how far from one an input still is at it */
} SafetyFilter;

typedef struct {
    double *parameters; /* of the law: past inputs and outputs, wanted inputs, what is known of the time ahead, 1; after
                         * them limits that move, first the lower ones */
    double *resting;    /* whether the past is still to be filled */
    double *changed;    /* whether inputs are other than those wanted */
    double *unscaled;   /* m: those wanted, in their units */
    double *forecast;   /* p */
    double *answer;     /* m + p */
    double *law;        /* the memory of the law */
} SafetyFilterMemory;

/* Take the inputs that are wanted, or that somebody else applies, and scale them; false where one is not finite. */
bool take_wanted(const SafetyFilter *filter, const SafetyFilterMemory *held, const Sample *sample, double u[]);

/* Bring scaled inputs to the nearest with which the outputs keep their limits. */
void filter_inputs(
    const SafetyFilter *filter, const SafetyFilterMemory *held, const Sample *sample, double u[], Told *told);

/* Where they were not changed give back what was wanted, to the last bit. */
void give_wanted(const SafetyFilter *filter, const SafetyFilterMemory *held, double u[]);

#endif
