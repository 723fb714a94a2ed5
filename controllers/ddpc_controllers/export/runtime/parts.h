/* Controllers that hold others: Decentralised, and Cascade. */
#ifndef PARTS_H
#define PARTS_H

#include "sample.h"

#include <stdbool.h>

/* A group of signals of a loop, for a controller of its own. */
typedef struct {
    size_t p, q, m;      /* the group's outputs, measurements and inputs */
    size_t outputs;      /* those of the loop */
    size_t horizon;      /* of the group's controller */
    const size_t *of_outputs, *of_measurements, *of_inputs; /* where they stand in the loop */
} Group;

/* The group's part of a sample; `memory` has room for 2 p + q + horizon p + m values. */
Sample sample_of_group(const Group *group, const Sample *sample, double memory[]);

/* Put the group's inputs among those of the loop. */
void place_inputs(const Group *group, const double own[], double u[]);

/* An outer controller, whose inputs are the references of an inner one. */
typedef struct {
    size_t p, period, horizon; /* of the outer controller: outputs, samples of the inner loop, references */
    size_t targets;            /* outputs of the inner loop */
    size_t inner_horizon;
    const size_t *chosen;      /* where these stand among the measurements; NULL: they are the outputs */
    size_t cells;              /* numbers of the outer controller that depend on where its inputs begin: */
    const size_t *places;      /*   where they stand in the memory, */
    const double *slopes;      /*   and how they change with each of the inputs, */
    const double *low, *high, *rest; /* which have limits, and begin elsewhere where nothing is measured */
} Cascade;

typedef struct {
    double *samples;   /* since the outer controller's last one; negative before the first */
    double *target, *y; /* targets each */
    double *later;     /* horizon x p */
    double *constant;  /* inner_horizon x targets */
} CascadeMemory;

/* Take a sample, the first of which decides where the outer controller begins; return whether it is its turn. */
bool take_sample(const Cascade *cascade, const CascadeMemory *held, const Sample *sample, double memory[]);

/* What the outer controller sees of a sample. */
Sample outer_sample(const Cascade *cascade, const CascadeMemory *held, const Sample *sample);

/* What the inner controller sees of it, once the target is known. */
Sample inner_sample(const Cascade *cascade, const CascadeMemory *held, const Sample *sample);

#endif
